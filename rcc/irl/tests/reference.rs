//! Random programs: what the interpreter computes is compared with a reference evaluator, which walks the tree of the program and shares
//! no code with compiler and interpreter.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "numbers of random programs are small"
)]

mod common;

use std::fmt::Write as _;

use common::Run;
use takt_irl::{Control, FaultKind, Phase};
use takt_tests::Random;

const INTS: usize = 4;
const REALS: usize = 3;
const BOOLS: usize = 2;
/// The array has indices from this one on.
const FIRST: i64 = -1;
const ELEMENTS: usize = 4;
const DEPTH: usize = 3;

#[derive(Clone, Debug)]
enum Int {
    Const(i32),
    Var(usize),
    Element(Box<Self>),
    Binary(&'static str, Box<Self>, Box<Self>),
    Negate(Box<Self>),
    Round(Box<Real>),
    /// Call of the function.
    Call(Box<Self>, Box<Self>),
}

#[derive(Clone, Debug)]
enum Real {
    Const(f64),
    Var(usize),
    Of(Box<Int>),
    Binary(&'static str, Box<Self>, Box<Self>),
    Sqrt(Box<Self>),
}

#[derive(Clone, Debug)]
enum Bool {
    Var(usize),
    Ints(&'static str, Int, Int),
    Reals(&'static str, Real, Real),
    Binary(&'static str, Box<Self>, Box<Self>),
    Not(Box<Self>),
}

#[derive(Clone, Debug)]
enum Statement {
    Int(usize, Int),
    Real(usize, Real),
    Bool(usize, Bool),
    Element(Int, Int),
    If(Bool, Vec<Line>, Vec<Line>),
    Case(Int, Vec<(i32, Vec<Line>)>, Vec<Line>),
    /// The variable, its range and step.
    For(usize, i32, i32, i32, Vec<Line>),
    /// Ends after three rounds.
    While(Bool, Vec<Line>),
    Repeat(Vec<Line>, Bool),
    ExitIf(Bool),
    /// Call of the procedure: `in` value, `inout` variable.
    Add(Int, usize),
}

/// A statement, and the line on which it is.
#[derive(Clone, Debug)]
struct Line(Statement, u32);

struct Maker {
    random: Random,
    text: String,
    line: u32,
    counters: usize,
}

fn pick<T: Copy>(random: &mut Random, all: &[T]) -> T {
    all[random.below(all.len())]
}

impl Maker {
    fn int(&mut self, depth: usize) -> Int {
        let kind = if depth == 0 { 0 } else { self.random.below(9) };
        let next = depth.saturating_sub(1);
        match kind {
            0 | 1 => Int::Var(self.random.below(INTS)),
            2 => Int::Const(self.random.below(2_000) as i32 - 1_000),
            // Indices and divisors have a variable, so that they are not checked by the compiler.
            3 => Int::Element(Box::new(self.varying(next))),
            4 => {
                let operator = pick(&mut self.random, &["div", "mod"]);
                Int::Binary(
                    operator,
                    Box::new(self.int(next)),
                    Box::new(self.varying(next)),
                )
            }
            5 => Int::Negate(Box::new(self.varying(next))),
            6 => Int::Round(Box::new(self.real(next))),
            7 => Int::Call(Box::new(self.varying(next)), Box::new(self.varying(next))),
            _ => {
                let operator = pick(&mut self.random, &["+", "-", "*"]);
                Int::Binary(
                    operator,
                    Box::new(self.varying(next)),
                    Box::new(self.int(next)),
                )
            }
        }
    }

    fn varying(&mut self, depth: usize) -> Int {
        let variable = Box::new(Int::Var(self.random.below(INTS)));
        if depth == 0 {
            return *variable;
        }
        let small = Box::new(Int::Const(self.random.below(3) as i32));
        Int::Binary("+", variable, small)
    }

    fn real(&mut self, depth: usize) -> Real {
        let kind = if depth == 0 { 0 } else { self.random.below(6) };
        let next = depth.saturating_sub(1);
        let variable = Real::Var(self.random.below(REALS));
        match kind {
            0 | 1 => variable,
            2 => Real::Const(self.random.below(4_000) as f64 / 8.0),
            3 => Real::Of(Box::new(self.varying(next))),
            4 => Real::Sqrt(Box::new(variable)),
            _ => {
                let operator = pick(&mut self.random, &["+", "-", "*", "/"]);
                Real::Binary(operator, Box::new(self.real(next)), Box::new(variable))
            }
        }
    }

    fn bool(&mut self, depth: usize) -> Bool {
        let kind = if depth == 0 { 0 } else { self.random.below(5) };
        let next = depth.saturating_sub(1);
        let relation = pick(&mut self.random, &["=", "<>", "<", "<=", ">", ">="]);
        match kind {
            0 => Bool::Var(self.random.below(BOOLS)),
            1 => Bool::Ints(relation, self.varying(next), self.int(next)),
            2 => Bool::Reals(
                relation,
                Real::Var(self.random.below(REALS)),
                self.real(next),
            ),
            3 => Bool::Not(Box::new(self.bool(next))),
            _ => {
                let operator = pick(&mut self.random, &["and", "or", "exor"]);
                let both = [self.bool(next), self.bool(next)].map(Box::new);
                let [a, b] = both;
                Bool::Binary(operator, a, b)
            }
        }
    }

    fn write(&mut self, text: &str) -> u32 {
        self.text.push_str(text);
        self.text.push('\n');
        self.line += 1;
        self.line
    }

    fn block(&mut self, depth: usize, in_loop: bool) -> Vec<Line> {
        let count = 1 + self.random.below(3);
        (0..count).map(|_| self.statement(depth, in_loop)).collect()
    }

    fn statement(&mut self, depth: usize, in_loop: bool) -> Line {
        let kind = self.random.below(if depth == 0 { 6 } else { 11 });
        match kind {
            5 if in_loop => {
                let condition = self.bool(1);
                let at = self.write(&format!("if {} then exit; endif;", show_bool(&condition)));
                Line(Statement::ExitIf(condition), at)
            }
            0 | 5 => {
                let (variable, value) = (self.random.below(INTS), self.int(DEPTH));
                let at = self.write(&format!("i{variable} := {};", show(&value)));
                Line(Statement::Int(variable, value), at)
            }
            1 => {
                let (variable, value) = (self.random.below(REALS), self.real(DEPTH));
                let at = self.write(&format!("x{variable} := {};", show_real(&value)));
                Line(Statement::Real(variable, value), at)
            }
            2 => {
                let (variable, value) = (self.random.below(BOOLS), self.bool(DEPTH));
                let at = self.write(&format!("b{variable} := {};", show_bool(&value)));
                Line(Statement::Bool(variable, value), at)
            }
            3 => {
                let (index, value) = (self.varying(1), self.int(DEPTH));
                let at = self.write(&format!("a[{}] := {};", show(&index), show(&value)));
                Line(Statement::Element(index, value), at)
            }
            4 => {
                let (value, variable) = (self.int(DEPTH), self.random.below(INTS));
                let at = self.write(&format!("add({}, i{variable});", show(&value)));
                Line(Statement::Add(value, variable), at)
            }
            _ => self.compound(kind, depth - 1, in_loop),
        }
    }

    fn compound(&mut self, kind: usize, depth: usize, in_loop: bool) -> Line {
        match kind {
            6 => {
                let condition = self.bool(DEPTH);
                let at = self.write(&format!("if {} then", show_bool(&condition)));
                let yes = self.block(depth, in_loop);
                self.write("else");
                let no = self.block(depth, in_loop);
                self.write("endif;");
                Line(Statement::If(condition, yes, no), at)
            }
            7 => {
                let value = self.int(2);
                let at = self.write(&format!("case {} of", show(&value)));
                let branch = |maker: &mut Self, label: i32| {
                    maker.write(&format!("when {label}:"));
                    (label, maker.block(depth, in_loop))
                };
                let branches = (0..3).map(|label| branch(self, label)).collect();
                self.write("default:");
                let default = self.block(depth, in_loop);
                self.write("endcase;");
                Line(Statement::Case(value, branches, default), at)
            }
            8 => {
                let variable = self.random.below(INTS);
                let [from, to] = [0, 0].map(|_: i32| self.random.below(7) as i32 - 3);
                let step = pick(&mut self.random, &[-2, -1, 1, 2]);
                let at = self.write(&format!("for i{variable} := {from} to {to} step {step} do"));
                let body = self.block_without(depth, variable);
                self.write("endfor;");
                Line(Statement::For(variable, from, to, step, body), at)
            }
            9 => {
                let (condition, counter) = (self.bool(2), self.counter());
                self.write(&format!("n{counter} := 0;"));
                let at = self.write(&format!(
                    "while {} and (n{counter} < 3) do n{counter} := n{counter} + 1;",
                    show_bool(&condition)
                ));
                let body = self.block(depth, true);
                self.write("endwhile;");
                Line(Statement::While(condition, body), at)
            }
            _ => {
                let (condition, counter) = (self.bool(2), self.counter());
                self.write(&format!("n{counter} := 0;"));
                self.write(&format!("repeat n{counter} := n{counter} + 1;"));
                let body = self.block(depth, true);
                let text = show_bool(&condition);
                let at = self.write(&format!("until {text} or (n{counter} >= 3);"));
                Line(Statement::Repeat(body, condition), at)
            }
        }
    }

    /// A block that does not assign the variable of its loop, which would be endless.
    fn block_without(&mut self, depth: usize, variable: usize) -> Vec<Line> {
        loop {
            let (text, line, counters) = (self.text.clone(), self.line, self.counters);
            let block = self.block(depth, true);
            if !block.iter().any(|line| assigns(line, variable)) {
                return block;
            }
            (self.text, self.line, self.counters) = (text, line, counters);
        }
    }

    fn counter(&mut self) -> usize {
        self.counters += 1;
        self.counters - 1
    }
}

fn assigns(Line(statement, _): &Line, variable: usize) -> bool {
    let any = |block: &[Line]| block.iter().any(|line| assigns(line, variable));
    match statement {
        Statement::Int(to, _) | Statement::Add(_, to) => *to == variable,
        Statement::Real(..) | Statement::Bool(..) | Statement::Element(..) => false,
        Statement::ExitIf(_) => false,
        Statement::If(_, yes, no) => any(yes) || any(no),
        Statement::Case(_, branches, default) => {
            any(default) || branches.iter().any(|(_, block)| any(block))
        }
        Statement::For(to, _, _, _, body) => *to == variable || any(body),
        Statement::While(_, body) | Statement::Repeat(body, _) => any(body),
    }
}

fn show(value: &Int) -> String {
    match value {
        Int::Const(value) if *value < 0 => format!("({value})"),
        Int::Const(value) => value.to_string(),
        Int::Var(variable) => format!("i{variable}"),
        Int::Element(index) => format!("a[{}]", show(index)),
        Int::Binary(operator, a, b) => format!("({} {operator} {})", show(a), show(b)),
        Int::Negate(value) => format!("(-{})", show(value)),
        Int::Round(value) => format!("round({})", show_real(value)),
        Int::Call(a, b) => format!("less({}, {})", show(a), show(b)),
    }
}

fn show_real(value: &Real) -> String {
    match value {
        Real::Const(value) => format!("{value:?}"),
        Real::Var(variable) => format!("x{variable}"),
        Real::Of(value) => format!("float({})", show(value)),
        Real::Binary(operator, a, b) => format!("({} {operator} {})", show_real(a), show_real(b)),
        Real::Sqrt(value) => format!("sqrt({})", show_real(value)),
    }
}

fn show_bool(value: &Bool) -> String {
    match value {
        Bool::Var(variable) => format!("b{variable}"),
        Bool::Ints(relation, a, b) => format!("({} {relation} {})", show(a), show(b)),
        Bool::Reals(relation, a, b) => format!("({} {relation} {})", show_real(a), show_real(b)),
        Bool::Binary(operator, a, b) => format!("({} {operator} {})", show_bool(a), show_bool(b)),
        Bool::Not(value) => format!("(not {})", show_bool(value)),
    }
}

/// What the reference evaluator knows.
#[derive(Clone, Debug, Default, PartialEq)]
struct Memory {
    ints: [i64; INTS],
    reals: [f64; REALS],
    bools: [bool; BOOLS],
    elements: [i64; ELEMENTS],
    line: u32,
}

enum Flow {
    Next,
    Exit,
}

fn whole(value: Option<i64>) -> Result<i64, FaultKind> {
    let value = value.filter(|value| i32::try_from(*value).is_ok());
    value.ok_or(FaultKind::Overflow)
}

fn finite(value: f64) -> Result<f64, FaultKind> {
    value
        .is_finite()
        .then_some(value)
        .ok_or(FaultKind::NotANumber)
}

fn holds<T: PartialOrd>(relation: &str, a: T, b: T) -> bool {
    match relation {
        "=" => a == b,
        "<>" => a != b,
        "<" => a < b,
        "<=" => a <= b,
        ">" => a > b,
        _ => a >= b,
    }
}

impl Memory {
    fn int(&self, value: &Int) -> Result<i64, FaultKind> {
        match value {
            Int::Const(value) => Ok((*value).into()),
            Int::Var(variable) => Ok(self.ints[*variable]),
            Int::Element(index) => Ok(self.elements[self.index(index)?]),
            Int::Negate(value) => whole(self.int(value)?.checked_neg()),
            Int::Round(value) => {
                let value = self.real(value)?.round();
                let fits = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value);
                fits.then_some(value as i64).ok_or(FaultKind::NotANumber)
            }
            Int::Call(a, b) => {
                let (a, b) = (self.int(a)?, self.int(b)?);
                if a < b {
                    Ok(a)
                } else {
                    whole(b.checked_sub(1))
                }
            }
            Int::Binary(operator, a, b) => {
                let (a, b) = (self.int(a)?, self.int(b)?);
                match (*operator, b) {
                    ("+", _) => whole(a.checked_add(b)),
                    ("-", _) => whole(a.checked_sub(b)),
                    ("*", _) => whole(a.checked_mul(b)),
                    (_, 0) => Err(FaultKind::DivisionByZero),
                    ("div", _) => whole(Some(a / b)),
                    _ => whole(Some(a % b)),
                }
            }
        }
    }

    fn index(&self, index: &Int) -> Result<usize, FaultKind> {
        let index = usize::try_from(self.int(index)? - FIRST).ok();
        index.filter(|i| *i < ELEMENTS).ok_or(FaultKind::Index)
    }

    fn real(&self, value: &Real) -> Result<f64, FaultKind> {
        match value {
            Real::Const(value) => Ok(*value),
            Real::Var(variable) => Ok(self.reals[*variable]),
            Real::Of(value) => Ok(self.int(value)? as f64),
            Real::Sqrt(value) => finite(self.real(value)?.sqrt()),
            Real::Binary(operator, a, b) => {
                let (a, b) = (self.real(a)?, self.real(b)?);
                match *operator {
                    "+" => finite(a + b),
                    "-" => finite(a - b),
                    "*" => finite(a * b),
                    _ if b == 0.0 => Err(FaultKind::DivisionByZero),
                    _ => finite(a / b),
                }
            }
        }
    }

    fn bool(&self, value: &Bool) -> Result<bool, FaultKind> {
        Ok(match value {
            Bool::Var(variable) => self.bools[*variable],
            Bool::Ints(relation, a, b) => holds(relation, self.int(a)?, self.int(b)?),
            Bool::Reals(relation, a, b) => holds(relation, self.real(a)?, self.real(b)?),
            Bool::Not(value) => !self.bool(value)?,
            Bool::Binary(operator, a, b) => {
                // Both sides are always evaluated.
                let (a, b) = (self.bool(a)?, self.bool(b)?);
                match *operator {
                    "and" => a && b,
                    "or" => a || b,
                    _ => a != b,
                }
            }
        })
    }

    fn block(&mut self, block: &[Line]) -> Result<Flow, FaultKind> {
        for line in block {
            if let Flow::Exit = self.statement(line)? {
                return Ok(Flow::Exit);
            }
        }
        Ok(Flow::Next)
    }

    fn statement(&mut self, Line(statement, line): &Line) -> Result<Flow, FaultKind> {
        self.line = *line;
        match statement {
            Statement::Int(variable, value) => self.ints[*variable] = self.int(value)?,
            Statement::Real(variable, value) => self.reals[*variable] = self.real(value)?,
            Statement::Bool(variable, value) => self.bools[*variable] = self.bool(value)?,
            Statement::Element(index, value) => {
                let at = self.index(index)?;
                self.elements[at] = self.int(value)?;
            }
            Statement::Add(value, variable) => {
                let sum = self.ints[*variable].checked_add(self.int(value)?);
                // The addition is on a line of its own.
                self.ints[*variable] = whole(sum).inspect_err(|_| self.line = ADD_LINE)?;
            }
            Statement::ExitIf(condition) => {
                if self.bool(condition)? {
                    return Ok(Flow::Exit);
                }
            }
            Statement::If(condition, yes, no) => {
                let block = if self.bool(condition)? { yes } else { no };
                return self.block(block);
            }
            Statement::Case(value, branches, default) => {
                let value = self.int(value)?;
                let branch = branches
                    .iter()
                    .find(|(label, _)| i64::from(*label) == value);
                return self.block(branch.map_or(default, |(_, block)| block));
            }
            Statement::For(variable, from, to, step, body) => {
                self.ints[*variable] = (*from).into();
                let is_within = |at: i64| {
                    let to = i64::from(*to);
                    if *step > 0 { at <= to } else { at >= to }
                };
                while is_within(self.ints[*variable]) {
                    if let Flow::Exit = self.block(body)? {
                        break;
                    }
                    self.line = *line;
                    self.ints[*variable] += i64::from(*step);
                }
            }
            Statement::While(condition, body) => {
                for round in 0.. {
                    self.line = *line;
                    if !(self.bool(condition)? && round < 3) {
                        break;
                    }
                    if let Flow::Exit = self.block(body)? {
                        break;
                    }
                }
            }
            Statement::Repeat(body, condition) => {
                for round in 1.. {
                    if let Flow::Exit = self.block(body)? {
                        break;
                    }
                    self.line = *line;
                    if self.bool(condition)? || round >= 3 {
                        break;
                    }
                }
            }
        }
        Ok(Flow::Next)
    }
}

const HEAD: &str = "program random;
type list = array[-1..2] of int;
var i0, i1, i2, i3, n0, n1, n2, n3, n4, n5, n6, n7, n8, n9: int; x0, x1, x2: real; b0, b1: bool; a: list;
procedure add(in v: int; inout s: int);
begin
s := s + v;
endproc;
function less(in p, q: int): int; begin if p < q then return p; else return q - 1; endif; endfct;
begin
i0 := 3; i1 := -7; i2 := 2; i3 := 1; x0 := 1.5; x1 := -0.25; b0 := true;
";
/// The line of the addition in it.
const ADD_LINE: u32 = 6;
const COUNTERS: usize = 10;

/// A random program and its statements.
fn program(seed: u64) -> Option<(String, Vec<Line>)> {
    let mut maker = Maker {
        random: Random::new(seed),
        text: HEAD.to_owned(),
        line: u32::try_from(HEAD.lines().count()).unwrap(),
        counters: 0,
    };
    let mut block = Vec::new();
    // Short ones mostly end, long ones mostly fail.
    for _ in 0..1 + seed % 4 {
        block.extend(maker.block(2, false));
    }
    maker.text.push_str("endprogram;\n");
    (maker.counters <= COUNTERS).then_some((maker.text, block))
}

#[test]
fn random_programs_agree_with_reference_evaluator() {
    let (mut ended, mut failed) = (0, 0);
    for seed in 0..400 {
        let Some((text, block)) = program(seed) else {
            continue;
        };
        let mut memory = Memory {
            ints: [3, -7, 2, 1],
            reals: [1.5, -0.25, 0.0],
            bools: [true, false],
            ..Memory::default()
        };
        let expected = memory.block(&block).map(drop);
        let run = Run::new(&text).to_end(|_| Control::default());
        let found = run.fault.map_or(Ok(()), |fault| Err(fault.kind));
        let mut shown = String::new();
        let _ = write!(
            shown,
            "seed {seed}: {expected:?} {memory:?}, {found:?}\n{text}"
        );
        assert_eq!(found, expected, "{shown}");
        match run.fault {
            Some(fault) => assert_eq!(fault.at.line, memory.line, "{shown}"),
            None => assert_eq!(run.phase, Phase::Ended, "{shown}"),
        }
        for (i, value) in memory.ints.iter().enumerate() {
            assert_eq!(run.value(&format!("i{i}")) as i64, *value, "i{i} {shown}");
        }
        for (i, value) in memory.reals.iter().enumerate() {
            let bits = run.value(&format!("x{i}")).to_bits();
            assert_eq!(bits, value.to_bits(), "x{i} {shown}");
        }
        for (i, value) in memory.bools.iter().enumerate() {
            assert_eq!(run.value(&format!("b{i}")) != 0.0, *value, "b{i} {shown}");
        }
        if expected.is_ok() {
            ended += 1;
        } else {
            failed += 1;
        }
    }
    // Both kinds occur often, so that both are tested.
    assert!(ended > 50 && failed > 50, "{ended} ended, {failed} failed");
}
