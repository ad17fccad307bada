//! A net as a picture: an SVG that browsers show, or DOT for graphviz. Each box is a primitive with its connected ports and its
//! parameters. The net is not checked, and no values are shown; a page can add them by the names that the boxes carry.

mod graph;
mod layout;

pub use self::graph::Graph;
use self::graph::Primitive;
use self::layout::{HEAD, Layout, Point, Rect, port_y};

impl Graph {
    /// Number of primitives, the out ports of the whole net included.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether the net is empty.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// As DOT, the language of graphviz: a record for each primitive, with its ports.
    #[must_use]
    pub fn dot(&self) -> String {
        dot(self)
    }

    /// As an SVG. The group of a primitive has the class `primitive`, its path as `data-path`, its type as `data-type`, and its
    /// connected out ports as `data-outs`; a link has the port that it begins at as `data-from`.
    #[must_use]
    pub fn svg(&self) -> String {
        svg(self)
    }
}

fn dot(graph: &Graph) -> String {
    let mut text = "digraph net {\n  rankdir=LR;\n  node [shape=record, fontname=\"sans-serif\", fontsize=10];\n".to_owned();
    for (number, node) in graph.nodes.iter().enumerate() {
        let fields = |ports: &[String], letter: char| {
            let ports = ports.iter().enumerate();
            let ports = ports.map(|(i, port)| format!("<{letter}{i}> {}", in_record(port)));
            ports.collect::<Vec<_>>().join("|")
        };
        let (ins, outs) = (fields(&node.ins, 'i'), fields(&node.outs, 'o'));
        let (path, kind) = (in_record(&node.path), in_record(&node.kind));
        text += &format!("  n{number} [label=\"{path}\\n{kind}|{{{{{ins}}}|{{{outs}}}}}\"];\n");
    }
    for link in &graph.links {
        let ((from, out), (to, into)) = (link.from, link.to);
        let style = if link.is_late { " [style=dashed]" } else { "" };
        text += &format!("  n{from}:o{out}:e -> n{to}:i{into}:w{style};\n");
    }
    text + "}\n"
}

/// Text in the label of a record, whose fields braces, bars and angles separate.
fn in_record(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '\\' | '"' | '{' | '}' | '|' | '<' | '>' | ' ' => escaped.extend(['\\', c]),
            c if c.is_control() => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

fn svg(graph: &Graph) -> String {
    let layout = Layout::of(graph);
    let (width, height) = layout.size;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <g fill=\"none\" stroke=\"#0072b2\" stroke-opacity=\"0.7\">\n"
    );
    for (link, route) in graph.links.iter().zip(&layout.routes) {
        let dashes = if link.is_late {
            " stroke-dasharray=\"4 3\""
        } else {
            ""
        };
        let from = &graph.nodes[link.from.0];
        let port = from.outs.get(link.from.1).map_or("", String::as_str);
        let from = escaped(&format!("{}.{port}", from.path));
        svg += &format!(
            "<path d=\"{}\" data-from=\"{from}\"{dashes}/>\n",
            curve(route)
        );
    }
    svg += "</g>\n";
    for (node, place) in graph.nodes.iter().zip(&layout.boxes) {
        svg += &drawn(node, *place);
    }
    svg + "</svg>\n"
}

/// A box with its name, type and ports.
fn drawn(node: &Primitive, place: Rect) -> String {
    let Rect {
        x,
        y,
        width,
        height,
    } = place;
    let fill = if node.kind.is_empty() {
        "#fdf1dc"
    } else {
        "#f4f4f4"
    };
    let mut svg = format!(
        "<g class=\"primitive\" data-path=\"{}\" data-type=\"{}\" data-outs=\"{}\">\n\
         <rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"4\" fill=\"{fill}\" stroke=\"black\"/>\n\
         <text x=\"{tx}\" y=\"{}\" font-weight=\"bold\">{}</text>\n\
         <text x=\"{tx}\" y=\"{}\">{}</text>\n",
        escaped(&node.path),
        escaped(&node.kind),
        escaped(&node.outs.join(" ")),
        y + 13,
        escaped(&node.path),
        y + HEAD - 6,
        escaped(&node.kind),
        tx = x + 6,
    );
    let ports = node
        .ins
        .iter()
        .enumerate()
        .map(|(i, port)| (i, port, x + 6, "start"));
    let outs = node.outs.iter().enumerate();
    let outs = outs.map(|(i, port)| (i, port, x + width - 6, "end"));
    for (number, port, x, anchor) in ports.chain(outs) {
        let y = y + port_y(number) + 3;
        let port = escaped(port);
        svg += &format!(
            "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" font-size=\"9\" fill=\"#444\">{port}</text>\n"
        );
    }
    svg + "</g>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A path through points: curves across gutters, straight lines across columns.
fn curve(route: &[Point]) -> String {
    let Some((x, y)) = route.first() else {
        return String::new();
    };
    let mut path = format!("M{x} {y}");
    for (number, pair) in route.windows(2).enumerate() {
        let [(x, y), (to_x, to_y)] = [pair[0], pair[1]];
        if number % 2 == 1 {
            path += &format!("L{to_x} {to_y}");
        } else {
            let bend = (to_x - x) / 2;
            path += &format!("C{} {y} {} {to_y} {to_x} {to_y}", x + bend, to_x - bend);
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::process::{Command, Stdio};

    use super::*;
    use crate::limits::Limits;
    use crate::text::parse;

    const NET: &str = "{a=Core::Clock(), b=Core::DoubleMonoflop(inValue=a.outValue, To='{x:1}|\"<'), \
        c=Core::BooleanPre(inValue=b.outValue), outTerminate=c.outValue}";

    fn graph() -> Graph {
        let mut faults = Vec::new();
        Graph::of(&parse(NET, &Limits::default(), &mut faults))
    }

    #[test]
    fn dot_names_ports_and_net_outputs() {
        let text = dot(&graph());
        let expected = r#"digraph net {
  rankdir=LR;
  node [shape=record, fontname="sans-serif", fontsize=10];
  n0 [label="a\nCore::Clock|{{}|{<o0> outValue}}"];
  n1 [label="b\nCore::DoubleMonoflop|{{<i0> inValue|<i1> To='\{x:1\}\|\"\<'}|{<o0> outValue}}"];
  n2 [label="c\nCore::BooleanPre|{{<i0> inValue}|{<o0> outValue}}"];
  n3 [label="outTerminate\n|{{<i0> }|{}}"];
  n0:o0:e -> n1:i0:w;
  n1:o0:e -> n2:i0:w [style=dashed];
  n2:o0:e -> n3:i0:w;
}
"#;
        assert_eq!(text, expected);
    }

    #[test]
    fn dot_is_accepted_by_graphviz() {
        let child = Command::new("dot")
            .arg("-Tsvg")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let Ok(mut child) = child else {
            takt_tests::skip("dot_is_accepted_by_graphviz", "needs graphviz");
            return;
        };
        let mut input = child.stdin.take().unwrap();
        input.write_all(dot(&graph()).as_bytes()).unwrap();
        drop(input);
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{said}");
    }

    #[test]
    fn svg_shows_ports_parameters_and_net_outputs() {
        let svg = svg(&graph());
        for text in [
            "inValue",
            "outValue",
            "To='{x:1}|&quot;&lt;'",
            "outTerminate",
        ] {
            assert!(svg.contains(&format!(">{text}</text>")), "{text}: {svg}");
        }
        assert_eq!(svg.matches("<path").count(), 3);
        for part in [
            "data-path=\"b\" data-type=\"Core::DoubleMonoflop\" data-outs=\"outValue\"",
            "data-from=\"a.outValue\"",
        ] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
    }
}
