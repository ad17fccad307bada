//! Selects the primitives that count for the cost bound of a net: those of its longest activation.
//! Two sibling fragments, one activated by a value and one by a `Core::BooleanNot` of it, are never
//! active in the same cycle, so only the heavier one counts. Conditions that depend on numbers or
//! on the past are not analysed.

use std::collections::HashMap;

use super::origin::Origin;
use super::resolved::Resolved;

/// The primitive that makes two activations exclude each other.
const NOT: &str = "Core::BooleanNot";

/// Whether the content of each guard counts. `costs` are those of the nodes, ns.
pub(super) fn longest(resolved: &Resolved<'_>, costs: &[f64]) -> Vec<bool> {
    let guards = &resolved.guards;
    let mut sums = vec![0.0; guards.len()];
    for (node, cost) in resolved.nodes.iter().zip(costs) {
        sums[node.guard as usize] += cost;
    }
    let mut inside: Vec<Vec<usize>> = vec![Vec::new(); guards.len()];
    for (guard, info) in guards.iter().enumerate().skip(1) {
        inside[info.parent as usize].push(guard);
    }
    let mut counts = vec![true; guards.len()];
    // Inner guards have higher numbers.
    for guard in (0..guards.len()).rev() {
        let mut heaviest: HashMap<Origin, [f64; 2]> = HashMap::new();
        for &child in &inside[guard] {
            match switch(resolved, child) {
                Some((value, inverted)) => {
                    heaviest.entry(value).or_default()[usize::from(inverted)] += sums[child];
                }
                None => sums[guard] += sums[child],
            }
        }
        for [plain, inverted] in heaviest.values() {
            sums[guard] += plain.max(*inverted);
        }
        for &child in &inside[guard] {
            let Some((value, inverted)) = switch(resolved, child) else {
                continue;
            };
            let both = heaviest[&value];
            counts[child] = inverted == (both[1] > both[0]);
        }
    }
    for guard in 1..guards.len() {
        counts[guard] &= counts[guards[guard].parent as usize];
    }
    counts
}

/// The value that activates a guard, and whether it is inverted.
fn switch(resolved: &Resolved<'_>, guard: usize) -> Option<(Origin, bool)> {
    let active = resolved.guards[guard].active?;
    let node = &resolved.nodes[active.node as usize];
    let inverted = node.links.first().filter(|_| node.definition.name == NOT);
    let inverted = inverted.copied().flatten();
    Some(inverted.map_or((active, false), |value| (value, true)))
}
