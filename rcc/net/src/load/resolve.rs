//! Resolves names: the definition of each primitive, and the out port at which each link starts,
//! through any number of fragment borders. Parameter values are not inspected here.

use std::collections::HashMap;
use std::ops::Range;

use crate::fault::{FAULTS_MAX, Fault, FaultKind, similar};
use crate::load::LoadContext;
use crate::load::origin::{Origin, number};
use crate::load::resolved::{GuardInfo, Node, Resolved};
use crate::text::{Arg, ArgValue, Body, Fragment, Name, Node as TextNode, Source, SourceOf};
use crate::value::{Element, Type};

/// A fragment instance.
#[derive(Debug, Default)]
pub(super) struct Scope<'t> {
    pub(super) name: &'t str,
    pub(super) parent: Option<u32>,
    guard: u32,
    children: HashMap<&'t str, Member>,
    ins: HashMap<&'t str, &'t Arg<'t>>,
    outs: HashMap<&'t str, &'t Source<'t>>,
}

#[derive(Clone, Copy, Debug)]
enum Member {
    Node(u32),
    Scope(u32),
    /// Something that could not be resolved; the fault is already recorded.
    Broken,
}

/// Resolves all names of a net.
pub(super) fn resolve<'t>(
    tree: &'t Fragment<'t>,
    context: &LoadContext<'t>,
    faults: &mut Vec<Fault>,
) -> Resolved<'t> {
    let mut resolver = Resolver {
        context: *context,
        faults,
        nodes: Vec::new(),
        scopes: Vec::new(),
        guards: vec![GuardInfo::default()],
        guard_sources: Vec::new(),
        inline: HashMap::new(),
        known: HashMap::new(),
        bound_reported: false,
        taps: Vec::new(),
    };
    resolver.fragment(tree, "", None, 0, &[]);
    for node in 0..resolver.nodes.len() {
        if resolver.faults.len() < FAULTS_MAX {
            resolver.link_node(node);
        }
    }
    for (guard, scope, source) in std::mem::take(&mut resolver.guard_sources) {
        if resolver.faults.len() < FAULTS_MAX {
            let active = resolver.typed_origin(scope, source, "inActive", BOOL);
            resolver.guards[guard as usize].active = active;
        }
    }
    let root = resolver.link_root(tree);
    let taps = resolver.link_taps();
    let scopes = resolver.scopes.iter();
    Resolved {
        scopes: scopes.map(|scope| (scope.name, scope.parent)).collect(),
        nodes: resolver.nodes,
        guards: resolver.guards,
        root,
        taps,
    }
}

/// Upper bound on the known names that a fault keeps: one more than it shows.
const NAMES_MAX: usize = 13;
/// Upper bound on the characters that it keeps of each.
const NAME_CHARS_MAX: usize = 100;
const BOOL: Type = Type::scalar(Element::Bool);

pub(super) struct Resolver<'t, 'f> {
    context: LoadContext<'t>,
    faults: &'f mut Vec<Fault>,
    nodes: Vec<Node<'t>>,
    pub(super) scopes: Vec<Scope<'t>>,
    guards: Vec<GuardInfo>,
    /// Guards with the scope and source of their activation.
    guard_sources: Vec<(u32, u32, &'t Source<'t>)>,
    /// Inline nodes, by the first byte of their text.
    inline: HashMap<usize, Member>,
    /// The resolved sources of fragment ports, by the first byte of their port's name: links
    /// through many fragments are followed once, or else the load time would grow with the square
    /// of their number.
    known: HashMap<usize, Option<Origin>>,
    bound_reported: bool,
    /// Tapped ports, with the scope of their source.
    pub(super) taps: Vec<(u32, &'t Arg<'t>, String)>,
}

impl<'t> Resolver<'t, '_> {
    pub(super) fn fault(&mut self, kind: FaultKind, at: Range<usize>) {
        if self.faults.len() < FAULTS_MAX {
            self.faults.push(Fault::new(kind, at));
        }
    }

    /// Whether no fault was found so far.
    pub(super) fn is_faultless(&self) -> bool {
        self.faults.is_empty()
    }

    /// Enters a fragment and all its content.
    fn fragment(
        &mut self,
        fragment: &'t Fragment<'t>,
        name: &'t str,
        parent: Option<u32>,
        guard: u32,
        args: &'t [Arg<'t>],
    ) -> u32 {
        let scope = number(self.scopes.len());
        self.scopes.push(Scope {
            name,
            parent,
            guard,
            ..Scope::default()
        });
        for arg in args {
            if let ArgValue::Text(..) = arg.value {
                let kind = FaultKind::TextForPort {
                    port: arg.name.text.to_owned(),
                    parameter: None,
                };
                self.fault(kind, arg.name.span());
            }
            if self.scopes[scope as usize]
                .ins
                .insert(arg.name.text, arg)
                .is_some()
            {
                self.report_duplicate(arg.name);
            }
        }
        self.tap(&fragment.outs, None, scope);
        for out in &fragment.outs {
            let ArgValue::Link(source) = &out.value else {
                continue;
            };
            self.inline_source(source, scope);
            if self.scopes[scope as usize]
                .outs
                .insert(out.name.text, source)
                .is_some()
            {
                self.report_duplicate(out.name);
            }
        }
        for child in &fragment.children {
            let member = self.node(&child.node, child.name.text, scope);
            if self.scopes[scope as usize]
                .children
                .insert(child.name.text, member)
                .is_some()
            {
                self.report_duplicate(child.name);
            }
        }
        scope
    }

    fn report_duplicate(&mut self, name: Name<'_>) {
        self.fault(
            FaultKind::Twice {
                name: name.text.to_owned(),
            },
            name.span(),
        );
    }

    fn node(&mut self, node: &'t TextNode<'t>, name: &'t str, scope: u32) -> Member {
        self.tap(&node.args, Some(name), scope);
        for arg in &node.args {
            if let ArgValue::Link(source) = &arg.value {
                self.inline_source(source, scope);
            }
        }
        match &node.body {
            Body::Fragment(_) if self.scopes.len() > self.context.limits.primitives => {
                self.report_bound_exceeded("fragments", node);
                Member::Broken
            }
            Body::Fragment(fragment) => {
                let guard = self.guard(scope, &node.args);
                Member::Scope(self.fragment(fragment, name, Some(scope), guard, &node.args))
            }
            Body::Primitive(ty) => self.primitive(*ty, node, name, scope),
        }
    }

    /// The guard of a node with these arguments: its own if `inActive` is connected.
    fn guard(&mut self, scope: u32, args: &'t [Arg<'t>]) -> u32 {
        let parent = self.scopes[scope as usize].guard;
        let active = args.iter().find(|a| a.name.text == "inActive");
        let Some(Arg {
            value: ArgValue::Link(source),
            ..
        }) = active
        else {
            return parent;
        };
        let guard = number(self.guards.len());
        self.guards.push(GuardInfo {
            parent,
            active: None,
        });
        self.guard_sources.push((guard, scope, source));
        guard
    }

    fn primitive(
        &mut self,
        ty: Name<'t>,
        node: &'t TextNode<'t>,
        name: &'t str,
        scope: u32,
    ) -> Member {
        let Some(definition) = self.context.registry.find(ty.text) else {
            if self.faults.len() >= FAULTS_MAX {
                return Member::Broken;
            }
            let similar = self.context.registry.similar(ty.text).map(str::to_owned);
            let kind = FaultKind::UnknownPrimitive {
                name: ty.text.to_owned(),
                similar,
            };
            self.fault(kind, ty.span());
            return Member::Broken;
        };
        if self.nodes.len() >= self.context.limits.primitives {
            self.report_bound_exceeded("primitives", node);
            return Member::Broken;
        }
        let own_guard = definition.gated.then(|| self.guard(scope, &node.args));
        let member = number(self.nodes.len());
        self.nodes.push(Node {
            definition,
            name,
            at: node.at.clone(),
            scope,
            guard: own_guard.unwrap_or(self.scopes[scope as usize].guard),
            args: &node.args,
            links: vec![None; definition.inputs.len()],
            texts: vec![None; definition.parameters.len()],
        });
        Member::Node(member)
    }

    /// Reports, once, that the bound on primitives is exceeded.
    fn report_bound_exceeded(&mut self, item: &'static str, node: &TextNode<'_>) {
        let bound = self.context.limits.primitives;
        if !std::mem::replace(&mut self.bound_reported, true) {
            let found = bound + 1;
            let kind = FaultKind::Bound { item, found, bound };
            self.fault(kind, node.at.clone());
        }
    }

    /// Adds the node of an inline source.
    fn inline_source(&mut self, source: &'t Source<'t>, scope: u32) {
        if let SourceOf::Inline(node) = &source.of {
            let member = self.node(node, "(inline)", scope);
            self.inline.insert(node.at.start, member);
        }
    }

    fn link_node(&mut self, number: usize) {
        let Node {
            definition,
            scope,
            args,
            ..
        } = self.nodes[number];
        for arg in args {
            if self.faults.len() >= FAULTS_MAX {
                return;
            }
            match &arg.value {
                ArgValue::Text(text, start) => self.set_parameter(number, arg.name, text, *start),
                ArgValue::Link(source) => self.set_link(number, scope, arg.name, source),
            }
        }
        for (i, port) in definition.inputs.iter().enumerate() {
            let given = args.iter().any(|a| a.name.text == port.name);
            if port.required && !given {
                let kind = FaultKind::NotConnected {
                    primitive: definition.name.clone(),
                    port: port.name.to_owned(),
                };
                self.fault(kind, self.nodes[number].at.clone());
            }
            debug_assert!(i < self.nodes[number].links.len());
        }
    }

    fn set_parameter(&mut self, node: usize, name: Name<'t>, text: &'t str, start: usize) {
        let definition = self.nodes[node].definition;
        if let Some(i) = definition.parameter_named(name.text) {
            if self.nodes[node].texts[i].replace((text, start)).is_some() {
                self.report_duplicate(name);
            }
        } else if let Some(i) = definition.input_named(name.text) {
            let parameter = definition.inputs[i].parameter.map(str::to_owned);
            let kind = FaultKind::TextForPort {
                port: name.text.to_owned(),
                parameter,
            };
            self.fault(kind, name.span());
        } else {
            let known = definition
                .parameters
                .iter()
                .map(|p| p.name.to_owned())
                .collect();
            let kind = FaultKind::UnknownParameter {
                primitive: definition.name.clone(),
                name: name.text.to_owned(),
                known,
            };
            self.fault(kind, name.span());
        }
    }

    fn set_link(&mut self, node: usize, scope: u32, name: Name<'t>, source: &'t Source<'t>) {
        let definition = self.nodes[node].definition;
        let Some(i) = definition.input_named(name.text) else {
            let kind = if definition.parameter_named(name.text).is_some() {
                FaultKind::LinkForParameter {
                    name: name.text.to_owned(),
                }
            } else {
                FaultKind::UnknownInPort {
                    owner: format!("`{}`", definition.name),
                    name: name.text.to_owned(),
                    known: definition
                        .inputs
                        .iter()
                        .map(|p| p.name.to_owned())
                        .collect(),
                }
            };
            self.fault(kind, name.span());
            return;
        };
        let port = &definition.inputs[i];
        let origin = self.typed_origin(scope, source, port.name, port.ty);
        let first = self.nodes[node]
            .args
            .iter()
            .find(|a| a.name.text == name.text);
        if first.is_some_and(|a| a.name.start != name.start) {
            self.report_duplicate(name);
        }
        self.nodes[node].links[i] = origin;
    }

    fn typed_origin(
        &mut self,
        scope: u32,
        source: &'t Source<'t>,
        port: &str,
        expected: Type,
    ) -> Option<Origin> {
        let origin = self.origin(scope, source)?;
        let output = &self.nodes[origin.node as usize].definition.outputs[origin.port as usize];
        if output.ty != expected {
            let kind = FaultKind::Type {
                port: port.to_owned(),
                expected: expected.to_string(),
                found: output.ty.to_string(),
            };
            self.fault(kind, source.span());
            return None;
        }
        Some(origin)
    }

    /// Follows a source through fragment ports to the primitive at which it starts. `None` if there
    /// is none; the fault is already recorded.
    pub(super) fn origin(&mut self, scope: u32, first: &'t Source<'t>) -> Option<Origin> {
        let mut passed = Vec::new();
        let origin = self.follow(scope, first, &mut passed);
        let passed = passed.into_iter().map(|start| (start, origin));
        self.known.extend(passed);
        origin
    }

    /// Follows a source; `passed` collects the sources of the fragment ports on the path.
    fn follow(
        &mut self,
        mut scope: u32,
        first: &'t Source<'t>,
        passed: &mut Vec<usize>,
    ) -> Option<Origin> {
        let mut source = first;
        // A path without a loop passes at most as many fragment borders as there are.
        for _ in 0..=2 * self.scopes.len() {
            let member = match &source.of {
                SourceOf::Child(name) if name.text == "parent" => None,
                SourceOf::Child(name) => Some(self.child(scope, *name)?),
                SourceOf::Inline(node) => Some(self.inline.get(&node.at.start).copied()?),
            };
            (scope, source) = match member {
                None => self.fed_from_outside(scope, source)?,
                Some(Member::Broken) => return None,
                Some(Member::Node(node)) => return self.out_port(node, source.port),
                Some(Member::Scope(inner)) => (inner, self.fed_from_inside(inner, source.port)?),
            };
            if let Some(origin) = self.known.get(&source.port.start) {
                return *origin;
            }
            passed.push(source.port.start);
        }
        // Every link into the loop is reported.
        passed.clear();
        let name = first.port.text.to_owned();
        self.fault(FaultKind::PortLoop { name }, first.span());
        None
    }

    /// The source of an out port of the fragment `scope`.
    fn fed_from_inside(&mut self, scope: u32, port: Name<'t>) -> Option<&'t Source<'t>> {
        let outs = &self.scopes[scope as usize].outs;
        if let Some(source) = outs.get(port.text) {
            return Some(source);
        }
        let known = names(outs.keys());
        self.unknown_out("this fragment".to_owned(), port, known);
        None
    }

    /// The source of an in port of the fragment `scope`, named by `source` as `parent.port`.
    fn fed_from_outside(
        &mut self,
        scope: u32,
        source: &Source<'t>,
    ) -> Option<(u32, &'t Source<'t>)> {
        let port = source.port;
        let Some(outer) = self.scopes[scope as usize].parent else {
            let start = source.span().start;
            self.fault(FaultKind::NoParent, start..start + "parent".len());
            return None;
        };
        match self.scopes[scope as usize].ins.get(port.text) {
            Some(Arg {
                value: ArgValue::Link(source),
                ..
            }) => Some((outer, source)),
            Some(_) => None,
            None => {
                let kind = FaultKind::UnknownInPort {
                    owner: "this fragment".to_owned(),
                    name: port.text.to_owned(),
                    known: names(self.scopes[scope as usize].ins.keys()),
                };
                self.fault(kind, port.span());
                None
            }
        }
    }

    fn child(&mut self, scope: u32, name: Name<'t>) -> Option<Member> {
        let children = &self.scopes[scope as usize].children;
        if let Some(member) = children.get(name.text) {
            return Some(*member);
        }
        let similar = similar(name.text, children.keys().copied()).map(str::to_owned);
        self.fault(
            FaultKind::UnknownChild {
                name: name.text.to_owned(),
                similar,
            },
            name.span(),
        );
        None
    }

    fn out_port(&mut self, node: u32, port: Name<'t>) -> Option<Origin> {
        let definition = self.nodes[node as usize].definition;
        if let Some(i) = definition.output_named(port.text) {
            return Some(Origin {
                node,
                port: number(i),
            });
        }
        let known = definition
            .outputs
            .iter()
            .map(|p| p.name.to_owned())
            .collect();
        self.unknown_out(format!("`{}`", definition.name), port, known);
        None
    }

    fn unknown_out(&mut self, owner: String, port: Name<'_>, known: Vec<String>) {
        let kind = FaultKind::UnknownOutPort {
            owner,
            name: port.text.to_owned(),
            known,
        };
        self.fault(kind, port.span());
    }

    fn link_root(&mut self, tree: &'t Fragment<'t>) -> Vec<(&'t str, Option<Origin>)> {
        let mut root = Vec::new();
        for out in &tree.outs {
            if self.faults.len() >= FAULTS_MAX {
                return root;
            }
            let ArgValue::Link(source) = &out.value else {
                continue;
            };
            let origin = if out.name.text == "outTerminate" {
                self.typed_origin(0, source, "outTerminate", BOOL)
            } else {
                self.origin(0, source)
            };
            root.push((out.name.text, origin));
        }
        let has_terminate = root.iter().any(|(name, _)| *name == "outTerminate");
        if self.context.limits.terminate && !has_terminate {
            let end = tree.at.end;
            self.fault(FaultKind::NoTerminate, end.saturating_sub(1)..end);
        }
        root
    }
}

/// The first names in order, truncated: no fault shows more, and a fault is kept for long.
fn names<'n>(keys: impl Iterator<Item = &'n &'n str>) -> Vec<String> {
    let mut names: Vec<&str> = keys.copied().collect();
    names.sort_unstable();
    names.truncate(NAMES_MAX);
    let short = |name: &str| name.chars().take(NAME_CHARS_MAX).collect();
    names.into_iter().map(short).collect()
}
