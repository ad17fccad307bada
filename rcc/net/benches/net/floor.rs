//! The references that a net is compared with: the lowest cost of a graph of blocks known only at
//! run time, and the same additions written by hand. Neither knows types, null or faults.

use std::hint::black_box;

/// How additions are linked.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// Each adds 1 to the previous result: the processor waits for every result.
    Chain,
    /// Each adds 1 to the same number: the processor overlaps them, so that nothing hides overhead.
    Fan,
}

/// A block of the floor.
trait Block {
    fn step(&mut self, slab: &mut [f64]);
}

struct Add {
    first: usize,
    second: usize,
    out: usize,
}

impl Block for Add {
    fn step(&mut self, slab: &mut [f64]) {
        slab[self.out] = slab[self.first] + slab[self.second];
    }
}

/// Additions as a slice of boxed blocks over one slab of numbers.
pub(crate) struct Floor {
    blocks: Box<[Box<dyn Block>]>,
    slab: Box<[f64]>,
}

impl Floor {
    /// A graph of `additions`: a chain, or independent ones.
    pub(crate) fn new(shape: Shape, additions: usize) -> Self {
        let add = |i: usize| -> Box<dyn Block> {
            Box::new(Add {
                first: if shape == Shape::Chain { 2 * i } else { 0 },
                second: 2 * i + 1,
                out: 2 * i + 2,
            })
        };
        Self {
            blocks: (0..additions).map(add).collect(),
            slab: slab(additions),
        }
    }

    pub(crate) fn evaluate(&mut self) {
        for block in &mut self.blocks {
            block.step(&mut self.slab);
        }
    }

    /// Result of the last addition.
    pub(crate) fn result(&self) -> f64 {
        self.slab.last().copied().unwrap_or_default()
    }
}

/// Results and addends, alternating.
pub(crate) fn slab(additions: usize) -> Box<[f64]> {
    let number = |i: usize| if i % 2 == 1 { 1.0 } else { 0.0 };
    (0..=2 * additions).map(number).collect()
}

/// The chain over [`slab`] as one would write it by hand.
#[inline(never)]
pub(crate) fn straight_line(slab: &mut [f64]) {
    for out in (2..slab.len()).step_by(2) {
        slab[out] = slab[out - 2] + slab[out - 1];
    }
    black_box(slab);
}
