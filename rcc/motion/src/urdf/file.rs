//! The file of an arm on this host, and those of its meshes. It reads files: not for real-time threads.

use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

use super::{ArmModel, FILE_MAX, Finding, Shape, Urdf, UrdfError};

/// Why a file gives no arm.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be read.
    #[error("cannot read {path}: {source}\nhint: paths are relative to the folder of the file that names it", path = .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It describes no arm that can be used.
    #[error("{}", located(.path, .error))]
    Urdf {
        /// The file.
        path: PathBuf,
        /// All that is wrong.
        error: UrdfError,
    },
}

/// Each finding with file and line, and the hints behind them, each once.
fn located(path: &Path, error: &UrdfError) -> String {
    let mut lines = Vec::new();
    for Finding { line, cause, .. } in &error.findings {
        lines.push(format!("{}:{line}: {cause}", path.display()));
    }
    for Finding { hint, .. } in error.findings.iter().filter(|it| !it.hint.is_empty()) {
        let hint = format!("hint: {hint}");
        if !lines.contains(&hint) {
            lines.push(hint);
        }
    }
    lines.join("\n")
}

/// The arm of a file between two links, as [`Urdf::arm`] finds them, with the paths of its meshes.
///
/// # Errors
/// If it cannot be read, or describes no arm that can be used.
pub fn read_arm(path: &Path, base: Option<&str>, tip: Option<&str>) -> Result<ArmModel, FileError> {
    let text = read_text(path).map_err(|source| FileError::Read {
        path: path.to_owned(),
        source,
    })?;
    let arm = Urdf::parse(&text).and_then(|mut urdf| {
        urdf.find_meshes(path.parent().unwrap_or_else(|| Path::new("")));
        urdf.arm(base, tip)
    });
    let mut arm = arm.map_err(|error| FileError::Urdf {
        path: path.to_owned(),
        error,
    })?;
    let name = path.file_name().unwrap_or_default();
    arm.file = name.to_string_lossy().into_owned();
    Ok(arm)
}

/// The text of a file that is not too large; devices and pipes are none.
fn read_text(path: &Path) -> io::Result<String> {
    let about = fs::metadata(path)?;
    if !about.is_file() {
        return Err(io::Error::other("it is no file"));
    }
    if about.len() > FILE_MAX as u64 {
        let text = format!("it has more than {FILE_MAX} bytes");
        return Err(io::Error::other(text));
    }
    fs::read_to_string(path)
}

impl Urdf {
    /// Replaces the names of meshes by their paths: relative ones are in `folder`, `package://NAME/` is the folder of that name
    /// around it. A mesh that cannot be read keeps its name, with a warning at the line of its link.
    pub fn find_meshes(&mut self, folder: &Path) {
        for link in &mut self.links {
            for (_, shape) in &mut link.visuals {
                let Shape::Mesh(name, _) = shape else {
                    continue;
                };
                match find_mesh(name, folder) {
                    Ok(path) => *name = path,
                    Err(why) => self.warnings.push(Finding {
                        line: link.line,
                        cause: format!("the mesh `{name}` of link `{}` {why}", link.name),
                        hint:
                            "the link is drawn without it; correct the path, or put the file there"
                                .to_owned(),
                    }),
                }
            }
        }
    }
}

fn find_mesh(name: &str, folder: &Path) -> Result<String, String> {
    let path = if let Some(within) = name.strip_prefix("package://") {
        in_package(within, folder).ok_or("is in a package that is not around the file")?
    } else {
        let path = name.strip_prefix("file://").unwrap_or(name);
        folder.join(path)
    };
    let is_file = fs::File::open(&path).and_then(|file| file.metadata());
    match is_file {
        Ok(about) if about.is_file() => Ok(()),
        Ok(_) => Err("is no file".to_owned()),
        Err(error) => Err(format!("cannot be read: {error}")),
    }?;
    let text = path.into_os_string().into_string();
    text.map_err(|_| "has a path that is no UTF-8".to_owned())
}

/// `NAME/PATH` in a folder of that name that contains `folder`, or lies beside one that does.
fn in_package(within: &str, folder: &Path) -> Option<PathBuf> {
    let (package, rest) = within.split_once('/')?;
    let is_plain = |path: &Path| {
        let mut parts = path.components();
        parts.all(|part| matches!(part, Component::Normal(_)))
    };
    if package.is_empty() || !is_plain(Path::new(package)) || !is_plain(Path::new(rest)) {
        return None;
    }
    let folder = folder.canonicalize().ok()?;
    folder.ancestors().find_map(|around| {
        let own = (around.file_name()? == package).then(|| around.to_owned());
        let beside = || Some(around.join(package)).filter(|it| it.is_dir());
        Some(own.or_else(beside)?.join(rest))
    })
}
