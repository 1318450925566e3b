//! Meaningless estimators do not compile, and the message says what to do.

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "checks the renderer once more: runs with --release"
)]
fn misuse_does_not_compile() {
    let t = trybuild::TestCases::new();
    t.compile_fail("tests/compile_fail/*.rs");
}
