//! A machine as a graph of its states, for pictures: DOT for graphviz and an SVG that browsers show.

use std::fmt::Write as _;

use crate::machine::code::Program;

/// A machine as a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Graph {
    /// Name of the machine.
    pub name: String,
    /// Its states, in the order of the text.
    pub nodes: Vec<Node>,
    /// Its transitions, in the order of the text: one edge for all those between the same two states.
    pub edges: Vec<Edge>,
}

/// A state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Whether the machine begins there.
    pub is_initial: bool,
    /// Whether the machine ends there.
    pub is_final: bool,
    /// Whether the machine is there.
    pub is_current: bool,
}

/// The transitions from one state to another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Number of the state that it leaves.
    pub from: usize,
    /// Number of the state that it enters.
    pub to: usize,
    /// Event and condition of each transition, in the order of the text; empty if it has none.
    pub labels: Vec<String>,
}

impl Program {
    /// A machine as a graph; 0 is the outermost one. `current` is the state to mark, such as that of a running machine.
    #[must_use]
    pub fn graph(&self, machine: usize, current: Option<usize>) -> Option<Graph> {
        let machine = self.machines.get(machine)?;
        let nodes = machine
            .states
            .iter()
            .enumerate()
            .map(|(index, state)| Node {
                name: state.name.clone(),
                is_initial: index == machine.initial,
                is_final: index == machine.last,
                is_current: current == Some(index),
            });
        let mut edges: Vec<Edge> = Vec::new();
        for (from, state) in machine.states.iter().enumerate() {
            for transition in &state.transitions {
                let (to, label) = (transition.target, transition.label.clone());
                let same = edges.iter_mut().find(|it| (it.from, it.to) == (from, to));
                match same {
                    Some(edge) => edge.labels.push(label),
                    None => edges.push(Edge {
                        from,
                        to,
                        labels: vec![label],
                    }),
                }
            }
        }
        Some(Graph {
            name: machine.name.clone(),
            nodes: nodes.collect(),
            edges,
        })
    }
}

/// Size of a state, and least distance from it to the next one, pixels.
const WIDTH: i32 = 180;
const HEIGHT: i32 = 40;
const GAP: i32 = 50;
/// Height of a label's line, pixels.
const LINE: i32 = 12;
/// Longest label, characters.
const LABEL_MAX: usize = 48;

impl Graph {
    /// As DOT, the language of graphviz.
    #[must_use]
    pub fn dot(&self) -> String {
        let mut out = format!(
            "digraph \"{}\" {{\n  node [shape=box, style=rounded, fontname=\"sans-serif\"];\n  edge [fontname=\"sans-serif\", fontsize=10];\n",
            self.name
        );
        for (index, node) in self.nodes.iter().enumerate() {
            let mut more = String::new();
            if node.is_initial {
                more.push_str(", penwidth=2");
            }
            if node.is_final {
                more.push_str(", peripheries=2");
            }
            if node.is_current {
                more.push_str(", style=\"rounded,filled\", fillcolor=\"#fdf1dc\"");
            }
            let _ = writeln!(out, "  s{index} [label=\"{}\"{more}];", node.name);
        }
        for edge in &self.edges {
            let labels = edge.labels.iter();
            let labels = labels.map(|it| it.replace('\\', "\\\\").replace('"', "\\\""));
            let label = labels.collect::<Vec<_>>().join("\\n");
            let _ = writeln!(out, "  s{} -> s{} [label=\"{label}\"];", edge.from, edge.to);
        }
        out.push_str("}\n");
        out
    }

    /// As an SVG: states in a column, in the order of the text; transitions to the next state run straight, others in
    /// lanes, downwards on the right and upwards on the left.
    #[must_use]
    pub fn svg(&self) -> String {
        let pixels = |count: usize| i32::try_from(count).unwrap_or(i32::MAX / 1000);
        let lanes = pixels(self.edges.len());
        let left = 40 + 14 * lanes;
        let (tops, end) = self.tops();
        let (width, height) = (left + WIDTH + 14 * lanes + 360, end + 20);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
             <defs><marker id=\"a\" markerWidth=\"8\" markerHeight=\"8\" refX=\"7\" refY=\"4\" orient=\"auto\"><path d=\"M0,0 L8,4 L0,8 z\" fill=\"#0072b2\"/></marker></defs>\n"
        );
        let top = |index: usize| tops.get(index).copied().unwrap_or(end);
        // Lines of labels beside each state, on the right and on the left.
        let mut beside = vec![[0; 2]; self.nodes.len()];
        for (lane, edge) in self.edges.iter().enumerate() {
            let mut line = |side: usize| {
                let lines = beside
                    .get_mut(edge.from)
                    .and_then(|sides| sides.get_mut(side));
                let lines = lines.map(|lines| {
                    let before = *lines;
                    *lines += pixels(edge.labels.len());
                    before
                });
                LINE * lines.unwrap_or(0)
            };
            let (from, to, offset) = (top(edge.from), top(edge.to), 14 * (pixels(lane) + 1));
            // Ends of links spread over the side of a state.
            let shift = 6 + (pixels(lane) * 5) % (HEIGHT - 12);
            let (path, x, y, anchor) = if edge.to == edge.from + 1 {
                let x = left + WIDTH / 2;
                (
                    format!("M{x},{} L{x},{to}", from + HEIGHT),
                    x + 6,
                    (from + HEIGHT + to) / 2 - LINE * (pixels(edge.labels.len()) - 1) / 2,
                    "start",
                )
            } else if edge.to > edge.from {
                let (x, right) = (left + WIDTH, left + WIDTH + offset);
                let (a, b) = (from + shift, to + shift);
                (
                    format!("M{x},{a} L{right},{a} L{right},{b} L{x},{b}"),
                    right + 4,
                    from + 18 + line(0),
                    "start",
                )
            } else {
                let (x, out) = (left, left - offset);
                let (a, b) = (from + shift, to + HEIGHT - shift);
                (
                    format!("M{x},{a} L{out},{a} L{out},{b} L{x},{b}"),
                    out + 4,
                    from + 18 + line(1),
                    "start",
                )
            };
            let _ = writeln!(
                out,
                "<path d=\"{path}\" fill=\"none\" stroke=\"#0072b2\" marker-end=\"url(#a)\"/>"
            );
            for (line, label) in edge.labels.iter().enumerate() {
                let (y, label) = (y + LINE * pixels(line), escaped(label));
                let _ = writeln!(
                    out,
                    "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" font-size=\"10\" fill=\"#444\">{label}</text>"
                );
            }
        }
        for (index, node) in self.nodes.iter().enumerate() {
            node.draw((left, top(index)), &mut out);
        }
        out.push_str("</svg>\n");
        out
    }
}

impl Graph {
    /// Upper ends of the states, and the lower end of all: below a state is room for the labels of its transitions.
    fn tops(&self) -> (Vec<i32>, i32) {
        let mut y = 20;
        let tops = (0..self.nodes.len()).map(|index| {
            let own = || self.edges.iter().filter(|edge| edge.from == index);
            let lines = |is: fn(&Edge) -> bool| {
                let lines = own().filter(|edge| is(edge)).map(|edge| edge.labels.len());
                LINE * i32::try_from(lines.sum::<usize>()).unwrap_or(i32::MAX / 1000)
            };
            let below = lines(|edge| edge.to == edge.from + 1) + 26;
            let right = lines(|edge| edge.to > edge.from + 1);
            let left = lines(|edge| edge.to <= edge.from);
            let top = y;
            y += HEIGHT + GAP.max(below).max(right.max(left) + 18 - HEIGHT);
            top
        });
        (tops.collect(), y)
    }
}

impl Node {
    /// Draws the state at a left upper corner.
    fn draw(&self, (x, y): (i32, i32), out: &mut String) {
        let node = self;
        let fill = if node.is_current {
            "#fdf1dc"
        } else {
            "#f4f4f4"
        };
        let line = if node.is_initial { 3 } else { 1 };
        let _ = writeln!(
            out,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" rx=\"8\" fill=\"{fill}\" stroke=\"black\" stroke-width=\"{line}\"/>"
        );
        if node.is_final {
            let _ = writeln!(
                out,
                "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"6\" fill=\"none\" stroke=\"black\"/>",
                x + 3,
                y + 3,
                WIDTH - 6,
                HEIGHT - 6
            );
        }
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\" font-weight=\"bold\">{}</text>",
            x + WIDTH / 2,
            y + HEIGHT / 2 + 4,
            escaped(&node.name)
        );
    }
}

fn escaped(text: &str) -> String {
    let mut short: String = text.chars().take(LABEL_MAX).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    quick_xml::escape::escape(short).into_owned()
}
