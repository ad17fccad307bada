//! The smallest program, which is the default of the primitive.

use super::*;

#[test]
fn default_object_code_is_current() {
    let program = compile("program nothing; endprogram;", &System::default(), "").unwrap();
    let bytes = program.program.encode();
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/nothing.hex");
    if std::env::var_os("TAKT_BLESS").is_some() {
        std::fs::write(path, &hex).unwrap();
    }
    assert_eq!(std::fs::read_to_string(path).unwrap(), hex);
}
