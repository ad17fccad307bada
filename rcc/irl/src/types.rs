//! The types of L-IRL and their layout in words of 64 bits.

use std::rc::Rc;

/// A type.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Type {
    Int,
    Real,
    Bool,
    Char,
    Text,
    Event,
    Array(Rc<Array>),
    Record(Rc<Record>),
}

#[derive(Debug, PartialEq)]
pub(crate) struct Array {
    pub(crate) ranges: Vec<(i32, u32)>,
    pub(crate) of: Type,
}

#[derive(Debug, PartialEq)]
pub(crate) struct Record {
    pub(crate) name: String,
    /// Name, type and first word.
    pub(crate) fields: Vec<(String, Type, u32)>,
    pub(crate) words: u32,
}

/// Most words of one variable.
pub(crate) const WORDS_MAX: u32 = 1 << 16;

impl Type {
    pub(crate) fn record(name: &str, fields: &[(&str, Self)]) -> Self {
        let mut words = 0;
        let mut placed = Vec::new();
        for (name, ty) in fields {
            placed.push(((*name).to_owned(), ty.clone(), words));
            words += ty.words();
        }
        Self::Record(Rc::new(Record {
            name: name.to_owned(),
            fields: placed,
            words,
        }))
    }

    pub(crate) fn words(&self) -> u32 {
        match self {
            Self::Array(array) => array
                .ranges
                .iter()
                .fold(array.of.words(), |words, (_, count)| {
                    words.saturating_mul(*count)
                }),
            Self::Record(record) => record.words,
            Self::Int | Self::Real | Self::Bool | Self::Char | Self::Text | Self::Event => 1,
        }
    }

    pub(crate) const fn is_number(&self) -> bool {
        matches!(self, Self::Int | Self::Real)
    }

    /// Whether it is the predefined record of that name.
    pub(crate) fn is(&self, name: &str) -> bool {
        matches!(self, Self::Record(record) if record.name == name)
    }

    pub(crate) fn shown(&self) -> String {
        match self {
            Self::Int => "int".to_owned(),
            Self::Real => "real".to_owned(),
            Self::Bool => "bool".to_owned(),
            Self::Char => "char".to_owned(),
            Self::Text => "string".to_owned(),
            Self::Event => "event".to_owned(),
            Self::Array(array) => format!("array of {}", array.of.shown()),
            Self::Record(record) => record.name.clone(),
        }
    }
}

/// The predefined records.
#[expect(clippy::too_many_lines, reason = "a table of types")]
pub(crate) fn predefined() -> Vec<(String, Type)> {
    let real = || Type::Real;
    let position = Type::record("position", &[("x", real()), ("y", real()), ("z", real())]);
    let orientation = Type::record(
        "orientation",
        &[
            ("q1", real()),
            ("q2", real()),
            ("q3", real()),
            ("q4", real()),
        ],
    );
    let pose = Type::record(
        "pose",
        &[("pos", position.clone()), ("ori", orientation.clone())],
    );
    let main: Vec<_> = ["a1", "a2", "a3", "a4", "a5", "a6", "a7"]
        .into_iter()
        .map(|name| (name, real()))
        .collect();
    let main = Type::record("mainjoint", &main);
    let add: Vec<_> = ["aa1", "aa2", "aa3", "aa4", "aa5", "aa6"]
        .into_iter()
        .map(|name| (name, real()))
        .collect();
    let add = Type::record("addjoint", &add);
    let joint = Type::record(
        "joint",
        &[("m_joint", main.clone()), ("a_joint", add.clone())],
    );
    let turns = Type::Array(Rc::new(Array {
        ranges: vec![(1, 2)],
        of: Type::Int,
    }));
    let target = Type::record(
        "robtarget",
        &[
            ("pse", pose.clone()),
            ("status", Type::Int),
            ("turns", turns),
            ("a_joint", add.clone()),
        ],
    );
    let bounds = Type::record("bounds", &[("lower", real()), ("upper", real())]);
    let robot = Type::record(
        "robot",
        &[
            ("r_speed", real()),
            ("r_acc", real()),
            ("r_speed_ori", real()),
            ("r_speed_ptp", real()),
            ("r_acc_ptp", real()),
            ("r_c_ptp", real()),
            ("r_c_cp", real()),
            ("r_base", pose.clone()),
            ("r_tool", pose.clone()),
            ("r_joint_act", main.clone()),
            ("r_pose_act", pose.clone()),
        ],
    );
    let named = [
        position,
        orientation,
        pose,
        main,
        add,
        joint,
        target,
        bounds,
        robot,
    ];
    let scalars = [
        ("int", Type::Int),
        ("real", Type::Real),
        ("bool", Type::Bool),
        ("char", Type::Char),
        ("string", Type::Text),
        ("event", Type::Event),
    ];
    let records = named.into_iter().map(|ty| (ty.shown(), ty));
    let scalars = scalars.into_iter().map(|(name, ty)| (name.to_owned(), ty));
    scalars.chain(records).collect()
}
