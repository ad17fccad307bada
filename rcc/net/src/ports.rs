//! The ports of a plan by name, and samples of their values in words of one kind: what a scope reads of a running net. Where the
//! samples go is the executor's business. A plan that is not sampled has no cost for them.

use std::sync::Arc;

use crate::plan::Plan;
use crate::slots::SlotRef;
use crate::value::unit::{Dimension, Quantity};
use crate::value::{Element, Type, Value};

/// The bits of a sample that is null: a NaN that no arithmetic gives, so that null and a value that is not a number differ.
pub const NULL: u64 = 0x7ff8_6e75_6c6c_0000;

/// A port of a net.
#[derive(Clone, Debug)]
pub struct Port {
    /// Names of its fragments, of its primitive, and its own, joined by dots.
    pub name: Box<str>,
    /// Type of its values.
    pub ty: Type,
    /// What its numbers measure.
    pub quantity: Quantity,
    /// Whether it is an in port, which has the value of the out port that it is linked to.
    pub is_in: bool,
    pub(crate) slot: SlotRef,
    /// The innermost guard around the source of its value; 0 for none.
    pub(crate) guard: u32,
}

/// One number of a port's value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortPart {
    /// What follows the port's name: nothing for a single number, else such as `.x` or `[3].rz`.
    pub suffix: String,
    /// SI unit; empty if it has none or its net makes of it what it wants.
    pub unit: String,
}

impl Port {
    /// Number of numbers of its value.
    pub fn len(&self) -> usize {
        self.slot.words()
    }

    /// Whether its value has no numbers, as an array of length 0.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The numbers of its value.
    pub fn parts(&self) -> impl Iterator<Item = PortPart> + '_ {
        let names = components(self.ty.element);
        (0..self.len()).map(move |number| {
            let (name, dimension) = names.get(number % names.len()).copied().unwrap_or_default();
            let mut suffix = String::new();
            if self.ty.array {
                suffix = format!("[{}]", number / names.len());
            }
            suffix.push_str(name);
            let of_port = match self.quantity {
                Quantity::Of(dimension) if self.ty.element != Element::Bool => Some(dimension),
                Quantity::Of(_) | Quantity::Any | Quantity::Number => None,
            };
            let unit = dimension.or(of_port).map(|it| it.to_string());
            PortPart {
                suffix,
                unit: unit.unwrap_or_default(),
            }
        })
    }
}

/// The suffix of each number of an element in the order of its words, with its unit where the type defines it.
pub const fn components(element: Element) -> &'static [(&'static str, Option<Dimension>)] {
    const LENGTH: Option<Dimension> = Some(Dimension::LENGTH);
    const VELOCITY: Option<Dimension> = Some(Dimension::VELOCITY);
    const ROTATION: Option<Dimension> = Some(Dimension::ROTATION);
    const FORCE: Option<Dimension> = Some(Dimension::FORCE);
    const TORQUE: Option<Dimension> = Some(Dimension::TORQUE);
    match element {
        Element::Bool | Element::Int | Element::Double => &[("", None)],
        Element::Nanos => &[("", Some(Dimension::TIME))],
        Element::Vector => &[(".x", None), (".y", None), (".z", None)],
        Element::Rotation => &[(".qw", None), (".qx", None), (".qy", None), (".qz", None)],
        Element::Frame => &[
            (".x", LENGTH),
            (".y", LENGTH),
            (".z", LENGTH),
            (".qw", None),
            (".qx", None),
            (".qy", None),
            (".qz", None),
        ],
        Element::Twist => &[
            (".x", VELOCITY),
            (".y", VELOCITY),
            (".z", VELOCITY),
            (".rx", ROTATION),
            (".ry", ROTATION),
            (".rz", ROTATION),
        ],
        Element::Wrench => &[
            (".x", FORCE),
            (".y", FORCE),
            (".z", FORCE),
            (".rx", TORQUE),
            (".ry", TORQUE),
            (".rz", TORQUE),
        ],
    }
}

/// All ports of a net.
#[derive(Debug, Default)]
pub struct Ports {
    ports: Box<[Port]>,
    /// By guard, the one around it; 0 for none.
    guards: Box<[u32]>,
}

impl Ports {
    pub(crate) fn new(ports: Vec<Port>, guards: Box<[u32]>) -> Self {
        Self {
            ports: ports.into_boxed_slice(),
            guards,
        }
    }

    /// All of them: the ports of a primitive one after the other.
    pub fn all(&self) -> &[Port] {
        &self.ports
    }

    /// The port of that name.
    pub fn find(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|port| *port.name == *name)
    }

    /// What is sampled: the values of these ports, one after the other.
    pub fn sampled<'p>(&self, ports: impl IntoIterator<Item = &'p Port>) -> Sampled {
        let source = |port: &Port| {
            let mut guards = Vec::new();
            let mut guard = port.guard;
            while guard != 0 {
                guards.push(guard);
                guard = self.guards.get(guard as usize).copied().unwrap_or(0);
            }
            Source {
                slot: port.slot,
                words: port.len(),
                guards: guards.into_boxed_slice(),
            }
        };
        Sampled(ports.into_iter().map(source).collect())
    }

    /// Memory of the names, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        let names: usize = self.ports.iter().map(|port| port.name.len()).sum();
        size_of_val(&*self.ports) + size_of_val(&*self.guards) + names
    }
}

/// The source of a sample.
#[derive(Debug)]
struct Source {
    slot: SlotRef,
    words: usize,
    /// Guards that must be active for the slot to hold a value of the present cycle.
    guards: Box<[u32]>,
}

/// The sampled ports of one plan.
#[derive(Debug, Default)]
pub struct Sampled(Box<[Source]>);

impl Sampled {
    /// Number of words of one sample.
    pub fn words(&self) -> usize {
        self.0.iter().map(|source| source.words).sum()
    }
}

impl Plan {
    /// Its ports.
    pub const fn ports(&self) -> &Arc<Ports> {
        &self.ports
    }

    /// Writes the values of the last evaluated cycle as bits of `f64`: Boolean values as 0 and 1, times in s, [`NULL`] for null.
    pub fn sample(&self, sampled: &Sampled, mut words: &mut [u64]) {
        for source in &sampled.0 {
            let Some((own, rest)) = words.split_at_mut_checked(source.words) else {
                return;
            };
            let active = |guard: &u32| {
                let guard = self.guards.get(*guard as usize);
                guard.is_some_and(|guard| guard.was_active)
            };
            if source.guards.iter().all(active) && source.slot.put(&self.slots, own) {
                source.slot.make_numbers(own);
            } else {
                own.fill(NULL);
            }
            words = rest;
        }
    }
}

impl SlotRef {
    /// Turns the words of a value into the bits of `f64`.
    #[expect(clippy::cast_precision_loss, reason = "times below 104 days are exact")]
    fn make_numbers(self, words: &mut [u64]) {
        let (Self::Scalar { element, .. } | Self::Array { element, .. }) = self;
        match element {
            Element::Bool => words.iter_mut().for_each(|word| {
                *word = f64::from(u8::from(*word != 0)).to_bits();
            }),
            Element::Int => words.iter_mut().for_each(|word| {
                let number = i32::take(|_| *word);
                *word = f64::from(number).to_bits();
            }),
            Element::Nanos => words.iter_mut().for_each(|word| {
                *word = (word.cast_signed() as f64 * 1e-9).to_bits();
            }),
            Element::Double
            | Element::Vector
            | Element::Rotation
            | Element::Frame
            | Element::Twist
            | Element::Wrench => {}
        }
    }
}
