//! `takt net dot`: a picture of a net, as an SVG that browsers show, or as DOT for graphviz. The net is not checked.

use std::path::PathBuf;

use clap::Args;
use takt_net::picture::Graph;
use takt_net::text::parse;
use takt_net::{Limits, Rejection};

use super::{complain_of, read};
use crate::Verdict;
use crate::output::say;

/// Draw a net.
///
/// Each box is a primitive with its connected ports and its parameters; a dashed link matters in the next cycle only.
#[derive(Debug, Args)]
pub(crate) struct Dot {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Print DOT, the language of graphviz, instead of an SVG.
    #[arg(long)]
    dot: bool,
}

impl Dot {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let mut faults = Vec::new();
        let root = parse(&text, &Limits::default(), &mut faults);
        if !faults.is_empty() {
            let name = self.file.display().to_string();
            complain_of(&Rejection { faults }, &name, &text);
            return Ok(Verdict::Failed);
        }
        let graph = Graph::of(&root);
        let picture = if self.dot { graph.dot() } else { graph.svg() };
        say(picture.trim_end())?;
        Ok(Verdict::Good)
    }
}
