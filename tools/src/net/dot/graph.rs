//! A net as primitives and links, its fragments dissolved. Links that cannot be followed, such as one to a missing
//! child, are left out; `takt net check` reports them.

use std::collections::HashMap;

use takt_net::text::{Arg, ArgValue, Body, Fragment, Node, Source, SourceOf};

/// Ports of fragments in a row that a link is followed through.
const DEPTH_MAX: usize = 100;

/// Primitives and links.
#[derive(Debug, Default)]
pub(super) struct Graph {
    /// The primitives.
    pub(super) nodes: Vec<Primitive>,
    /// What feeds what.
    pub(super) links: Vec<Link>,
}

/// A primitive.
#[derive(Debug)]
pub(super) struct Primitive {
    /// Its name, with those of the fragments it is in.
    pub(super) path: String,
    /// Its type.
    pub(super) kind: String,
}

/// A link between two primitives, by their numbers.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Link {
    pub(super) from: usize,
    pub(super) to: usize,
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

/// Numbers of primitives, by where they stand in memory.
type Numbers<'t> = HashMap<*const Node<'t>, usize>;

impl Graph {
    /// The graph of a net.
    pub(super) fn of(root: &Fragment<'_>) -> Self {
        let (mut graph, mut numbers) = (Self::default(), Numbers::new());
        graph.add_children(root, "", &mut numbers);
        let scope = Scope {
            fragment: root,
            args: &[],
            outer: None,
        };
        graph.link_children(&scope, &numbers);
        graph
    }

    fn add_children<'t>(&mut self, fragment: &Fragment<'t>, path: &str, numbers: &mut Numbers<'t>) {
        for child in &fragment.children {
            let path = format!("{path}{}", child.name.text);
            self.add(&child.node, &path, numbers);
        }
        self.add_inline(&fragment.outs, path, numbers);
    }

    fn add<'t>(&mut self, node: &Node<'t>, path: &str, numbers: &mut Numbers<'t>) {
        let inside = format!("{path}.");
        match &node.body {
            Body::Primitive(kind) => {
                numbers.insert(node, self.nodes.len());
                self.nodes.push(Primitive {
                    path: path.to_owned(),
                    kind: kind.text.to_owned(),
                });
            }
            Body::Fragment(fragment) => self.add_children(fragment, &inside, numbers),
        }
        self.add_inline(&node.args, &inside, numbers);
    }

    /// Nodes that are written where they are used are called as the port they feed.
    fn add_inline<'t>(&mut self, args: &[Arg<'t>], path: &str, numbers: &mut Numbers<'t>) {
        for arg in args {
            if let Some(node) = inline(arg) {
                self.add(node, &format!("{path}{}", arg.name.text), numbers);
            }
        }
    }

    fn link_children(&mut self, scope: &Scope<'_>, numbers: &Numbers<'_>) {
        for child in &scope.fragment.children {
            self.link(&child.node, scope, numbers);
        }
        for node in scope.fragment.outs.iter().filter_map(inline) {
            self.link(node, scope, numbers);
        }
    }

    fn link(&mut self, node: &Node<'_>, scope: &Scope<'_>, numbers: &Numbers<'_>) {
        for node in node.args.iter().filter_map(inline) {
            self.link(node, scope, numbers);
        }
        match &node.body {
            Body::Primitive(kind) => {
                let to = numbers[&std::ptr::from_ref(node)];
                let is_late = kind.text.ends_with("Pre");
                let sources = node.args.iter().filter_map(source);
                let from = sources.filter_map(|source| follow(source, scope, numbers, 0));
                self.links
                    .extend(from.map(|from| Link { from, to, is_late }));
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

    /// By primitive, the length of the longest path to it; a cycle, which no good net has, ends it.
    pub(super) fn levels(&self) -> Vec<usize> {
        let mut levels = vec![0; self.nodes.len()];
        for _ in 0..self.nodes.len() {
            let before = levels.clone();
            for link in self.links.iter().filter(|link| !link.is_late) {
                levels[link.to] = levels[link.to].max(levels[link.from] + 1);
            }
            if levels == before {
                break;
            }
        }
        levels
    }
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

/// The primitive that a source comes from, through the ports of fragments.
fn follow(
    source: &Source<'_>,
    scope: &Scope<'_>,
    numbers: &Numbers<'_>,
    depth: usize,
) -> Option<usize> {
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
        Body::Primitive(_) => numbers.get(&std::ptr::from_ref(node)).copied(),
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
    use takt_net::Limits;
    use takt_net::text::parse;

    use super::Graph;

    fn graph(text: &str) -> Graph {
        let mut faults = Vec::new();
        let graph = Graph::of(&parse(text, &Limits::default(), &mut faults));
        assert_eq!(faults, []);
        graph
    }

    fn links(graph: &Graph) -> Vec<String> {
        let path = |node: usize| graph.nodes[node].path.as_str();
        let arrow = |is_late| if is_late { "~>" } else { "->" };
        let links = graph.links.iter();
        links
            .map(|l| format!("{} {} {}", path(l.from), arrow(l.is_late), path(l.to)))
            .collect()
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
        let expected = ["a -> f.b", "f.b ~> c", "c -> d.inFirst", "d.inFirst -> d"];
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
}
