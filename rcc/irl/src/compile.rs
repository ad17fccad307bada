//! The compiler: one pass over the syntax tree checks all types and emits code. It reports all errors at once. What the
//! code does is the interpreter's business.

mod declarations;
mod emit;
mod expressions;
mod motion;
mod places;
mod scope;
mod statements;

use std::rc::Rc;

use crate::code::{Opcode, Program, THREADS_MAX, WORDS_MAX};
use crate::diagnostic::{Code, Diagnostic, ERRORS_MAX, Rejection};
use crate::parse::parse;
use crate::spec::System;
use crate::tree::Span;
use crate::types::Type;
use emit::Emitter;
use scope::{Routine, Scopes};

/// A program and its warnings.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The object code.
    pub program: Program,
    /// Warnings, in text order.
    pub warnings: Vec<Diagnostic>,
}

/// The name of the system specification that a source text uses, if it names one, and the bytes of the text that do.
#[must_use]
pub fn specification_of(text: &str) -> Option<(String, std::ops::Range<usize>)> {
    let (program, _) = parse(text);
    program?.specification
}

/// Compiles a source text for a system; `system_text` is the text of its specification, whose sum the program keeps.
///
/// # Errors
/// All errors of the text, in its order.
pub fn compile(text: &str, system: &System, system_text: &str) -> Result<Compiled, Rejection> {
    let (tree, diagnostics) = parse(text);
    let mut compiler = Compiler {
        system,
        emitter: Emitter::new(text),
        scopes: Scopes::new(),
        routines: Vec::new(),
        diagnostics,
        block: Block::default(),
        globals: 0,
        robot_records: Vec::new(),
        variables: Vec::new(),
        texts: Vec::new(),
        stack: 0,
    };
    if let Some(tree) = &tree {
        compiler.program(tree);
    }
    compiler.diagnostics.sort_by_key(|d| (d.at.start, d.at.end));
    if compiler.diagnostics.iter().any(|d| !d.code.is_warning()) {
        return Err(Rejection {
            diagnostics: compiler.diagnostics,
        });
    }
    let Some(tree) = tree else {
        return Err(Rejection {
            diagnostics: compiler.diagnostics,
        });
    };
    let warnings = std::mem::take(&mut compiler.diagnostics);
    let program = compiler.finish(tree.name.text, text, system_text);
    Ok(Compiled { program, warnings })
}

/// What is counted while a routine, or the program, is compiled.
#[derive(Debug, Default)]
struct Block {
    /// Words of local variables; `None` outside of routines.
    locals: Option<u32>,
    result: Option<Type>,
    /// Number of the routine that is being compiled.
    routine: Option<usize>,
    /// Routines called within each other.
    calls: u32,
    /// Threads beside its own.
    threads: u32,
    /// Robots that it moves, by bit.
    robots: u32,
    /// Open loops: jumps of `exit` to patch.
    loops: Vec<Vec<usize>>,
    /// Whether it is a branch of `par`.
    is_branch: bool,
}

struct Compiler<'s> {
    system: &'s System,
    emitter: Emitter,
    scopes: Scopes,
    routines: Vec<Rc<Routine>>,
    diagnostics: Vec<Diagnostic>,
    block: Block,
    globals: u32,
    robot_records: Vec<u32>,
    variables: Vec<crate::code::Variable>,
    texts: Vec<String>,
    /// Largest stack of a thread, words.
    stack: u32,
}

/// An error has been reported.
#[derive(Clone, Copy, Debug)]
struct Reported;

type Checked<T> = Result<T, Reported>;

impl Compiler<'_> {
    fn report(&mut self, diagnostic: Diagnostic) -> Reported {
        if self.diagnostics.len() < ERRORS_MAX {
            self.diagnostics.push(diagnostic);
        }
        Reported
    }

    fn error(&mut self, code: Code, at: &Span, text: impl Into<String>) -> Reported {
        self.report(Diagnostic::new(code, at.clone(), text))
    }

    /// A new variable of this block: its scope and first word.
    fn slot(&mut self, words: u32, at: &Span) -> Checked<(u32, u32)> {
        let (scope, next) = match &mut self.block.locals {
            Some(locals) => (crate::code::LOCAL, locals),
            None => (crate::code::GLOBAL, &mut self.globals),
        };
        let first = *next;
        *next = next.saturating_add(words);
        let most = WORDS_MAX / THREADS_MAX / 2;
        if *next > most || words > crate::types::WORDS_MAX {
            *next = first;
            let cause = format!("the variables take more than {most} words of 8 bytes");
            return Err(self.error(Code::Bound, at, cause));
        }
        Ok((scope, first))
    }

    fn text(&mut self, text: &str) -> i64 {
        let known = self.texts.iter().position(|known| known == text);
        let number = known.unwrap_or_else(|| {
            self.texts.push(text.to_owned());
            self.texts.len() - 1
        });
        i64::try_from(number).unwrap_or(0)
    }

    fn finish(self, name: String, text: &str, system_text: &str) -> Program {
        Program {
            name,
            source_crc: crc32fast::hash(text.as_bytes()),
            system_crc: crc32fast::hash(system_text.as_bytes()),
            system: self.system.clone(),
            texts: self.texts,
            variables: self.variables,
            code: self.emitter.code,
            locations: self.emitter.locations,
            globals: self.globals,
            stack: self.stack,
            calls: self.block.calls,
            threads: self.block.threads + 1,
            robot_records: self.robot_records,
        }
    }

    fn program(&mut self, tree: &crate::tree::Program) {
        let start = tree.name.at.clone();
        self.system_variables(&start);
        for declaration in &tree.body.declarations {
            self.declaration(declaration);
        }
        self.statements(&tree.body.statements);
        let end = tree.name.at.clone();
        self.emitter.at(&end);
        self.emitter.op(Opcode::Sync);
        self.emitter.op(Opcode::Halt);
        self.stack = self.stack.max(self.emitter.deepest());
        if self.block.threads + 1 > THREADS_MAX {
            let found = self.block.threads + 1;
            let cause =
                format!("{found} branches run at the same time; at most {THREADS_MAX} are allowed");
            self.error(Code::Bound, &end, cause);
        }
        if self.emitter.code.len() > crate::code::INSTRUCTIONS_MAX
            || self.stack > WORDS_MAX / THREADS_MAX
        {
            self.error(Code::Bound, &end, "the program is too large");
        }
    }
}
