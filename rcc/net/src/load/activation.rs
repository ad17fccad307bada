//! Which primitives count for what a net costs at most: those of its longest activation. Two fragments beside
//! each other, one switched by a value and one by a `Core::BooleanNot` of it, are never active in one cycle, so only the
//! heavier counts. Nothing else is known to exclude anything: what depends on numbers or on the past does not.

use std::collections::HashMap;

use super::resolve::{Origin, Resolved};

/// The primitive that makes two activations exclude each other.
const NOT: &str = "Core::BooleanNot";

/// By guard: whether what it switches counts. `costs` are those of the nodes, ns.
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
    // What is inside of a guard has a higher number.
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

/// The value that switches a guard, and whether it does so inverted.
fn switch(resolved: &Resolved<'_>, guard: usize) -> Option<(Origin, bool)> {
    let active = resolved.guards[guard].active?;
    let node = &resolved.nodes[active.node as usize];
    let inverted = node.links.first().filter(|_| node.definition.name == NOT);
    let inverted = inverted.copied().flatten();
    Some(inverted.map_or((active, false), |value| (value, true)))
}
