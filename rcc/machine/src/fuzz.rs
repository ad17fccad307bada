//! Properties that hold for any file from outside, as functions that a fuzzer can call with any bytes and that panic if a
//! property is violated. Inputs are generated elsewhere.

use crate::component::{Component, Configuration};
use crate::diagnostic::Diagnostics;
use crate::properties::PropertyFile;

fn show(found: &Diagnostics, text: &str) {
    assert!(!found.all().is_empty());
    for diagnostic in found.all() {
        assert!(diagnostic.at.end <= text.len(), "{diagnostic:?}");
        assert!(!diagnostic.text.is_empty() && !diagnostic.hint.is_empty());
    }
    let _ = found.render("file", text);
}

/// A property file is rejected with diagnostics, or both forms of it can be read again with the same result.
///
/// # Panics
/// If it is not.
pub fn properties(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    for read in [PropertyFile::from_toml, PropertyFile::from_cpf] {
        let file = match read(&text) {
            Ok(file) => file,
            Err(found) => {
                show(&found, &text);
                continue;
            }
        };
        let toml = file.to_toml();
        assert_eq!(PropertyFile::from_toml(&toml).as_ref(), Ok(&file), "{toml}");
        if let Ok(cpf) = file.to_cpf() {
            assert_eq!(PropertyFile::from_cpf(&cpf).as_ref(), Ok(&file), "{cpf}");
        }
    }
}

/// A component file is rejected with diagnostics, or its net can be filled with its properties.
///
/// # Panics
/// If it is not.
pub fn component(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    match Component::parse(&text) {
        Ok((component, _)) => {
            let _ = component.net_text(&Configuration::of(&component));
        }
        Err(found) => show(&found, &text),
    }
}
