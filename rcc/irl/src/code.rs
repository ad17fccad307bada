//! Object code: a program as the interpreter executes it. Its binary form is in `binary`, its listing in `listing`.

mod binary;
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "instructions without operands are listed by their names"
)]
mod listing;

pub use binary::{CodeError, VERSION};

use crate::spec::System;

/// Most instructions of a program.
pub(crate) const INSTRUCTIONS_MAX: usize = 1 << 18;
/// Most words of all global variables, and of the stacks of all threads.
pub(crate) const WORDS_MAX: u32 = 1 << 20;
/// Most threads: branches of `par` that run at the same time, and the program itself.
pub(crate) const THREADS_MAX: u32 = 16;

macro_rules! opcodes {
    ($($name:ident = $code:literal, $text:literal;)*) => {
        /// What an instruction does. Its number in object code never changes.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub(crate) enum Opcode { $($name = $code,)* }

        impl Opcode {
            pub(crate) const ALL: &[Self] = &[$(Self::$name,)*];

            pub(crate) const fn text(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }
        }
    };
}

opcodes! {
    Const = 1, "const";
    Load = 2, "load";
    Store = 3, "store";
    Addr = 4, "addr";
    Index = 5, "index";
    Fetch = 6, "fetch";
    Put = 7, "put";
    Take = 8, "take";
    Drop = 9, "drop";
    Enter = 10, "enter";
    Call = 11, "call";
    Return = 12, "return";
    Jump = 13, "jump";
    Unless = 14, "unless";
    Trap = 15, "trap";
    AddInt = 20, "add.int";
    SubInt = 21, "sub.int";
    MulInt = 22, "mul.int";
    DivInt = 23, "div.int";
    ModInt = 24, "mod.int";
    NegInt = 25, "neg.int";
    AddReal = 26, "add.real";
    SubReal = 27, "sub.real";
    MulReal = 28, "mul.real";
    DivReal = 29, "div.real";
    NegReal = 30, "neg.real";
    ToReal = 31, "real";
    SwapToReal = 32, "real.below";
    CompareInt = 33, "compare.int";
    CompareReal = 34, "compare.real";
    And = 35, "and";
    Or = 36, "or";
    Exor = 37, "exor";
    Not = 38, "not";
    Builtin = 39, "builtin";
    In = 50, "in";
    Out = 51, "out";
    Move = 52, "move";
    Sync = 53, "sync";
    Wait = 54, "wait";
    Yield = 55, "yield";
    Now = 56, "now";
    TimedOut = 57, "timed_out";
    SetTimedOut = 58, "set.timed_out";
    Fork = 60, "fork";
    Join = 61, "join";
    End = 62, "end";
    Pause = 63, "pause";
    Halt = 64, "halt";
}

/// An instruction with its operands; those that it does not have are 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Instruction {
    pub(crate) opcode: Opcode,
    pub(crate) a: u32,
    pub(crate) b: u32,
    pub(crate) c: u32,
}

/// The type of a variable that can be observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Scalar {
    /// A whole number.
    Int = 0,
    /// A real number.
    Real = 1,
    /// True or false.
    Bool = 2,
}

/// A global variable, or a component of one, that can be observed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variable {
    /// Its name, such as `p.pos.x`.
    pub name: String,
    /// Its word.
    pub at: u32,
    /// How to read it.
    pub scalar: Scalar,
}

/// Location in the source text, from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Location {
    /// Line.
    pub line: u32,
    /// Column, in characters.
    pub column: u32,
}

/// A compiled program.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// Its name.
    pub name: String,
    /// CRC-32 of the source text.
    pub source_crc: u32,
    /// CRC-32 of the text of the system specification.
    pub system_crc: u32,
    /// Robots and signals that it was compiled for.
    pub system: System,
    /// Texts of the program.
    pub texts: Vec<String>,
    /// What can be observed.
    pub variables: Vec<Variable>,
    pub(crate) code: Vec<Instruction>,
    pub(crate) locations: Vec<Location>,
    /// Words of global variables.
    pub(crate) globals: u32,
    /// Words of the stack of each thread.
    pub(crate) stack: u32,
    /// Most routines called within each other.
    pub(crate) calls: u32,
    pub(crate) threads: u32,
    /// First words of the records of robots.
    pub(crate) robot_records: Vec<u32>,
}

impl Program {
    /// Number of instructions.
    #[must_use]
    pub fn instructions(&self) -> usize {
        self.code.len()
    }

    /// Number of threads that it needs.
    #[must_use]
    pub const fn threads(&self) -> u32 {
        self.threads
    }

    /// Bytes of memory that its interpreter takes for variables and stacks.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        (self.globals as usize + self.stack as usize * self.threads as usize) * 8
    }
}

/// Scopes of `Load`, `Store` and `Addr`.
pub(crate) const GLOBAL: u32 = 0;
pub(crate) const LOCAL: u32 = 1;

/// Flags of `Move` in operand a.
pub(crate) const MOVE_PATH: u32 = 3;
pub(crate) const MOVE_INC: u32 = 4;
pub(crate) const MOVE_JOINTS: u32 = 8;
pub(crate) const MOVE_POSITION: u32 = 16;

/// Attributes of `Move` by bit of operand c, in the order of their values on the stack.
pub(crate) const ATTRIBUTES: [&str; 9] = [
    "speed_ptp",
    "acc_ptp",
    "c_ptp",
    "speed",
    "acc",
    "c_cp",
    "c_ori",
    "speed_ori",
    "time",
];

/// Least and largest value of each attribute.
pub(crate) const RANGES: [(f64, f64); ATTRIBUTES.len()] = [
    (1e-3, 1.0),
    (1e-3, 1.0),
    (0.0, 0.5),
    (1e-3, 1e6),
    (1e-3, 1e6),
    (0.0, 1e6),
    (0.0, 360.0),
    (1e-3, 1e6),
    (1e-3, 1e5),
];

/// Relations of `CompareInt` and `CompareReal` in operand a.
pub(crate) const RELATIONS: [&str; 6] = ["=", "<>", "<", "<=", ">", ">="];
