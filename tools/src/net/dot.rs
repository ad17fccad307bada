//! `takt net dot`: a picture of a net, sources on the left, each primitive right of all that feed it. An SVG, so that
//! browsers show it. The net is not checked.

mod graph;

use std::path::PathBuf;

use clap::Args;
use takt_net::text::parse;
use takt_net::{Limits, Rejection};

use self::graph::Graph;
use super::{complain_of, read};
use crate::Verdict;
use crate::output::say;

/// Draw a net.
#[derive(Debug, Args)]
pub(crate) struct Dot {
    /// The net; `-` for standard input.
    file: PathBuf,
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
        say(svg(&Graph::of(&root)).trim_end())?;
        Ok(Verdict::Good)
    }
}

/// Sizes in pixels.
const BOX: (usize, usize) = (170, 32);
const PITCH: (usize, usize) = (230, 42);
const MARGIN: usize = 12;

/// The left upper corner of each primitive. Within a column, what has its sources higher stands higher.
fn positions(graph: &Graph) -> Vec<(usize, usize)> {
    let levels = graph.levels();
    let mut rows = vec![0; levels.len()];
    for level in 0..=levels.iter().copied().max().unwrap_or(0) {
        let of_level = (0..levels.len()).filter(|node| levels[*node] == level);
        let mut column: Vec<_> = of_level
            .map(|node| (mean_row(graph, node, &levels, &rows), node))
            .collect();
        column.sort_unstable();
        for (row, (_, node)) in column.into_iter().enumerate() {
            rows[node] = row;
        }
    }
    let position = |(level, row)| (MARGIN + level * PITCH.0, MARGIN + row * PITCH.1);
    levels.into_iter().zip(rows).map(position).collect()
}

/// Mean row of a primitive's sources, in hundredths; those further right have no row yet.
fn mean_row(graph: &Graph, node: usize, levels: &[usize], rows: &[usize]) -> usize {
    let sources = graph.links.iter().filter(|link| link.to == node);
    let placed = sources.filter(|link| levels[link.from] < levels[node]);
    let rows: Vec<_> = placed.map(|link| rows[link.from]).collect();
    100 * rows.iter().sum::<usize>() / rows.len().max(1)
}

fn svg(graph: &Graph) -> String {
    let positions = positions(graph);
    let width = positions.iter().map(|p| p.0).max().unwrap_or(0) + BOX.0 + MARGIN;
    let height = positions.iter().map(|p| p.1).max().unwrap_or(0) + BOX.1 + MARGIN;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <g fill=\"none\" stroke=\"#0072b2\" stroke-opacity=\"0.6\">\n"
    );
    for link in &graph.links {
        let dashes = if link.is_late {
            " stroke-dasharray=\"4 3\""
        } else {
            ""
        };
        svg += &format!(
            "<path d=\"{}\"{dashes}/>\n",
            curve(positions[link.from], positions[link.to])
        );
    }
    svg += "</g>\n";
    for (node, (x, y)) in graph.nodes.iter().zip(positions) {
        svg += &format!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" rx=\"4\" fill=\"#f4f4f4\" stroke=\"black\"/>\n\
             <text x=\"{tx}\" y=\"{}\" font-weight=\"bold\">{}</text>\n\
             <text x=\"{tx}\" y=\"{}\">{}</text>\n",
            BOX.0,
            BOX.1,
            y + 13,
            node.path,
            y + 26,
            node.kind,
            tx = x + 6,
        );
    }
    svg + "</svg>\n"
}

/// From the right side of one box to the left side of another.
fn curve(from: (usize, usize), to: (usize, usize)) -> String {
    let (x, y) = (from.0 + BOX.0, from.1 + BOX.1 / 2);
    let (to_x, to_y) = (to.0, to.1 + BOX.1 / 2);
    let bend = (PITCH.0 - BOX.0) / 2;
    let to_bend = to_x.saturating_sub(bend);
    format!("M{x} {y}C{} {y} {to_bend} {to_y} {to_x} {to_y}", x + bend)
}
