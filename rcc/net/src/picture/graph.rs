//! A net as primitives and links, its fragments dissolved. Links that cannot be followed, such as one to a missing
//! child, are left out; `takt net check` reports them.

use std::collections::HashMap;

use crate::text::{Arg, ArgValue, Body, Fragment, Node, Source, SourceOf};

/// Ports of fragments in a row that a link is followed through.
const DEPTH_MAX: usize = 100;
/// Characters of a parameter that are shown.
const PARAMETER_MAX: usize = 20;

/// Primitives and links.
#[derive(Debug, Default)]
pub struct Graph {
    /// The primitives, then the out ports of the whole net.
    pub(super) nodes: Vec<Primitive>,
    /// What feeds what.
    pub(super) links: Vec<Link>,
}

/// A primitive, or an out port of the whole net, which stands for what reads it.
#[derive(Debug, Default)]
pub(super) struct Primitive {
    /// Its name, with those of the fragments it is in.
    pub(super) path: String,
    /// Its type; empty for an out port of the net.
    pub(super) kind: String,
    /// Its connected in ports, then its parameters, such as `To='0.5'`.
    pub(super) ins: Vec<String>,
    /// Its connected out ports.
    pub(super) outs: Vec<String>,
}

impl Primitive {
    /// The number of the out port of that name, which is added if it is new.
    fn out(&mut self, port: &str) -> usize {
        let known = self.outs.iter().position(|out| out == port);
        known.unwrap_or_else(|| {
            self.outs.push(port.to_owned());
            self.outs.len() - 1
        })
    }
}

/// A port: the number of its primitive, and its own among the in ports or out ports.
pub(super) type Port = (usize, usize);

/// A link from an out port to an in port.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Link {
    pub(super) from: Port,
    pub(super) to: Port,
    /// Whether it matters in the next cycle only: it leads into a Pre.
    pub(super) is_late: bool,
}

/// A fragment seen from inside.
#[derive(Clone, Copy, Debug)]
struct Scope<'s> {
    fragment: &'s Fragment<'s>,
    /// What its in ports are fed with.
    args: &'s [Arg<'s>],
    outer: Option<&'s Scope<'s>>,
}

/// Numbers of primitives, by where the name of their type begins in the text.
type Numbers = HashMap<usize, usize>;

impl Graph {
    /// The graph of a net.
    #[must_use]
    pub fn of(root: &Fragment<'_>) -> Self {
        let (mut graph, mut numbers) = (Self::default(), Numbers::new());
        graph.add_children(root, "", &mut numbers);
        let scope = Scope {
            fragment: root,
            args: &[],
            outer: None,
        };
        graph.link_children(&scope, &numbers);
        for out in &root.outs {
            let name = out.name.text.to_owned();
            let Some(from) = source(out).and_then(|from| follow(from, &scope, &numbers, 0)) else {
                continue;
            };
            graph.nodes.push(Primitive {
                path: name,
                ins: vec![String::new()],
                ..Primitive::default()
            });
            graph.add_link(&from, (graph.nodes.len() - 1, 0), false);
        }
        graph
    }

    fn add_children(&mut self, fragment: &Fragment<'_>, path: &str, numbers: &mut Numbers) {
        for child in &fragment.children {
            let path = format!("{path}{}", child.name.text);
            self.add(&child.node, &path, numbers);
        }
        self.add_inline(&fragment.outs, path, numbers);
    }

    fn add(&mut self, node: &Node<'_>, path: &str, numbers: &mut Numbers) {
        let inside = format!("{path}.");
        match &node.body {
            Body::Primitive(kind) => {
                numbers.insert(kind.start, self.nodes.len());
                self.nodes.push(Primitive {
                    path: path.to_owned(),
                    kind: kind.text.to_owned(),
                    ..Primitive::default()
                });
            }
            Body::Fragment(fragment) => self.add_children(fragment, &inside, numbers),
        }
        self.add_inline(&node.args, &inside, numbers);
    }

    /// Nodes that are written where they are used are called as the port they feed.
    fn add_inline(&mut self, args: &[Arg<'_>], path: &str, numbers: &mut Numbers) {
        for arg in args {
            if let Some(node) = inline(arg) {
                self.add(node, &format!("{path}{}", arg.name.text), numbers);
            }
        }
    }

    fn link_children(&mut self, scope: &Scope<'_>, numbers: &Numbers) {
        for child in &scope.fragment.children {
            self.link(&child.node, scope, numbers);
        }
        for node in scope.fragment.outs.iter().filter_map(inline) {
            self.link(node, scope, numbers);
        }
    }

    fn link(&mut self, node: &Node<'_>, scope: &Scope<'_>, numbers: &Numbers) {
        for node in node.args.iter().filter_map(inline) {
            self.link(node, scope, numbers);
        }
        match &node.body {
            Body::Primitive(kind) => {
                let to = numbers[&kind.start];
                let is_late = kind.text.ends_with("Pre");
                for arg in &node.args {
                    let from = source(arg).and_then(|from| follow(from, scope, numbers, 0));
                    if let Some(from) = from {
                        let ins = &mut self.nodes[to].ins;
                        ins.push(arg.name.text.to_owned());
                        let port = (to, ins.len() - 1);
                        self.add_link(&from, port, is_late);
                    }
                }
                let parameters = node.args.iter().filter_map(parameter);
                self.nodes[to].ins.extend(parameters);
            }
            Body::Fragment(fragment) => {
                let inner = Scope {
                    fragment,
                    args: &node.args,
                    outer: Some(scope),
                };
                self.link_children(&inner, numbers);
            }
        }
    }

    fn add_link(&mut self, (from, port): &(usize, String), to: Port, is_late: bool) {
        let port = self.nodes[*from].out(port);
        self.links.push(Link {
            from: (*from, port),
            to,
            is_late,
        });
    }

    /// By primitive, the length of the longest path to it; a cycle, which no good net has, ends it.
    pub(super) fn levels(&self) -> Vec<usize> {
        let mut levels = vec![0; self.nodes.len()];
        for _ in 0..self.nodes.len() {
            let before = levels.clone();
            for link in self.links.iter().filter(|link| !link.is_late) {
                let (from, to) = (link.from.0, link.to.0);
                levels[to] = levels[to].max(levels[from] + 1);
            }
            if levels == before {
                break;
            }
        }
        levels
    }
}

/// A parameter as the net has it, shortened.
fn parameter(arg: &Arg<'_>) -> Option<String> {
    let ArgValue::Text(text, _) = &arg.value else {
        return None;
    };
    let mut shown: String = text.chars().take(PARAMETER_MAX).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    Some(format!("{}='{shown}'", arg.name.text))
}

const fn source<'a, 't>(arg: &'a Arg<'t>) -> Option<&'a Source<'t>> {
    match &arg.value {
        ArgValue::Link(source) => Some(source),
        ArgValue::Text(..) => None,
    }
}

fn inline<'a, 't>(arg: &'a Arg<'t>) -> Option<&'a Node<'t>> {
    match &source(arg)?.of {
        SourceOf::Inline(node) => Some(node),
        SourceOf::Child(_) => None,
    }
}

fn named<'a, 't>(args: &'a [Arg<'t>], port: &str) -> Option<&'a Source<'t>> {
    args.iter()
        .find(|arg| arg.name.text == port)
        .and_then(source)
}

/// The primitive and the out port that a source comes from, through the ports of fragments.
fn follow(
    source: &Source<'_>,
    scope: &Scope<'_>,
    numbers: &Numbers,
    depth: usize,
) -> Option<(usize, String)> {
    if depth > DEPTH_MAX {
        return None;
    }
    let port = source.port.text;
    let node = match &source.of {
        SourceOf::Inline(node) => node,
        SourceOf::Child(name) if name.text == "parent" => {
            return follow(named(scope.args, port)?, scope.outer?, numbers, depth + 1);
        }
        SourceOf::Child(name) => {
            let mut children = scope.fragment.children.iter();
            &children.find(|child| child.name.text == name.text)?.node
        }
    };
    match &node.body {
        Body::Primitive(kind) => Some((*numbers.get(&kind.start)?, port.to_owned())),
        Body::Fragment(fragment) => {
            let inner = Scope {
                fragment,
                args: &node.args,
                outer: Some(scope),
            };
            follow(named(&fragment.outs, port)?, &inner, numbers, depth + 1)
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::Limits;
    use crate::text::parse;

    use super::{Graph, Link};

    fn graph(text: &str) -> Graph {
        let mut faults = Vec::new();
        let graph = Graph::of(&parse(text, &Limits::default(), &mut faults));
        assert_eq!(faults, []);
        graph
    }

    fn links(graph: &Graph) -> Vec<String> {
        let arrow = |is_late| if is_late { "~>" } else { "->" };
        let text = |link: &Link| {
            let (from, to) = (&graph.nodes[link.from.0], &graph.nodes[link.to.0]);
            let (out, into) = (&from.outs[link.from.1], &to.ins[link.to.1]);
            format!(
                "{}.{out} {} {}.{into}",
                from.path,
                arrow(link.is_late),
                to.path
            )
        };
        graph.links.iter().map(text).collect()
    }

    #[test]
    fn links_are_followed_through_fragments() {
        let graph = graph(
            "{a=Core::Clock(),
              f={b=Core::DoubleAdd(inFirst=parent.inX), outY=b.outValue}(inX=a.outValue),
              c=Core::DoublePre(inValue=f.outY),
              d=Core::DoubleAdd(inFirst=Core::DoubleSin(inValue=c.outValue).outValue),
              outTerminate=d.outValue}",
        );
        let expected = [
            "a.outValue -> f.b.inFirst",
            "f.b.outValue ~> c.inValue",
            "c.outValue -> d.inFirst.inValue",
            "d.inFirst.outValue -> d.inFirst",
            "d.outValue -> outTerminate.",
        ];
        assert_eq!(links(&graph), expected);
    }

    #[test]
    fn levels_grow_along_links_and_cycles_end() {
        let line = graph("{a=Core::Clock(), b=X(inV=a.outV), c=X(inV=b.outV, inW=a.outV)}");
        assert_eq!(line.levels(), [0, 1, 2]);
        let cycle = graph("{a=X(inV=b.outV), b=X(inV=a.outV), c=X(inV=missing.outV)}");
        assert!(cycle.levels().iter().all(|level| *level <= 6));
        let own_tail = graph("{f={outY=parent.inX}(inX=f.outY), a=X(inV=f.outY)}");
        assert!(own_tail.links.is_empty());
    }

    #[test]
    fn ports_and_parameters_are_listed() {
        let graph = graph(
            "{a=X(Long='a text of more than twenty letters', inV=b.outW, Max='2'), b=Y(), outTerminate=b.outW}",
        );
        let expected = ["inV", "Long='a text of more than …'", "Max='2'"];
        assert_eq!(graph.nodes[0].ins, expected);
        assert_eq!(graph.nodes[1].outs, ["outW"]);
        assert_eq!(graph.nodes[2].path, "outTerminate");
    }
}
