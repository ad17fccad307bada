//! The grammar of `docs/irl.md`: LALR(1) without conflicts, with an accepted and a refused sample of each production, on which compiler and
//! grammar agree.

#![allow(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use std::collections::{BTreeMap, BTreeSet};

use common::{TWO, errors};
use takt_irl::{Code, FaultKind, System, compile};

const DOCS: &str = include_str!("../../../docs/irl.md");

/// What samples of statements use.
const HEAD: &str = "program t; var i: int; x: real; b: bool; p: position; e: event; a: array[1..3] of int; procedure act; begin i := 1; endproc;";

/// A symbol: terminals are written `"word"` and `name`, `integer`, `real`, `text`.
type Symbol = String;
/// A production: its left side and right side.
type Production = (Symbol, Vec<Symbol>);

/// Reads EBNF; groups become symbols of their own.
struct Ebnf {
    words: Vec<String>,
    at: usize,
    productions: Vec<Production>,
    groups: usize,
}

impl Ebnf {
    fn read(text: &str) -> Vec<Production> {
        let words = text.split_whitespace().map(str::to_owned).collect();
        let mut ebnf = Self {
            words,
            at: 0,
            productions: Vec::new(),
            groups: 0,
        };
        while ebnf.at < ebnf.words.len() {
            let left = ebnf.next();
            assert_eq!(ebnf.next(), "=", "{left}");
            ebnf.alternatives(&left);
            assert_eq!(ebnf.next(), ".", "{left}");
        }
        ebnf.productions
    }

    fn next(&mut self) -> String {
        self.at += 1;
        self.words[self.at - 1].clone()
    }

    fn alternatives(&mut self, left: &str) {
        loop {
            let mut right = Vec::new();
            while !["|", ".", "]", "}", ")"].contains(&self.words[self.at].as_str()) {
                let symbol = self.next();
                right.push(match symbol.as_str() {
                    "[" | "{" | "(" => self.group(&symbol),
                    _ => symbol,
                });
            }
            self.productions.push((left.to_owned(), right));
            if self.words[self.at] != "|" {
                return;
            }
            self.at += 1;
        }
    }

    fn group(&mut self, open: &str) -> Symbol {
        self.groups += 1;
        let group = format!("#{}", self.groups);
        let inner = format!("{group}i");
        self.alternatives(&inner);
        self.at += 1;
        let empty = (group.clone(), Vec::new());
        match open {
            "[" => self
                .productions
                .extend([empty, (group.clone(), vec![inner])]),
            "{" => {
                let more = (group.clone(), vec![group.clone(), inner]);
                self.productions.extend([empty, more]);
            }
            _ => self.productions.push((group.clone(), vec![inner])),
        }
        group
    }
}

/// Part of a production, with terminals that can follow it, by bit.
type Items = BTreeMap<(usize, usize), u128>;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Action {
    Shift(usize),
    Reduce(usize),
    Accept,
}

struct Tables {
    productions: Vec<Production>,
    /// Productions by left side.
    of: BTreeMap<Symbol, Vec<usize>>,
    terminals: Vec<Symbol>,
    first: BTreeMap<Symbol, u128>,
    nullable: BTreeSet<Symbol>,
    actions: Vec<BTreeMap<Symbol, Action>>,
    gotos: Vec<BTreeMap<Symbol, usize>>,
    conflicts: Vec<String>,
}

impl Tables {
    fn new(grammar: &str) -> Self {
        let mut productions = vec![("#".to_owned(), vec!["program".to_owned()])];
        productions.extend(Ebnf::read(grammar));
        let mut of: BTreeMap<Symbol, Vec<usize>> = BTreeMap::new();
        for (number, (left, _)) in productions.iter().enumerate() {
            of.entry(left.clone()).or_default().push(number);
        }
        let symbols = productions.iter().flat_map(|(_, right)| right);
        let terminals: BTreeSet<_> = symbols.filter(|s| !of.contains_key(*s)).cloned().collect();
        for terminal in &terminals {
            let is_word = terminal.starts_with('"');
            let is_class = ["name", "integer", "real", "text"].contains(&terminal.as_str());
            assert!(is_word || is_class, "`{terminal}` has no production");
        }
        let terminals: Vec<_> = std::iter::once("$".to_owned()).chain(terminals).collect();
        assert!(terminals.len() <= 128);
        let mut tables = Self {
            productions,
            of,
            terminals,
            first: BTreeMap::new(),
            nullable: BTreeSet::new(),
            actions: Vec::new(),
            gotos: Vec::new(),
            conflicts: Vec::new(),
        };
        tables.find_first();
        tables.build();
        tables
    }

    fn find_first(&mut self) {
        for (bit, terminal) in self.terminals.iter().enumerate() {
            self.first.insert(terminal.clone(), 1 << bit);
        }
        loop {
            let before = (self.first.clone(), self.nullable.len());
            for (left, right) in &self.productions {
                let (first, is_nullable) = self.first_of(right);
                *self.first.entry(left.clone()).or_default() |= first;
                if is_nullable {
                    self.nullable.insert(left.clone());
                }
            }
            if before == (self.first.clone(), self.nullable.len()) {
                return;
            }
        }
    }

    fn first_of(&self, symbols: &[Symbol]) -> (u128, bool) {
        let mut first = 0;
        for symbol in symbols {
            first |= self.first.get(symbol).copied().unwrap_or(0);
            if !self.nullable.contains(symbol) {
                return (first, false);
            }
        }
        (first, true)
    }

    fn closure(&self, kernel: &Items) -> Items {
        let mut items = kernel.clone();
        let mut open: Vec<_> = kernel.keys().copied().collect();
        while let Some((number, dot)) = open.pop() {
            let right = &self.productions[number].1;
            let Some(productions) = right.get(dot).and_then(|symbol| self.of.get(symbol)) else {
                continue;
            };
            let (mut follow, is_nullable) = self.first_of(&right[dot + 1..]);
            if is_nullable {
                follow |= items[&(number, dot)];
            }
            for next in productions {
                let known = items.contains_key(&(*next, 0));
                let set = items.entry((*next, 0)).or_default();
                if !known || *set | follow != *set {
                    *set |= follow;
                    open.push((*next, 0));
                }
            }
        }
        items
    }

    /// States with the same kernels are one; what can follow is added until nothing changes.
    fn build(&mut self) {
        let mut states: Vec<Items> = vec![Items::from([((0, 0), 1)])];
        let mut numbers = BTreeMap::from([(vec![(0, 0)], 0)]);
        let mut open = vec![0];
        while let Some(state) = open.pop() {
            self.gotos.resize(states.len(), BTreeMap::new());
            let mut kernels: BTreeMap<Symbol, Items> = BTreeMap::new();
            for ((number, dot), follow) in self.closure(&states[state]) {
                if let Some(symbol) = self.productions[number].1.get(dot) {
                    let kernel = kernels.entry(symbol.clone()).or_default();
                    kernel.insert((number, dot + 1), follow);
                }
            }
            for (symbol, kernel) in kernels {
                let core: Vec<_> = kernel.keys().copied().collect();
                let target = *numbers.entry(core).or_insert(states.len());
                if target == states.len() {
                    states.push(kernel);
                    open.push(target);
                } else {
                    let mut grows = false;
                    for (item, follow) in kernel {
                        let known = states[target].get_mut(&item).unwrap();
                        grows |= *known | follow != *known;
                        *known |= follow;
                    }
                    if grows && !open.contains(&target) {
                        open.push(target);
                    }
                }
                self.gotos[state].insert(symbol, target);
            }
        }
        self.gotos.resize(states.len(), BTreeMap::new());
        for (state, kernel) in states.iter().enumerate() {
            let mut actions = BTreeMap::new();
            for (symbol, target) in &self.gotos[state] {
                if !self.of.contains_key(symbol) {
                    actions.insert(symbol.clone(), Action::Shift(*target));
                }
            }
            for ((number, dot), follow) in self.closure(kernel) {
                let (left, right) = &self.productions[number];
                if dot < right.len() {
                    continue;
                }
                for (bit, terminal) in self.terminals.iter().enumerate() {
                    if follow & (1 << bit) == 0 {
                        continue;
                    }
                    let action = if number == 0 {
                        Action::Accept
                    } else {
                        Action::Reduce(number)
                    };
                    if let Some(other) = actions.insert(terminal.clone(), action) {
                        self.conflicts
                            .push(format!("{left} before {terminal}: {other:?} or {action:?}"));
                    }
                }
            }
            self.actions.push(actions);
        }
    }

    /// Whether a text follows the grammar.
    fn accepts(&self, text: &str) -> bool {
        let mut stack = vec![0];
        let mut words = words(text).into_iter().peekable();
        loop {
            let (terminal, class) = words
                .peek()
                .cloned()
                .unwrap_or_else(|| ("$".to_owned(), "$".to_owned()));
            let actions = &self.actions[*stack.last().unwrap()];
            let is_word = self.terminals.contains(&terminal);
            match actions.get(if is_word { &terminal } else { &class }) {
                Some(Action::Shift(state)) => {
                    stack.push(*state);
                    words.next();
                }
                Some(Action::Reduce(number)) => {
                    let (left, right) = &self.productions[*number];
                    stack.truncate(stack.len() - right.len());
                    stack.push(self.gotos[*stack.last().unwrap()][left]);
                }
                Some(Action::Accept) => return true,
                None => return false,
            }
        }
    }
}

/// Words of a text: each as a word symbol, and its class.
fn words(text: &str) -> Vec<(Symbol, Symbol)> {
    let mut rest = text.trim_start();
    let mut words = Vec::new();
    while let Some(c) = rest.chars().next() {
        let run = |part: fn(char) -> bool| rest.find(|c| !part(c)).unwrap_or(rest.len());
        let (len, class) = if c.is_ascii_alphabetic() {
            (run(|c| c.is_ascii_alphanumeric() || c == '_'), "name")
        } else if c.is_ascii_digit() {
            let whole = run(|c| c.is_ascii_digit());
            let fraction = rest[whole..].strip_prefix('.').unwrap_or_default();
            let digits = fraction
                .find(|c: char| !c.is_ascii_digit())
                .unwrap_or(fraction.len());
            if digits > 0 {
                (whole + 1 + digits, "real")
            } else {
                (whole, "integer")
            }
        } else if c == '"' {
            (rest[1..].find('"').map_or(rest.len(), |at| at + 2), "text")
        } else {
            let pairs = [":=", "<=", ">=", "<>", ".."];
            let is_pair = pairs.iter().any(|pair| rest.starts_with(pair));
            (if is_pair { 2 } else { 1 }, "")
        };
        words.push((
            format!("\"{}\"", &rest[..len].to_lowercase()),
            class.to_owned(),
        ));
        rest = rest[len..].trim_start();
    }
    words
}

fn tables() -> Tables {
    let grammar = DOCS.split("```ebnf\n").nth(1).unwrap();
    Tables::new(grammar.split("```").next().unwrap())
}

/// Production, accepted sample, refused sample and its code.
fn samples() -> Vec<[&'static str; 4]> {
    let table = DOCS.split("| production | accepted |").nth(1).unwrap();
    let rows = table
        .lines()
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let cells = |line: &'static str| {
        let cells = line.trim_matches('|').split(" | ");
        let cells: Vec<_> = cells.map(|cell| cell.trim().trim_matches('`')).collect();
        cells.try_into().unwrap()
    };
    rows.map(cells).collect()
}

/// A sample as a program: a program, declarations or statements.
fn whole(sample: &str) -> String {
    let is_declaration = [
        "const",
        "type",
        "var",
        "procedure",
        "function",
        "signal in",
        "signal out",
        "signal s",
    ]
    .iter()
    .any(|word| sample.starts_with(word));
    if sample.starts_with("program") {
        sample.to_owned()
    } else if is_declaration {
        format!("{HEAD} {sample} begin endprogram;")
    } else {
        format!("{HEAD} begin {sample} endprogram;")
    }
}

/// First cells of the table below a heading.
fn first_cells(heading: &str) -> Vec<&'static str> {
    let section = DOCS.split(heading).nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let rows = section.lines().filter(|line| line.starts_with('|'));
    let cells = rows
        .skip(2)
        .map(|row| row.split('|').nth(1).unwrap().trim());
    cells.collect()
}

#[test]
fn errors_and_faults_are_all_in_reference() {
    let codes = Code::ALL.map(Code::text);
    assert_eq!(first_cells("## Errors of a program\n"), codes);
    let faults: Vec<String> = FaultKind::ALL
        .iter()
        .map(|kind| (*kind as i32).to_string())
        .collect();
    assert_eq!(first_cells("## Faults of a running program\n"), faults);
}

#[test]
fn grammar_has_no_conflicts() {
    let tables = tables();
    assert_eq!(tables.conflicts, [""; 0]);
    // The checker finds one where there is one.
    let ambiguous = Tables::new("program = sum . sum = sum \"+\" sum | name .");
    assert!(!ambiguous.conflicts.is_empty());
}

#[test]
fn grammar_accepts_examples_and_samples() {
    let tables = tables();
    for text in [
        include_str!("../../../examples/irl/lola15.irl"),
        include_str!("../../../examples/irl/palletize.irl"),
    ] {
        let mut code = String::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once('{') {
            code.push_str(before);
            rest = after.split_once('}').unwrap().1;
        }
        code.push_str(rest);
        assert!(tables.accepts(&code), "{code}");
    }
    for [production, accepted, refused, code] in samples() {
        assert!(tables.accepts(&whole(accepted)), "{production}: {accepted}");
        // Errors of syntax are errors of the grammar, others are not.
        let is_syntax = code == "E0102";
        assert_eq!(
            tables.accepts(&whole(refused)),
            !is_syntax,
            "{production}: {refused}"
        );
    }
}

#[test]
fn productions_have_samples_with_codes() {
    let system = System::parse(TWO).unwrap();
    let mut wrong = Vec::new();
    for [production, accepted, refused, code] in samples() {
        let text = whole(accepted);
        if let Err(rejection) = compile(&text, &system, TWO) {
            wrong.push(format!(
                "{production}: {}",
                rejection.render("sample", &text)
            ));
        }
        let found = errors(&whole(refused));
        let first = found.first().map_or("", String::as_str);
        if !first.starts_with(code) {
            wrong.push(format!("{production}: {refused}: {code}, found {found:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let sampled: BTreeSet<_> = samples().iter().map(|sample| sample[0]).collect();
    for (left, _) in &tables().productions {
        let is_group = left.starts_with('#');
        assert!(
            is_group || sampled.contains(left.as_str()),
            "{left} has no sample"
        );
    }
}
