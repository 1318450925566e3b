//! Command lines that are put together at random must be taken or refused, never end in a panic.

use clap::Parser;
use examples::tools::{compare, gradient, recover, render, stability};
use fuzz::{apply, check_message, config, mutations};
use proptest::prelude::*;

/// What options may look like, values among them that no option should take.
const WORDS: [&str; 40] = [
    "scene.xml",
    "-o",
    "x.exr",
    "--spp",
    "4",
    "--seed",
    "--param",
    "red.reflectance.value",
    "--estimator",
    "--estimators",
    "mis,detached",
    "--repeats",
    "--out",
    "--json",
    "--threads",
    "--max-depth",
    "--iterations",
    "--rate",
    "--checkpoint",
    "--resume",
    "--integrator",
    "path",
    "--caustics",
    "paths",
    "-D",
    "name=value",
    "=",
    "--list",
    "--quick",
    "--help",
    "--",
    "",
    "0",
    "-1",
    "nan",
    "inf",
    "1e999",
    "18446744073709551616",
    "é",
    "--spp=0",
];

fn check<A: Parser>(words: &[String]) {
    if let Err(error) = A::try_parse_from(words) {
        // Help is as long as it is.
        if error.use_stderr() {
            check_message(&error);
        }
    }
}

proptest! {
    #![proptest_config(config(2000))]

    #[test]
    fn arguments_do_not_panic(
        chosen in prop::collection::vec(0..WORDS.len(), 0..12),
        which in any::<prop::sample::Index>(),
        changes in mutations(1),
    ) {
        let mut words: Vec<String> = vec!["tool".to_owned()];
        words.extend(chosen.iter().map(|&i| WORDS[i].to_owned()));
        let damaged = which.index(words.len());
        let bytes = apply(words[damaged].as_bytes(), &changes, &[b"="]);
        words[damaged] = String::from_utf8_lossy(&bytes).into_owned();
        check::<render::Args>(&words);
        check::<gradient::Args>(&words);
        check::<compare::Args>(&words);
        check::<recover::Args>(&words);
        check::<stability::Args>(&words);
    }
}
