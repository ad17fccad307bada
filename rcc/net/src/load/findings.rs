//! The analysis of an accepted net for what is probably not meant: commands given twice or never, values
//! that are always null, results without a reader, constants and units that do not fit. It looks at
//! links, parameters and at what the build functions declared; it evaluates nothing.

use std::collections::{BTreeMap, HashSet};
use std::ops::Range;

use crate::definition::{InPort, NullRule, ParameterType};
use crate::finding::{FINDINGS_MAX, Finding, Severity};
use crate::load::build::is_inside;
use crate::load::origin::Origin;
use crate::load::parts::Effects;
use crate::load::resolved::{Node, Resolved};
use crate::value::Element;
use crate::value::text::{TextValue as _, parse_array_as};
use crate::value::unit::{self, Dimension, Quantity};

/// Angle beyond which a constant was probably typed in degrees: two turns, rad.
const TWO_TURNS: f64 = 4.0 * std::f64::consts::PI;

/// All findings of a net, in text order.
pub(super) fn find(resolved: &Resolved<'_>, effects: &[Effects]) -> Vec<Finding> {
    let mut analysis = Analysis {
        resolved,
        effects,
        is_read: readers(resolved),
        findings: Vec::new(),
    };
    let may_have_value = may_have_value(resolved);
    analysis.commanded_twice();
    analysis.unread();
    analysis.unread_errors();
    for number in 0..resolved.nodes.len() {
        analysis.null_loop(number, &may_have_value);
        analysis.without_command(number, &may_have_value);
        analysis.links(number);
        analysis.constants(number);
    }
    let mut findings = analysis.findings;
    findings.sort_by_key(|finding| finding.at.start);
    findings.dedup();
    findings.truncate(FINDINGS_MAX);
    findings
}

/// All out ports that something reads.
fn readers(resolved: &Resolved<'_>) -> HashSet<Origin> {
    let links = resolved.nodes.iter().flat_map(|node| &node.links);
    let links = links.flatten().copied();
    let guards = resolved.guards.iter().filter_map(|guard| guard.active);
    let root = resolved.root.iter().filter_map(|(_, origin)| *origin);
    let taps = resolved.taps.iter().map(|tap| tap.origin);
    links.chain(guards).chain(root).chain(taps).collect()
}

/// Whether an in port switches its primitive instead of feeding it.
fn is_control(port: &InPort) -> bool {
    ["inActive", "inReset"].contains(&port.name)
}

/// By node: whether its outputs may ever have a value. The least solution: a loop has none unless one
/// leads into it from outside.
fn may_have_value(resolved: &Resolved<'_>) -> Vec<bool> {
    let mut may = vec![false; resolved.nodes.len()];
    loop {
        let mut has_changed = false;
        for number in 0..may.len() {
            if !may[number] && has_value(resolved, number, &may) {
                may[number] = true;
                has_changed = true;
            }
        }
        if !has_changed {
            return may;
        }
    }
}

fn has_value(resolved: &Resolved<'_>, number: usize, may: &[bool]) -> bool {
    let node = &resolved.nodes[number];
    let is_fed = |origin: &Origin| may[origin.node as usize];
    let mut guard = node.guard;
    while guard != 0 {
        let info = &resolved.guards[guard as usize];
        if !info.active.as_ref().is_none_or(is_fed) {
            return false;
        }
        guard = info.parent;
    }
    let ports = node.definition.inputs.iter().zip(&node.links);
    let mut ports = ports.filter(|(port, _)| !is_control(port));
    match node.definition.null {
        _ if node.definition.early.is_some() => {
            ports.all(|(_, link)| link.as_ref().is_some_and(is_fed))
        }
        NullRule::Propagates => ports.all(|(_, link)| link.as_ref().is_none_or(is_fed)),
        NullRule::Requires(_) => {
            ports.all(|(port, link)| !port.required || link.as_ref().is_some_and(is_fed))
        }
        NullRule::Kleene => ports.any(|(_, link)| link.as_ref().is_none_or(is_fed)),
        NullRule::Own(_) => true,
    }
}

/// A constant in the text of a net.
struct Constant {
    value: f64,
    at: Range<usize>,
    stated: Option<Quantity>,
}

struct Analysis<'r> {
    resolved: &'r Resolved<'r>,
    effects: &'r [Effects],
    is_read: HashSet<Origin>,
    findings: Vec<Finding>,
}

/// The name of a primitive in messages: its own, or its type if it is inline.
fn label(node: &Node<'_>) -> String {
    if node.name.starts_with('(') {
        format!("`{}`", node.definition.name)
    } else {
        format!("`{}`", node.name)
    }
}

/// The place of a primitive's parameter, or that of the primitive.
fn place(node: &Node<'_>, parameter: usize) -> Range<usize> {
    match &node.texts[parameter] {
        Some((text, start)) => *start..*start + text.len(),
        None => node.at.clone(),
    }
}

impl<'r> Analysis<'r> {
    fn warn(&mut self, at: Range<usize>, text: String, hint: &str) {
        // Twice the bound: duplicates are removed later.
        if self.findings.len() < 2 * FINDINGS_MAX {
            self.findings.push(Finding {
                severity: Severity::Warning,
                at,
                text,
                hint: hint.to_owned(),
            });
        }
    }

    fn node(&self, number: usize) -> &'r Node<'r> {
        &self.resolved.nodes[number]
    }

    /// Two primitives that command the same in one cycle: one is inside the activation of the other.
    fn commanded_twice(&mut self) {
        let mut by_target: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (number, effects) in self.effects.iter().enumerate() {
            for target in &effects.commands {
                let key = (*target, effects.device.as_deref());
                by_target.entry(key).or_default().push(number);
            }
        }
        for numbers in by_target.into_values() {
            for (i, later) in numbers.iter().enumerate().skip(1) {
                let guard = |number: usize| self.node(number).guard;
                let is_parallel = |earlier: &&usize| {
                    is_inside(self.resolved, guard(**earlier), guard(*later))
                        || is_inside(self.resolved, guard(*later), guard(**earlier))
                };
                let Some(earlier) = numbers[..i].iter().find(is_parallel) else {
                    continue;
                };
                let (node, earlier) = (self.node(*later), label(self.node(*earlier)));
                let text = format!(
                    "{} commands what {earlier} commands in the same cycle; one of them is rejected",
                    label(node)
                );
                self.warn(
                    node.at.clone(),
                    text,
                    "choose the value with a `Conditional`, or activate one at a time: `inActive`, \
                     through a `Core::BooleanNot` for the other",
                );
            }
        }
    }

    fn has_reader(&self, number: usize, port: usize) -> bool {
        let origin = |part: usize| u32::try_from(part).unwrap_or(u32::MAX);
        let (node, port) = (origin(number), origin(port));
        self.is_read.contains(&Origin { node, port })
    }

    /// Primitives that compute for no one.
    fn unread(&mut self) {
        for number in 0..self.resolved.nodes.len() {
            let node = self.node(number);
            let ports = 0..node.definition.outputs.len();
            let is_used = self.effects[number].acts
                || ports.clone().any(|port| self.has_reader(number, port));
            if ports.is_empty() || is_used {
                continue;
            }
            let text = format!("no one reads the results of {}", label(node));
            self.warn(
                node.at.clone(),
                text,
                "link one of its out ports, publish it with a `NetcommOut`, or remove the primitive",
            );
        }
    }

    /// Commands whose rejection nothing in the net notices: one finding for all.
    fn unread_errors(&mut self) {
        let is_error = |name: &str| name.starts_with("outError");
        let is_silent = |number: &usize| {
            let outputs = self.node(*number).definition.outputs.iter().enumerate();
            let mut errors = outputs.filter(|(_, port)| is_error(port.name)).peekable();
            !self.effects[*number].commands.is_empty()
                && errors.peek().is_some()
                && !errors.any(|(port, _)| self.has_reader(*number, port))
        };
        let silent: Vec<usize> = (0..self.resolved.nodes.len()).filter(is_silent).collect();
        let Some(first) = silent.first() else {
            return;
        };
        let node = self.node(*first);
        let others = match silent.len() - 1 {
            0 => String::new(),
            1 => " and of another command".to_owned(),
            more => format!(" and of {more} other commands"),
        };
        let text = format!(
            "no one reads `outError` of {}{others}: the net goes on while set-points are rejected",
            label(node)
        );
        self.warn(
            node.at.clone(),
            text,
            "end the net on an error: `good=Core::IntEquals(inFirst=joint.outError)` becomes false; or \
             publish it with a `Core::IntNetcommOut`",
        );
    }

    /// A `Pre` that never has a value.
    fn null_loop(&mut self, number: usize, may: &[bool]) {
        let node = self.node(number);
        if may[number] || node.definition.early.is_none() {
            return;
        }
        let text = format!(
            "{} is null in every cycle: no value leads into its loop",
            label(node)
        );
        self.warn(
            node.at.clone(),
            text,
            "give the loop its first value: a `Conditional` with `inCondition` of an `IsNull` of the `Pre`, \
             the start value as `True` and the `Pre` as `inFalse`",
        );
    }

    /// A command without a value: nothing, or something always null, is linked to its in port.
    fn without_command(&mut self, number: usize, may: &[bool]) {
        let node = self.node(number);
        if self.effects[number].commands.is_empty() {
            return;
        }
        let ports = node.definition.inputs.iter().zip(&node.links);
        let mut values = ports.filter(|(port, _)| !is_control(port)).peekable();
        if values.peek().is_none() {
            return;
        }
        let is_empty = |(port, link): &(&InPort, &Option<Origin>)| match link {
            Some(origin) => !may[origin.node as usize],
            None => port.parameter.is_none(),
        };
        let empty: Vec<_> = values.collect();
        if !empty.iter().all(is_empty) {
            return;
        }
        let (port, link) = empty[0];
        let cause = match link {
            Some(_) => "is null in every cycle",
            None => "is not connected",
        };
        let text = format!("{} commands nothing: `{}` {cause}", label(node), port.name);
        let hint = format!("link a source: `{}=child.port`", port.name);
        self.warn(node.at.clone(), text, &hint);
    }

    /// Links between ports that measure different quantities.
    fn links(&mut self, number: usize) {
        let node = self.node(number);
        for (port, link) in node.definition.inputs.iter().zip(&node.links) {
            let Some(origin) = link else { continue };
            let source = self.node(origin.node as usize);
            let out = &source.definition.outputs[origin.port as usize];
            let constant = self.constant(*origin);
            let from = constant.as_ref().and_then(|constant| constant.stated);
            let (Quantity::Of(from), Quantity::Of(to)) =
                (from.unwrap_or(out.quantity), port.quantity)
            else {
                continue;
            };
            // The sine of a clock is a usual rhythm.
            if from == to || from == Dimension::TIME {
                continue;
            }
            let text = format!(
                "`{}` of {} measures {to}, but its source {} measures {from}",
                port.name,
                label(node),
                label(source)
            );
            let at = constant.map_or_else(|| node.at.clone(), |constant| constant.at);
            self.warn(at, text, "convert the value, or link another out port");
        }
    }

    /// Constants that are commanded: beyond the limits, in degrees, or without a motion that leads there.
    fn constants(&mut self, number: usize) {
        let node = self.node(number);
        for (port, range) in &self.effects[number].expected {
            let Some(origin) = node.links[*port] else {
                continue;
            };
            let name = node.definition.inputs[*port].name;
            let direct = self.constant(origin);
            let is_direct = direct.is_some();
            let all = direct.map_or_else(|| self.endpoints(origin), |constant| vec![constant]);
            for Constant { value, at, .. } in all {
                let target = format!("`{name}` of {}", label(node));
                if let Some(why) = misfit(value, range) {
                    let degrees = value.to_radians();
                    let hint = if range.contains(&degrees) && degrees.abs() > 0.01 {
                        format!(
                            "a number without unit is in rad: write '{value}deg' if that is meant"
                        )
                    } else {
                        "choose a position within the limits of the joint".to_owned()
                    };
                    self.warn(
                        at,
                        format!("{target} is commanded to {value} rad, {why}"),
                        &hint,
                    );
                } else if is_direct {
                    self.warn(
                        at,
                        format!("{target} is commanded to a constant: its driver rejects the step unless the robot is there"),
                        "lead the joint there from its present position: a `Core::DoubleSnapshot` of \
                         `outCommandedPosition` in the first cycle, and a curve or a motion",
                    );
                }
            }
        }
        self.missing_start(number);
    }

    /// A motion whose start was not given: it starts at zero, wherever the robot is.
    fn missing_start(&mut self, number: usize) {
        let node = self.node(number);
        let Some(from) = node.definition.parameter_named("From") else {
            return;
        };
        let start = &node.definition.parameters[from];
        let is_pose = match start.ty {
            ParameterType::Value(ty) => ty.array || ty.element == Element::Frame,
            ParameterType::Text => false,
        };
        if !is_pose || node.texts[from].is_some() {
            return;
        }
        let text = format!(
            "{} starts at {}, wherever the robot is: it has no `From`",
            label(node),
            start.default
        );
        self.warn(
            node.at.clone(),
            text,
            "give it the commanded position of the robot as `From`",
        );
    }

    /// The constant at which a link starts.
    fn constant(&self, origin: Origin) -> Option<Constant> {
        let node = self.node(origin.node as usize);
        let [parameter] = &node.definition.parameters[..] else {
            return None;
        };
        if !node.definition.inputs.is_empty() || parameter.name != "Value" {
            return None;
        }
        let text = node.texts[0]
            .as_ref()
            .map_or(parameter.default, |(text, _)| text);
        Some(Constant {
            value: f64::parse_as(text, parameter.quantity).ok()?,
            at: place(node, 0),
            stated: unit::stated(text),
        })
    }

    /// Start and end of a motion, as far as they are constants: the elements of `From` and `To` of the
    /// primitive behind an `ArrayGet`.
    fn endpoints(&self, origin: Origin) -> Vec<Constant> {
        let get = self.node(origin.node as usize);
        let index = get.definition.parameter_named("Index");
        let (Some(index), Some(Some(array))) = (index, get.links.first()) else {
            return Vec::new();
        };
        let text = get.texts[index].as_ref().map_or("0", |(text, _)| text);
        let Ok(index) = text.trim().parse::<usize>() else {
            return Vec::new();
        };
        let motion = self.node(array.node as usize);
        let element = |name| {
            let parameter = motion.definition.parameter_named(name)?;
            let (text, _) = motion.texts[parameter].as_ref()?;
            let quantity = motion.definition.parameters[parameter].quantity;
            let values = parse_array_as::<f64>(text, usize::MAX, quantity).ok()?;
            Some(Constant {
                value: *values.get(index)?,
                at: place(motion, parameter),
                stated: None,
            })
        };
        ["From", "To"].into_iter().filter_map(element).collect()
    }
}

/// Why a commanded angle cannot be meant.
fn misfit(value: f64, range: &std::ops::RangeInclusive<f64>) -> Option<String> {
    let (least, most) = (*range.start(), *range.end());
    let is_known = least.is_finite() && most.is_finite();
    if is_known && !range.contains(&value) {
        return Some(format!("beyond its limits {least} to {most} rad"));
    }
    let turns = value / std::f64::consts::TAU;
    (!is_known && value.abs() > TWO_TURNS).then(|| format!("which is {turns:.1} turns"))
}
