//! The order of evaluation: a topological order over the whole net, across fragment borders, that
//! keeps the units of one guard together in as few runs as it can. It works on numbers only.

/// The units to order.
#[derive(Debug)]
pub(super) struct Graph {
    /// The guard each unit belongs to; guard 0 is always active.
    pub(super) guard_of: Vec<u32>,
    /// The enclosing guard of each guard; that of guard 0 is 0.
    pub(super) parent: Vec<u32>,
    /// `(before, after)` pairs of units.
    pub(super) edges: Vec<(u32, u32)>,
}

/// The units have no order.
#[derive(Debug)]
pub(super) struct Unordered {
    /// The units of one cycle, each before the one it feeds.
    pub(super) cycle: Vec<u32>,
    /// All units, ordered as far as possible.
    pub(super) units: Vec<u32>,
}

/// Orders the units.
pub(super) fn order(graph: &Graph) -> Result<Vec<u32>, Unordered> {
    let mut sorter = Sorter::new(graph);
    sorter.run();
    if sorter.order.len() == graph.guard_of.len() {
        return Ok(sorter.order);
    }
    let cycle = cycle(graph, &sorter.waits);
    let mut units = sorter.order;
    units.extend(
        (0..)
            .zip(&sorter.waits)
            .filter(|(_, waits)| **waits > 0)
            .map(|(u, _)| u),
    );
    Err(Unordered { cycle, units })
}

struct Sorter<'g> {
    graph: &'g Graph,
    /// Units fed by unit `u`: `fed[first[u]..first[u + 1]]`.
    first: Vec<u32>,
    fed: Vec<u32>,
    /// Number of inputs that each unit still waits for.
    waits: Vec<u32>,
    /// Number of open edges into each guard from outside.
    open: Vec<u32>,
    /// Number of runnable units inside each guard, at any depth.
    ready_inside: Vec<u32>,
    /// Runnable units directly in each guard, the next one last.
    ready: Vec<Vec<u32>>,
    /// Guards directly inside each guard that have runnable units; entries may be stale.
    unblocked: Vec<Vec<u32>>,
    blocked: Vec<Vec<u32>>,
    order: Vec<u32>,
}

impl<'g> Sorter<'g> {
    fn new(graph: &'g Graph) -> Self {
        let (units, guards) = (graph.guard_of.len(), graph.parent.len());
        let mut waits = vec![0; units];
        let mut first = vec![0; units + 1];
        for (before, after) in &graph.edges {
            waits[*after as usize] += 1;
            first[*before as usize + 1] += 1;
        }
        for i in 0..units {
            first[i + 1] += first[i];
        }
        let mut next = first.clone();
        let mut fed = vec![0; graph.edges.len()];
        for (before, after) in &graph.edges {
            let slot = &mut next[*before as usize];
            fed[*slot as usize] = *after;
            *slot += 1;
        }
        let mut sorter = Self {
            graph,
            first,
            fed,
            waits,
            open: vec![0; guards],
            ready_inside: vec![0; guards],
            ready: vec![Vec::new(); guards],
            unblocked: vec![Vec::new(); guards],
            blocked: vec![Vec::new(); guards],
            order: Vec::with_capacity(units),
        };
        for (before, after) in &graph.edges {
            sorter.entered(*before, *after, |open| *open += 1);
        }
        for unit in (0..u32::try_from(units).unwrap_or(u32::MAX)).rev() {
            if sorter.waits[unit as usize] == 0 {
                sorter.make_ready(unit);
            }
        }
        sorter
    }

    /// Calls `count` for every guard that an edge enters.
    fn entered(&mut self, before: u32, after: u32, count: impl Fn(&mut u32)) {
        let from = self.graph.guard_of[before as usize];
        let mut guard = self.graph.guard_of[after as usize];
        while guard != 0 && !self.graph.is_inside(from, guard) {
            count(&mut self.open[guard as usize]);
            guard = self.graph.parent[guard as usize];
        }
    }

    fn make_ready(&mut self, unit: u32) {
        let mut guard = self.graph.guard_of[unit as usize];
        self.ready[guard as usize].push(unit);
        while guard != 0 {
            self.ready_inside[guard as usize] += 1;
            if self.ready_inside[guard as usize] == 1 {
                self.offer(guard);
            }
            guard = self.graph.parent[guard as usize];
        }
    }

    /// Queues a guard with runnable units at its parent.
    fn offer(&mut self, guard: u32) {
        let parent = self.graph.parent[guard as usize] as usize;
        let queue = if self.open[guard as usize] == 0 {
            &mut self.unblocked[parent]
        } else {
            &mut self.blocked[parent]
        };
        queue.push(guard);
    }

    /// A guard directly inside `guard` with runnable units, preferably one without open edges from
    /// outside.
    fn descend(&mut self, guard: u32) -> Option<u32> {
        loop {
            let unblocked = &mut self.unblocked[guard as usize];
            let child = unblocked
                .pop()
                .or_else(|| self.blocked[guard as usize].pop())?;
            if self.ready_inside[child as usize] > 0 {
                return Some(child);
            }
        }
    }

    fn run(&mut self) {
        let mut guard = 0;
        loop {
            if let Some(unit) = self.ready[guard as usize].pop() {
                self.emit(unit);
            } else if let Some(child) = self.descend(guard) {
                guard = child;
            } else if guard != 0 {
                guard = self.graph.parent[guard as usize];
            } else {
                return;
            }
        }
    }

    fn emit(&mut self, unit: u32) {
        self.order.push(unit);
        let mut guard = self.graph.guard_of[unit as usize];
        while guard != 0 {
            self.ready_inside[guard as usize] -= 1;
            guard = self.graph.parent[guard as usize];
        }
        for i in self.first[unit as usize]..self.first[unit as usize + 1] {
            let after = self.fed[i as usize];
            self.entered(unit, after, |open| *open -= 1);
            self.waits[after as usize] -= 1;
            if self.waits[after as usize] == 0 {
                self.make_ready(after);
            }
            let guard = self.graph.guard_of[after as usize];
            let has_work = self.ready_inside[guard as usize] > 0;
            if guard != 0 && self.open[guard as usize] == 0 && has_work {
                self.offer(guard);
            }
        }
    }
}

impl Graph {
    /// Whether guard `inner` is `outer` or lies in it.
    pub(super) fn is_inside(&self, mut inner: u32, outer: u32) -> bool {
        loop {
            if inner == outer {
                return true;
            }
            if inner == 0 {
                return false;
            }
            inner = self.parent[inner as usize];
        }
    }
}

/// Finds a cycle among the waiting units: walking back from any of them along waiting units returns
/// to one already visited.
fn cycle(graph: &Graph, waits: &[u32]) -> Vec<u32> {
    let mut before_of = vec![None; waits.len()];
    for (before, after) in &graph.edges {
        if waits[*before as usize] > 0 {
            before_of[*after as usize] = Some(*before);
        }
    }
    let stuck = waits
        .iter()
        .position(|w| *w > 0)
        .and_then(|u| u32::try_from(u).ok());
    let mut path: Vec<u32> = Vec::new();
    let mut seen_at = vec![None; waits.len()];
    let mut next = stuck;
    while let Some(unit) = next {
        if let Some(start) = seen_at[unit as usize] {
            path.drain(..start);
            break;
        }
        seen_at[unit as usize] = Some(path.len());
        path.push(unit);
        next = before_of[unit as usize];
    }
    path.reverse();
    path
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn graph(guard_of: &[u32], parent: &[u32], edges: &[(u32, u32)]) -> Graph {
        Graph {
            guard_of: guard_of.to_vec(),
            parent: parent.to_vec(),
            edges: edges.to_vec(),
        }
    }

    fn runs(order: &[u32], guard_of: &[u32]) -> usize {
        1 + order
            .windows(2)
            .filter(|w| guard_of[w[0] as usize] != guard_of[w[1] as usize])
            .count()
    }

    #[test]
    fn chain_keeps_its_order() {
        let g = graph(&[0; 3], &[0], &[(2, 1), (1, 0)]);
        assert_eq!(order(&g).unwrap(), [2, 1, 0]);
    }

    #[test]
    fn guard_waits_for_inputs_and_runs_once() {
        // 0 and 1 outside feed 2 and 3 inside guard 1; 1 needs 4 inside guard 2.
        let guard_of = [0, 0, 1, 1, 2];
        let g = graph(&guard_of, &[0, 0, 0], &[(0, 2), (1, 3), (4, 1)]);
        let order = order(&g).unwrap();
        assert_eq!(runs(&order, &guard_of), 4, "{order:?}");
    }

    #[test]
    fn path_may_leave_and_reenter_guard() {
        let g = graph(&[1, 0, 1], &[0, 0], &[(0, 1), (1, 2)]);
        assert_eq!(order(&g).unwrap(), [0, 1, 2]);
    }

    #[test]
    fn cycle_is_reported() {
        let g = graph(&[0; 5], &[0], &[(0, 1), (1, 2), (2, 3), (3, 1), (3, 4)]);
        let mut cycle = order(&g).unwrap_err().cycle;
        let least = cycle.iter().position(|u| *u == 1).unwrap();
        cycle.rotate_left(least);
        assert_eq!(cycle, [1, 2, 3]);
        assert_eq!(order(&graph(&[0], &[0], &[(0, 0)])).unwrap_err().cycle, [0]);
    }

    proptest! {
        #[test]
        fn every_edge_is_kept(
            guards in proptest::collection::vec(0_u32..6, 1..40),
            parents in proptest::collection::vec(0_u32..6, 6),
            pairs in proptest::collection::vec((0_u32..40, 0_u32..40), 0..80),
        ) {
            let parent: Vec<u32> =
                parents.iter().enumerate().map(|(i, p)| (*p).min(u32::try_from(i.saturating_sub(1)).unwrap())).collect();
            let n = u32::try_from(guards.len()).unwrap();
            let edges: Vec<(u32, u32)> = pairs
                .into_iter()
                .map(|(a, b)| (a % n, b % n))
                .filter(|(a, b)| a < b)
                .collect();
            let g = graph(&guards, &parent, &edges);
            let order = order(&g).unwrap();
            let mut at = vec![usize::MAX; guards.len()];
            for (i, u) in order.iter().enumerate() {
                at[*u as usize] = i;
            }
            for (before, after) in edges {
                prop_assert!(at[before as usize] < at[after as usize]);
            }
        }
    }
}
