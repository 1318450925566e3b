//! What the documents promise: citations and errata keys resolve, links lead somewhere, every figure is listed, and the
//! front pages stay short.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use render::estimator::Capabilities;
use render::instances::Estimator;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Files below the root whose names end in one of `endings`; build outputs and hidden folders are left out.
fn files(endings: &[&str]) -> Vec<PathBuf> {
    fn walk(folder: &Path, endings: &[&str], out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("a folder") {
            let entry = entry.expect("an entry");
            let (path, name) = (entry.path(), entry.file_name());
            let name = name.to_string_lossy();
            if entry.file_type().expect("a file type").is_dir() {
                if !name.starts_with('.') && name != "target" && name != "out" {
                    walk(&path, endings, out);
                }
            } else if endings.iter().any(|e| name.ends_with(e)) {
                out.push(path);
            }
        }
    }
    let mut out = Vec::new();
    // Other folders beside these are not part of the repository.
    for part in ["ad-core", "render", "optim", "examples", "tests", "docs"] {
        walk(&root().join(part), endings, &mut out);
    }
    for entry in fs::read_dir(root()).expect("the root") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_file() && endings.iter().any(|e| name.ends_with(e)) {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// The text as one line, without the markers of comments: what is cited may be broken across lines.
fn joined(text: &str) -> String {
    let words = text.lines().map(|line| {
        let line = line.trim();
        let marked = ["//!", "///", "//", "#"];
        let marker = marked.iter().find(|m| line.starts_with(**m));
        marker.map_or(line, |m| line[m.len()..].trim())
    });
    words.collect::<Vec<_>>().join(" ")
}

/// Letters with marks as ASCII writes them.
fn ascii(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        match c {
            'ä' => out.push_str("ae"),
            'ö' => out.push_str("oe"),
            'ü' => out.push_str("ue"),
            'é' | 'è' => out.push('e'),
            c => out.push(c),
        }
    }
    out
}

/// The key in the bibliography of `[Names 1999, where]`: `One1999`, `OneTwo1999` or `OneEtAl1999`.
fn citation_key(inside: &str) -> Option<String> {
    let (year_at, _) = inside.char_indices().find(|&(i, _)| {
        let year = inside.get(i..i + 4).unwrap_or_default();
        let century = year.starts_with("18") || year.starts_with("19") || year.starts_with("20");
        let after = inside[i..].chars().nth(4);
        century
            && year.chars().all(|c| c.is_ascii_digit())
            && inside[..i].ends_with(' ')
            && after.is_none_or(|c| c == ',')
    })?;
    let names = inside[..year_at].trim();
    let word = |w: &str| {
        let main = w.strip_prefix("d'").unwrap_or(w);
        main.starts_with(char::is_uppercase) && main.chars().all(|c| c.is_alphabetic() || c == '-')
    };
    let compact = |s: &str| ascii(&s.split([' ', '\'']).collect::<String>());
    let capitalised = |s: &str| !s.is_empty() && s.split_whitespace().all(word);
    let year = &inside[year_at..year_at + 4];
    let key = if let Some(first) = names.strip_suffix(" et al.") {
        capitalised(first).then(|| format!("{}EtAl", compact(first)))
    } else if let Some((first, last)) = names.split_once(" and ") {
        let many = first.contains(", ");
        let first = first.split(", ").next().unwrap_or_default();
        let two = || format!("{}{}", compact(first), compact(last));
        (capitalised(first) && capitalised(last)).then(|| {
            if many {
                format!("{}EtAl", compact(first))
            } else {
                two()
            }
        })
    } else {
        capitalised(names).then(|| compact(names))
    };
    key.map(|k| format!("{k}{year}"))
}

/// All citations in a text, with what stands in the brackets.
fn citations(text: &str) -> Vec<(String, String)> {
    let text = joined(text);
    let mut found = Vec::new();
    for (at, _) in text.match_indices('[') {
        let rest = &text[at + 1..];
        let Some(end) = rest.find([']', '[']) else {
            continue;
        };
        if rest[end..].starts_with(']') && end < 200 {
            for one in rest[..end].split("; ") {
                found.extend(citation_key(one).map(|key| (key, one.to_owned())));
            }
        }
    }
    found
}

/// Keys of errata such as `Z-4.13f`, `S-D3`, `Z-B-lobes`, `Z-footnote`, and of failures such as `F8`.
fn errata_keys(text: &str) -> BTreeSet<String> {
    let text = joined(text);
    let mut keys = BTreeSet::new();
    let bytes = text.as_bytes();
    let starts_word = |i: usize| {
        i == 0
            || !(bytes[i - 1].is_ascii_alphanumeric() || matches!(bytes[i - 1], b'_' | b':' | b'-'))
    };
    for (i, c) in text.char_indices() {
        if !starts_word(i) {
            continue;
        }
        let rest = &text[i + c.len_utf8()..];
        if "ZSVC".contains(c) && rest.starts_with('-') {
            let name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-');
            let end = rest.find(|c| !name(c)).unwrap_or(rest.len());
            let key = rest[1..end].trim_end_matches(['.', '-']);
            let first = key.chars().next().unwrap_or(' ');
            let named = [
                "footnote",
                "figure",
                "kernel",
                "erf",
                "theorem",
                "algorithm",
            ];
            let upper = first.is_ascii_uppercase()
                && key.chars().nth(1).is_none_or(|c| !c.is_ascii_lowercase());
            if first.is_ascii_digit() || upper || named.contains(&key) {
                keys.insert(format!("{c}-{key}"));
            }
        } else if c == 'F' {
            let end = rest
                .find(|c: char| !c.is_ascii_digit())
                .unwrap_or(rest.len());
            let word = rest[end..].starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
            // F0 is a reflectance.
            if (1..=2).contains(&end) && !rest.starts_with('0') && !word {
                keys.insert(format!("F{}", &rest[..end]));
            }
        }
    }
    keys
}

/// The keys that `docs/errata.md` defines: in bold in a paragraph that begins so, or first in a row of a table.
fn defined(errata: &str) -> BTreeSet<String> {
    let mut keys = BTreeSet::new();
    for paragraph in errata.split("\n\n") {
        if let Some(bold) = paragraph.strip_prefix("**") {
            // All that stands in bold.
            for piece in bold.split("**").step_by(2) {
                keys.extend(errata_keys(piece));
            }
        }
    }
    for line in errata.lines() {
        if let Some(row) = line.strip_prefix("| F") {
            let number = row.split(' ').next().unwrap_or_default();
            keys.insert(format!("F{number}"));
        } else if let Some(row) = line.strip_prefix("| B.") {
            let numbers = row.split('|').next().unwrap_or_default();
            for n in numbers.replace("B.", "").split(',') {
                keys.insert(format!("Z-B.{}", n.trim()));
            }
        }
    }
    keys
}

#[test]
fn scanners_find_what_is_written() {
    let cite = |s: &str| citations(s).into_iter().map(|c| c.0).collect::<Vec<_>>();
    assert_eq!(cite("see [Zeltner 2021, Eq. 4.38]."), ["Zeltner2021"]);
    assert_eq!(
        cite("//! after [Müller et\n//! al. 2017]"),
        ["MuellerEtAl2017"]
    );
    assert_eq!(
        cite("[Shirley and Chiu 1997] [Christensen, Salesin and DeRose 1993]"),
        ["ShirleyChiu1997", "ChristensenEtAl1993"]
    );
    assert_eq!(
        cite("[Heitz and d'Eon 2014, Eq. 19] [Levenberg 1944; Marquardt 1963]"),
        ["HeitzdEon2014", "Levenberg1944", "Marquardt1963"]
    );
    assert!(cite("[1990, 2000] [Self::Max 3] values[Index 2000x]").is_empty());
    let keys = |s: &str| errata_keys(s).into_iter().collect::<Vec<_>>();
    assert_eq!(
        keys("(errata Z-4.13f, F4) S-C1 to S-C4. Z-B-lobes and Z-footnote 4; errata\n/// V-13"),
        [
            "F4",
            "S-C1",
            "S-C4",
            "V-13",
            "Z-4.13f",
            "Z-B-lobes",
            "Z-footnote"
        ]
    );
    assert!(keys("FlatSamples::F16 UTF-8 F0 F123 F8x Z-axis AC-3 a S-shaped V-Ray").is_empty());
}

/// `[Name year]` in code and documents is a key of `REFERENCES.bib`.
#[test]
fn citations_resolve() {
    let bibliography = read("REFERENCES.bib");
    let keys: BTreeSet<_> = bibliography
        .lines()
        .filter_map(|l| l.strip_prefix('@')?.split_once('{')?.1.strip_suffix(','))
        .collect();
    let mut cited = BTreeSet::new();
    for path in files(&[".rs", ".py", ".md", ".toml"]) {
        // The examples of this file's own test.
        if path.ends_with("tests/documents.rs") {
            continue;
        }
        for (key, text) in citations(&read(&path)) {
            assert!(
                keys.contains(key.as_str()),
                "{}: [{text}]: expected an entry {key} in REFERENCES.bib, found none",
                path.display()
            );
            cited.insert(key);
        }
    }
    assert!(cited.len() >= 20, "found only {cited:?}");
}

/// Keys of errata and failures in the code stand in `docs/errata.md`, and sections that it is asked for exist.
#[test]
fn errata_resolve() {
    let errata = read("docs/errata.md");
    let defined = defined(&errata);
    let mut used = BTreeSet::new();
    for path in files(&[".rs", ".py", ".md"]) {
        let text = read(&path);
        // The examples of this file's own test.
        if path.ends_with("tests/documents.rs") {
            continue;
        }
        for key in errata_keys(&text) {
            assert!(
                defined.contains(&key),
                "{}: {key}: expected an entry in docs/errata.md, found none",
                path.display()
            );
            used.insert(key);
        }
        let lower = joined(&text).to_lowercase();
        for (at, _) in lower.match_indices("errata section ") {
            let number = lower[at + 15..].chars().next().unwrap_or(' ');
            assert!(
                errata.contains(&format!("\n## {number}. ")),
                "{}: errata section {number}: expected that section in docs/errata.md",
                path.display()
            );
        }
    }
    assert!(used.len() >= 50, "found only {used:?}");
    for failure in 1..=44 {
        assert!(
            defined.contains(&format!("F{failure}")),
            "no row F{failure}"
        );
    }
}

/// Headings of a document, as the addresses that links give them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut fenced = false;
    let mut out = BTreeSet::new();
    for line in text.lines() {
        fenced ^= line.trim_start().starts_with("```");
        if fenced || !line.starts_with('#') {
            continue;
        }
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title
            .chars()
            .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        out.insert(kept.map(|c| if c == ' ' { '-' } else { c }).collect());
    }
    out
}

/// Relative links of all documents lead to files, and to headings in them.
#[test]
fn links_resolve() {
    let mut links = 0;
    for path in files(&[".md"]) {
        let text = read(&path);
        let mut fenced = false;
        for line in text.lines() {
            fenced ^= line.trim_start().starts_with("```");
            if fenced {
                continue;
            }
            for (at, _) in line.match_indices("](") {
                let target = line[at + 2..].split(')').next().unwrap_or_default();
                if target.contains("://") || target.starts_with("mailto:") {
                    continue;
                }
                let (file, heading) = target.split_once('#').unwrap_or((target, ""));
                let file = match file {
                    "" => path.clone(),
                    file => path.parent().expect("a folder").join(file),
                };
                assert!(
                    file.exists(),
                    "{}: {target}: expected a file, found none",
                    path.display()
                );
                if !heading.is_empty() {
                    assert!(
                        anchors(&read(&file)).contains(heading),
                        "{}: {target}: expected a heading of that name, found none",
                        path.display()
                    );
                }
                links += 1;
            }
        }
    }
    assert!(links >= 40, "found only {links} links");
}

#[test]
fn front_pages_are_short() {
    for page in ["README.md", "ARCHITECTURE.md"] {
        let lines = read(page).lines().count();
        assert!(
            lines <= 200,
            "{page}: expected at most 200 lines, found {lines}"
        );
    }
}

/// The code of the README is that of the first example of `render`, which is compiled and run.
#[test]
fn the_readme_shows_code_that_runs() {
    let readme = read("README.md");
    let (_, shown) = readme.split_once("```rust\n").expect("code in the README");
    let (shown, _) = shown.split_once("```").expect("an end of the code");
    let library = read("render/src/lib.rs");
    let (_, run) = library
        .split_once("//! ```\n")
        .expect("an example in lib.rs");
    let (run, _) = run.split_once("//! ```\n").expect("an end of the example");
    let run: String = run
        .lines()
        .map(|l| l.strip_prefix("//!").unwrap_or(l))
        .map(|l| l.strip_prefix(' ').unwrap_or(l))
        .filter(|l| *l != "#" && !l.starts_with("# "))
        .map(|l| format!("{l}\n"))
        .collect();
    assert_eq!(shown, run);
}

/// Whether the documentation right above a line shows code.
fn has_example(lines: &[&str], at: usize) -> bool {
    let above = lines[..at].iter().rev().map(|l| l.trim_start());
    let mut above = above.take_while(|l| l.starts_with("//") || l.starts_with("#["));
    above.any(|l| l.starts_with("/// ```"))
}

/// The name that a line makes public as a function or a type, if it does.
fn public_item(line: &str) -> Option<&str> {
    let mut kinds = ["pub fn ", "pub struct ", "pub enum "].iter();
    let rest = kinds.find_map(|kind| line.strip_prefix(kind))?;
    rest.split(|c: char| !c.is_alphanumeric() && c != '_')
        .next()
}

/// What a user of `render` meets first has examples, which are run: functions and types of `instances`, methods that render
/// or differentiate among them, and all that the crate's root exports.
#[test]
fn the_front_door_has_examples() {
    let mut found = 0;
    let instances = read("render/src/instances.rs");
    let lines: Vec<&str> = instances.lines().collect();
    for (at, line) in lines.iter().enumerate() {
        let Some(name) = public_item(line.trim_start()) else {
            continue;
        };
        let computes = name.ends_with("_f32") || name.ends_with("_f64");
        if computes || !line.starts_with(' ') || name == "Estimator" {
            assert!(has_example(&lines, at), "instances::{name} has no example");
            found += 1;
        }
    }
    assert!(found > 15, "only {found} items found");

    let source = root().join("render/src");
    let library = read("render/src/lib.rs");
    let mut exported = BTreeSet::new();
    for line in library.lines().filter_map(|l| l.strip_prefix("pub use ")) {
        let (module, names) = line.split_once("::").expect("a module of the crate");
        let names = names.split(|c: char| !c.is_alphanumeric() && c != '_');
        exported.extend(names.filter(|n| !n.is_empty()).map(|n| (module, n)));
    }
    assert!(exported.len() > 5, "only {exported:?} found");
    for (module, name) in exported {
        let inside = |path: &&PathBuf| {
            let own = path.strip_prefix(&source).ok();
            own.is_some_and(|p| p.starts_with(module) || p == Path::new(&format!("{module}.rs")))
        };
        let shown = files(&[".rs"]).iter().filter(inside).any(|path| {
            let text = read(path);
            let lines: Vec<&str> = text.lines().collect();
            let defined = |at: &usize| public_item(lines[*at]) == Some(name);
            (0..lines.len())
                .filter(defined)
                .any(|at| has_example(&lines, at))
        });
        assert!(shown, "render::{name} has no example");
    }
}

/// Names in the first column of the tables of a document, in backticks.
fn listed(document: &str) -> Vec<String> {
    let rows = document.lines().filter_map(|l| l.strip_prefix("| `"));
    rows.filter_map(|l| Some(l.split_once('`')?.0.to_owned()))
        .collect()
}

/// The module of a figure, by the rule of `CONTRIBUTING.md`.
fn module_of(id: &str) -> String {
    let source = ["christensen", "stam", "veach", "zeltner"]
        .into_iter()
        .find_map(|s| Some((s, id.strip_prefix(s)?.strip_prefix('-')?)));
    let (source, rest) = source.unwrap_or(("own", id));
    let rest = rest.replace('-', "_");
    let number = rest.starts_with(|c: char| c.is_ascii_digit());
    format!("{source}/{}{rest}", if number { "fig_" } else { "" })
}

#[test]
fn the_id_of_a_figure_names_its_module() {
    for (id, module) in [
        ("zeltner-4-19", "zeltner/fig_4_19"),
        ("zeltner-4-2-2-env", "zeltner/fig_4_2_2_env"),
        ("stam-alg-b", "stam/alg_b"),
        ("veach-01a", "veach/fig_01a"),
        ("caustic-ring", "own/caustic_ring"),
    ] {
        assert_eq!(module_of(id), module);
    }
}

/// `docs/figures.md` lists every figure once, with the module that its id names, and nothing else. The binary calls that
/// module, and no other module has such a name.
#[test]
fn every_figure_is_listed() {
    let page = read("docs/figures.md");
    let mut listed = listed(&page);
    listed.sort();
    let mut figures = Vec::new();
    let mut modules = BTreeSet::new();
    for path in files(&[".rs"]) {
        let folder = path.parent().expect("a folder");
        if !folder.ends_with("examples/figures/src/bin") {
            continue;
        }
        let text = read(&path);
        if !text.contains("Figure::") {
            continue;
        }
        let id = path
            .file_stem()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        let row = page.lines().find(|l| l.starts_with(&format!("| `{id}` |")));
        let row = row.unwrap_or_else(|| panic!("docs/figures.md: no row `{id}`"));
        let module = row
            .split('|')
            .nth(2)
            .unwrap_or_default()
            .trim()
            .trim_matches('`');
        let expected = module_of(&id);
        assert_eq!(module, expected, "docs/figures.md: the module of `{id}`");
        let call = format!("{}::figure", expected.replace('/', "::"));
        let called = text.contains(&format!(" {call},")) || text.contains(&format!(" {call})"));
        assert!(called, "{}: expected a call of {call}", path.display());
        modules.insert(expected);
        figures.push(id);
    }
    figures.sort();
    assert!(figures.len() > 40, "found only {} figures", figures.len());
    assert_eq!(listed, figures);
    let folder = root().join("examples/figures/src");
    let mut made = BTreeSet::new();
    for path in files(&[".rs"]) {
        let Ok(below) = path.strip_prefix(&folder) else {
            continue;
        };
        if read(&path).contains("\npub fn figure(") {
            let below = below
                .with_extension("")
                .to_string_lossy()
                .replace('\\', "/");
            made.insert(below.trim_end_matches("/mod").to_owned());
        }
    }
    assert_eq!(made, modules);
}

/// The README's table of estimators is the list that tools print, row by row, and `auto` after it.
#[test]
fn every_estimator_is_listed() {
    let readme = read("README.md");
    let (_, section) = readme.split_once("\n## Estimators").expect("a section");
    let (section, _) = section.split_once("\n## ").expect("a next section");
    let listed: Vec<&str> = section.lines().filter(|l| l.starts_with("| `")).collect();
    let row = |e: &Estimator| {
        let (name, summary) = (e.name(), e.summary());
        format!("| `{name}` | {summary} | {} |", e.capabilities())
    };
    let known: Vec<String> = Estimator::ALL.iter().map(row).collect();
    let (auto, listed) = listed.split_last().expect("a table");
    assert!(auto.starts_with("| `auto` |"), "the last row: {auto}");
    let expected = known.join("\n");
    assert_eq!(
        listed.join("\n"),
        expected,
        "README.md: expected\n{expected}"
    );
    // What the words mean stands below.
    for (word, meaning) in Capabilities::LEGEND {
        let line = format!("*{word}*: {meaning}");
        assert!(unwrapped(section).contains(&line), "README.md: {line}");
    }
}

/// A text as one line.
fn unwrapped(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Every decision has a number of its own and the same three parts, and the list of decisions names them all.
#[test]
fn decisions_are_numbered_and_whole() {
    let index = read("docs/decisions/README.md");
    let mut pages: Vec<_> = files(&[".md"])
        .into_iter()
        .filter(|p| p.parent().is_some_and(|f| f.ends_with("docs/decisions")))
        .filter(|p| !p.ends_with("README.md"))
        .collect();
    pages.sort();
    assert!(pages.len() > 20, "found only {} decisions", pages.len());
    for (i, page) in pages.iter().enumerate() {
        let name = page.file_name().expect("a name").to_string_lossy();
        let number = format!("{:04}-", i + 1);
        assert!(
            name.starts_with(&number),
            "{name}: expected number {number}"
        );
        assert!(
            index.contains(&format!("({name})")),
            "{name} is not in the list"
        );
        let text = read(page);
        for part in [
            "\n## Context\n",
            "\n## Choice\n",
            "\n## Tried and measured\n",
        ] {
            assert!(text.contains(part), "{name}: no part {}", part.trim());
        }
    }
}
