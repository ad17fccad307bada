//! The text files of the checkout, so that every rule is a pure function over them and its tests need no disk. Build
//! output and symbolic links are skipped.

use std::fs;
use std::path::Path;

use anyhow::Context;

/// One file. The text of a file that is not UTF-8 is empty.
#[derive(Debug)]
pub(crate) struct File {
    /// Relative to the root, `/` between parts.
    pub(crate) path: String,
    pub(crate) text: String,
}

/// All files, by path.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    pub(crate) files: Vec<File>,
}

impl Tree {
    pub(crate) fn load(root: &Path) -> anyhow::Result<Self> {
        let mut tree = Self::default();
        tree.walk(root, "")?;
        tree.files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(tree)
    }

    fn walk(&mut self, dir: &Path, prefix: &str) -> anyhow::Result<()> {
        let context = || format!("cannot list {}", dir.display());
        for entry in fs::read_dir(dir).with_context(context)? {
            let entry = entry.with_context(context)?;
            let path = format!("{prefix}{}", entry.file_name().to_string_lossy());
            let kind = entry.file_type().with_context(context)?;
            if kind.is_dir() && !is_foreign(&entry.path()) {
                self.walk(&entry.path(), &format!("{path}/"))?;
            } else if kind.is_file() {
                let text = fs::read_to_string(entry.path()).unwrap_or_default();
                self.files.push(File { path, text });
            }
        }
        Ok(())
    }

    /// A tree for the rules' tests.
    #[cfg(test)]
    pub(crate) fn of(files: &[(&str, &str)]) -> Self {
        let file = |(path, text): &(&str, &str)| File {
            path: (*path).into(),
            text: (*text).into(),
        };
        Self {
            files: files.iter().map(file).collect(),
        }
    }

    pub(crate) fn text(&self, path: &str) -> Option<&str> {
        let file = self.files.iter().find(|file| file.path == path)?;
        Some(&file.text)
    }

    /// True for a file and for a folder that holds one.
    pub(crate) fn exists(&self, path: &str) -> bool {
        let inside = format!("{}/", path.trim_end_matches('/'));
        self.files
            .iter()
            .any(|file| file.path == path || file.path.starts_with(&inside))
    }

    pub(crate) fn rust_files(&self) -> impl Iterator<Item = &File> {
        self.files.iter().filter(|file| file.path.ends_with(".rs"))
    }

    pub(crate) fn named<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a File> {
        self.files
            .iter()
            .filter(move |file| file_name(&file.path) == name)
    }
}

pub(crate) fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// The folder of a path; empty for the root.
pub(crate) fn parent(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(parent, _)| parent)
}

/// Folders that are not part of the project: version control, virtual environments, build output (which cargo marks as a
/// cache).
fn is_foreign(dir: &Path) -> bool {
    let name = dir.file_name().unwrap_or_default();
    name == ".git" || name == ".venv" || dir.join("CACHEDIR.TAG").is_file()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cargo;

    #[test]
    fn tree_finds_files_and_folders() {
        let tree = Tree::of(&[("a/b.rs", "x"), ("README.md", "")]);
        assert!(tree.exists("a") && tree.exists("a/") && tree.exists("a/b.rs"));
        assert!(!tree.exists("a/b") && !tree.exists("b.rs"));
        assert_eq!(tree.text("a/b.rs"), Some("x"));
        assert_eq!(tree.named("b.rs").count(), 1);
        assert_eq!(
            (parent("a/b/c"), parent("c"), file_name("a/b")),
            ("a/b", "", "b")
        );
    }

    #[test]
    fn tree_excludes_build_output() {
        let tree = Tree::load(&cargo::workspace_root().unwrap()).unwrap();
        assert!(tree.exists("tools/xtask/src/tree.rs"));
        assert!(
            !tree
                .files
                .iter()
                .any(|file| file.path.contains("/.fingerprint/"))
        );
        assert!(!tree.exists(".git"));
    }
}
