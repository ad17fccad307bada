//! Instructions, their locations, and how deep the stack becomes.

use crate::code::{Instruction, Location, Opcode};
use crate::tree::Span;

pub(super) struct Emitter {
    pub(super) code: Vec<Instruction>,
    pub(super) locations: Vec<Location>,
    text: String,
    lines: Vec<usize>,
    now: Location,
    depth: u32,
    deepest: u32,
}

impl Emitter {
    pub(super) fn new(text: &str) -> Self {
        let starts = text.match_indices('\n').map(|(i, _)| i + 1);
        Self {
            code: Vec::new(),
            locations: Vec::new(),
            text: text.to_owned(),
            lines: std::iter::once(0).chain(starts).collect(),
            now: Location::default(),
            depth: 0,
            deepest: 0,
        }
    }

    /// The instructions that follow belong to this location.
    pub(super) fn at(&mut self, at: &Span) {
        let line = self.lines.partition_point(|start| *start <= at.start);
        let start = line.checked_sub(1).and_then(|i| self.lines.get(i));
        let before = start.and_then(|start| self.text.get(*start..at.start));
        let column = before.map_or(1, |before| before.chars().count() + 1);
        self.now = Location {
            line: u32::try_from(line).unwrap_or(u32::MAX),
            column: u32::try_from(column).unwrap_or(u32::MAX),
        };
    }

    pub(super) fn emit(&mut self, opcode: Opcode, a: u32, b: u32, c: u32) -> usize {
        self.code.push(Instruction { opcode, a, b, c });
        self.locations.push(self.now);
        self.code.len() - 1
    }

    pub(super) fn op(&mut self, opcode: Opcode) {
        self.emit(opcode, 0, 0, 0);
    }

    /// The stack becomes that many words higher.
    pub(super) fn push(&mut self, words: u32) {
        self.depth = self.depth.saturating_add(words);
        self.deepest = self.deepest.max(self.depth);
    }

    pub(super) fn pop(&mut self, words: u32) {
        self.depth = self.depth.saturating_sub(words);
    }

    pub(super) const fn depth(&self) -> u32 {
        self.depth
    }

    pub(super) const fn deepest(&self) -> u32 {
        self.deepest
    }

    /// Something else takes that many words beyond the present depth.
    pub(super) fn reserve(&mut self, words: u32) {
        self.deepest = self.deepest.max(self.depth.saturating_add(words));
    }

    /// Begins with an empty stack; returns what [`Self::resume`] restores.
    pub(super) fn fresh(&mut self) -> (u32, u32) {
        let before = (self.depth, self.deepest);
        (self.depth, self.deepest) = (0, 0);
        before
    }

    /// Ends a fresh stack and returns its largest depth.
    pub(super) fn resume(&mut self, before: (u32, u32)) -> u32 {
        let deepest = self.deepest;
        (self.depth, self.deepest) = before;
        deepest
    }

    fn constant(&mut self, bits: u64, is_real: bool) {
        let halves = [bits, bits >> 32].map(|half| (half & 0xFFFF_FFFF) as u32);
        self.emit(Opcode::Const, halves[0], halves[1], is_real.into());
        self.push(1);
    }

    pub(super) fn int(&mut self, value: i64) {
        self.constant(value.cast_unsigned(), false);
    }

    pub(super) fn real(&mut self, value: f64) {
        self.constant(value.to_bits(), true);
    }

    pub(super) fn load(&mut self, (scope, at): (u32, u32), words: u32) {
        self.emit(Opcode::Load, scope, at, words);
        self.push(words);
    }

    pub(super) fn store(&mut self, (scope, at): (u32, u32), words: u32) {
        self.emit(Opcode::Store, scope, at, words);
        self.pop(words);
    }

    pub(super) fn address(&mut self, (scope, at): (u32, u32)) {
        self.emit(Opcode::Addr, scope, at, 0);
        self.push(1);
    }

    /// Two words become one.
    pub(super) fn binary(&mut self, opcode: Opcode, a: u32) {
        self.emit(opcode, a, 0, 0);
        self.pop(1);
    }

    pub(super) fn here(&self) -> u32 {
        u32::try_from(self.code.len()).unwrap_or(u32::MAX)
    }

    pub(super) fn jump(&mut self, target: u32) -> usize {
        self.emit(Opcode::Jump, target, 0, 0)
    }

    pub(super) fn unless(&mut self) -> usize {
        self.pop(1);
        self.emit(Opcode::Unless, 0, 0, 0)
    }

    /// Lets a jump lead to the next instruction.
    pub(super) fn patch(&mut self, jump: usize) {
        let here = self.here();
        if let Some(instruction) = self.code.get_mut(jump) {
            instruction.a = here;
        }
    }
}
