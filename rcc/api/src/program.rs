//! What controllers know this program by: who reads that a device is in use looks for it.

use std::path::Path;

/// Most characters of the name of a program.
const NAME_MAX: usize = 48;

/// Name and process of this program: of an interpreter the name of its script.
pub(crate) fn name() -> String {
    let mut arguments = std::env::args_os().map(|it| it.to_string_lossy().into_owned());
    let [executable, script] = [(); 2].map(|()| arguments.next().unwrap_or_default());
    format!(
        "{}, process {}",
        of(&executable, &script),
        std::process::id()
    )
}

fn of(executable: &str, script: &str) -> String {
    let name = |path: &str| {
        let name = Path::new(path).file_name().unwrap_or_default();
        let name = name.to_string_lossy();
        name.chars()
            .filter(|it| !it.is_control())
            .take(NAME_MAX)
            .collect::<String>()
    };
    let is_script = name(executable).starts_with("python") && !script.starts_with('-');
    let found = name(if is_script { script } else { executable });
    if found.is_empty() {
        name(executable)
    } else {
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn program_is_named_by_its_script() {
        assert_eq!(of("/usr/bin/python3.11", "cells/paint.py"), "paint.py");
        assert_eq!(of("/usr/bin/python3", "-c"), "python3");
        assert_eq!(of("python3", ""), "python3");
        assert_eq!(of("target/debug/cell", "left"), "cell");
        assert_eq!(of("", ""), "");
        assert_eq!(of("a\nb", "").chars().count(), 2);
        assert_eq!(of(&"x".repeat(500), "").len(), NAME_MAX);
        assert!(name().ends_with(&std::process::id().to_string()));
    }
}
