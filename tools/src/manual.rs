//! Manual pages and shell completions, made from the command line itself so that they cannot differ from it. For
//! packages of `takt`; it installs nothing.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, CommandFactory as _};
use clap_complete::Shell;

use crate::Verdict;

/// Write manual pages and shell completions.
#[derive(Debug, Args)]
pub(crate) struct Manual {
    /// Folder they are written to; it is made if need be.
    folder: PathBuf,
}

impl Manual {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        write(&self.folder)
            .with_context(|| format!("cannot write to {}", self.folder.display()))?;
        Ok(Verdict::Good)
    }
}

fn write(folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut command = crate::Arguments::command();
    clap_mangen::generate_to(command.clone(), folder)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        clap_complete::generate_to(shell, &mut command, "takt", folder)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manual_covers_every_subcommand_and_shell() {
        let folder = std::env::temp_dir().join(format!("takt-manual-{}", std::process::id()));
        write(&folder).unwrap();
        let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        assert!(text("takt.1").contains(".TH takt 1"));
        assert!(text("takt-run.1").contains("cell.toml"));
        assert!(text("takt-net-load.1").contains("Load a net"));
        for completion in ["takt.bash", "_takt", "takt.fish"] {
            assert!(text(completion).contains("primitives"), "{completion}");
        }
        assert!(!folder.join("takt-manual.1").exists(), "hidden");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
