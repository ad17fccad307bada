//! Names and what they mean, by scope.

use std::collections::HashMap;
use std::rc::Rc;

use crate::types::{Type, predefined};

/// A value known when the program is compiled.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Int(i64),
    Real(f64),
    Bool(bool),
    Text(String),
}

impl Value {
    pub(super) const fn number(&self) -> Option<f64> {
        match self {
            Self::Int(value) => Some(*value as f64),
            Self::Real(value) => Some(*value),
            Self::Bool(_) | Self::Text(_) => None,
        }
    }
}

/// A variable.
#[derive(Clone, Debug)]
pub(super) struct Variable {
    pub(super) ty: Type,
    /// Scope and first word.
    pub(super) at: (u32, u32),
    /// Whether the word is the address of the variable.
    pub(super) is_reference: bool,
    pub(super) is_constant: bool,
}

/// A procedure or function.
#[derive(Debug)]
pub(super) struct Routine {
    pub(super) name: String,
    /// By reference or not, and the type.
    pub(super) parameters: Vec<(bool, Type)>,
    pub(super) result: Option<Type>,
    pub(super) entry: u32,
    /// Words of stack beyond its arguments.
    pub(super) stack: u32,
    pub(super) calls: u32,
    pub(super) threads: u32,
    pub(super) robots: u32,
}

#[derive(Clone, Debug)]
pub(super) enum Symbol {
    Constant(Value),
    Type(Type),
    Variable(Variable),
    /// Its number in the specification, and whether it is written.
    Signal(usize, bool),
    Routine(Rc<Routine>),
    /// A routine that is being compiled.
    Unfinished,
}

pub(super) struct Scopes {
    scopes: Vec<HashMap<String, Symbol>>,
}

impl Scopes {
    pub(super) fn new() -> Self {
        let types = predefined().into_iter();
        Self {
            scopes: vec![
                types.map(|(name, ty)| (name, Symbol::Type(ty))).collect(),
                HashMap::new(),
            ],
        }
    }

    pub(super) fn open(&mut self) {
        self.scopes.push(HashMap::new());
    }

    pub(super) fn close(&mut self) {
        self.scopes.pop();
    }

    pub(super) fn get(&self, name: &str) -> Option<&Symbol> {
        self.scopes.iter().rev().find_map(|scope| scope.get(name))
    }

    /// Declares a name; returns whether it is new in its scope.
    pub(super) fn declare(&mut self, name: &str, symbol: Symbol) -> bool {
        let scope = self.scopes.last_mut();
        scope.is_some_and(|scope| scope.insert(name.to_owned(), symbol).is_none())
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        let names = self.scopes.iter().flat_map(HashMap::keys);
        let mut names: Vec<&str> = names.map(String::as_str).collect();
        names.sort_unstable();
        names.into_iter()
    }
}
