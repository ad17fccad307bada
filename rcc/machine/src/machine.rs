//! The machine language: states with programs over components. A text is parsed, compiled to bounded code and checked along
//! all paths before it may run; [`Machine`] is stepped once a period. Where components run is decided elsewhere.

mod analysis;
mod code;
mod compile;
mod cost;
mod graph;
mod parse;
mod run;
mod tree;

use crate::diagnostic::Diagnostics;

pub use code::{Connection, Control, Member, Program, Status, Variable};
pub use compile::Library;
pub use graph::{Edge, Graph, Node};
pub use run::{Cause, ControlRefused, Failure, Machine, Mode, Outcome, Peers, Refused, Ticket};

impl Program {
    /// Compiles and checks a machine. Component files are read from the library.
    ///
    /// # Errors
    /// All errors of the text. Paths through the states are checked once names and types are correct.
    pub fn compile(text: &str, library: &dyn Library) -> Result<(Self, Diagnostics), Diagnostics> {
        let (tree, found) = parse::parse(text);
        let Some(tree) = tree else {
            return found.or(None);
        };
        let (mut program, mut found) = compile::compile(&tree, text, library, found);
        if !found.has_errors() {
            analysis::check(&program, &mut found);
            cost::bound(&mut program);
        }
        found.or(Some(program))
    }
}

#[cfg(test)]
mod tests;
