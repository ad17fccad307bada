//! Help texts and all `console` blocks of the README, run and compared. Examples that need a robot are in `text` blocks there.

#[test]
fn console_blocks_and_help_are_as_written() {
    // As readers do, from the root of the checkout.
    let package = env!("CARGO_MANIFEST_DIR");
    std::env::set_current_dir(format!("{package}/..")).unwrap();
    trycmd::TestCases::new()
        .case(format!("{package}/README.md"))
        .case(format!("{package}/tests/cmd/*.trycmd"));
}
