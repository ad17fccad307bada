//! What programs request of a machine, as values of fixed size: they pass to its thread without allocation and into
//! recordings as words.

use takt_machine::lifecycle::Request;
use takt_machine::machine::{ControlRefused, Machine, Refused};
use takt_machine::{Control, Kind, Peers as _, Value};

use super::components::Components;

/// Most properties that one request sets, and most arguments of a call.
pub const SETTINGS_MAX: usize = 8;

/// A request as words of a recording.
pub type InputWords = [u64; 4 + 3 * SETTINGS_MAX];

/// Properties by their numbers with their values, or arguments.
pub type Settings = [(usize, Value); SETTINGS_MAX];

/// A request to a machine, with the numbers of its program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MachineInput {
    /// Change the mode of a machine or of one inside.
    Control(usize, Control),
    /// Raise an event.
    Raise(usize),
    /// Change a machine to a state.
    Enter(usize, usize),
    /// Set a parameter, before the machine is activated.
    Parameter(usize, Value),
    /// Change the life cycle of a component.
    Request(usize, Request),
    /// Set the first properties of the list, all or none.
    Set(usize, usize, Settings),
    /// Write an in port.
    Write(usize, usize, Value),
    /// Call an operation of a component with the first arguments of the list.
    Call(usize, usize, usize, [Value; SETTINGS_MAX]),
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, thiserror::Error)]
pub enum InputError {
    /// A component refused.
    #[error("{0}")]
    Refused(#[from] Refused),
    /// The machine refused.
    #[error("{0}")]
    Control(#[from] ControlRefused),
    /// The machine is active, and parameters are read before.
    #[error(
        "a parameter cannot change while the machine is active\nhint: set it when the machine is loaded"
    )]
    Active,
    /// The controller was stopped since the machine was loaded.
    #[error(
        "the controller was stopped since the machine was loaded\nhint: load the machine again"
    )]
    Halted,
    /// No such machine or member.
    #[default]
    #[error("there is no such machine or member\nhint: load the machine again")]
    Unknown,
}

impl MachineInput {
    pub(super) fn apply(&self, machine: &mut Machine, components: &mut Components<'_>) -> Answer {
        Answer(match *self {
            Self::Control(number, control) => {
                machine.control(number, control).map_err(InputError::from)
            }
            Self::Raise(event) if event < machine.program().events().len() => {
                machine.raise(event);
                Ok(())
            }
            Self::Enter(number, state) if state < machine.program().states(number).count() => {
                machine.request_state(number, state);
                Ok(())
            }
            Self::Raise(_) | Self::Enter(..) => Err(InputError::Unknown),
            Self::Parameter(index, value) => machine
                .set_parameter_at(index, value)
                .then_some(())
                .ok_or(InputError::Active),
            Self::Request(component, request) => {
                let done = components.request(component, request);
                done.map_err(InputError::from)
            }
            Self::Set(component, count, values) => {
                let values = values.get(..count).unwrap_or_default();
                components.set(component, values).map_err(InputError::from)
            }
            Self::Write(component, port, value) => {
                let done = components.write(component, port, value);
                done.map_err(InputError::from)
            }
            Self::Call(component, operation, count, values) => {
                let values = values.get(..count).unwrap_or_default();
                let called = components.call(component, operation, values);
                called.map(|_| ()).map_err(InputError::from)
            }
        })
    }

    /// As words.
    #[must_use]
    pub fn words(&self) -> InputWords {
        let mut words = InputWords::default();
        let (head, list): ([usize; 4], &[(usize, Value)]) = match self {
            Self::Control(number, control) => {
                let control = Control::ALL.iter().position(|one| one == control);
                ([1, *number, control.unwrap_or(0), 0], &[])
            }
            Self::Raise(event) => ([2, *event, 0, 0], &[]),
            Self::Enter(number, state) => ([3, *number, *state, 0], &[]),
            Self::Parameter(number, value) => ([4, 0, 0, 1], &[(*number, *value)]),
            Self::Request(component, request) => {
                let request = Request::ALL.iter().position(|one| one == request);
                ([5, *component, request.unwrap_or(0), 0], &[])
            }
            Self::Set(component, count, values) => ([6, *component, 0, *count], values),
            Self::Write(component, port, value) => ([7, *component, *port, 1], &[(0, *value)]),
            Self::Call(component, operation, count, values) => {
                let pairs = values.map(|value| (0, value));
                return packed([8, *component, *operation, *count], &pairs, &mut words);
            }
        };
        packed(head, list, &mut words)
    }

    /// The request of these words; `None` if they are damaged.
    #[must_use]
    pub fn of_words(words: &[u64]) -> Option<Self> {
        let (head, list) = words.split_first_chunk::<4>()?;
        let number = |at: usize| usize::try_from(*head.get(at)?).ok();
        let count = number(3).filter(|count| *count <= SETTINGS_MAX)?;
        let mut pairs = [(0, Value::Bool(false)); SETTINGS_MAX];
        for (pair, words) in pairs.iter_mut().zip(list.chunks_exact(3)).take(count) {
            let [index, kind, bits] = *words else {
                return None;
            };
            let kind = *KINDS.get(usize::try_from(kind).ok()?)?;
            *pair = (usize::try_from(index).ok()?, Value::of_word(kind, bits)?);
        }
        let (a, b) = (number(1)?, number(2)?);
        let (index, value) = *pairs.first()?;
        Some(match number(0)? {
            1 => Self::Control(a, *Control::ALL.get(b)?),
            2 => Self::Raise(a),
            3 => Self::Enter(a, b),
            4 => Self::Parameter(index, value),
            5 => Self::Request(a, *Request::ALL.get(b)?),
            6 => Self::Set(a, count, pairs),
            7 => Self::Write(a, b, value),
            8 => Self::Call(a, b, count, pairs.map(|(_, value)| value)),
            _ => return None,
        })
    }
}

/// Kinds by their number in recordings.
const KINDS: [Kind; 3] = [Kind::Bool, Kind::Int, Kind::Double];

fn packed(head: [usize; 4], list: &[(usize, Value)], words: &mut InputWords) -> InputWords {
    for (word, number) in words.iter_mut().zip(head) {
        *word = number as u64;
    }
    let places = words.iter_mut().skip(4);
    let triples = list.iter().take(head[3]).flat_map(|(index, value)| {
        let kind = KINDS.iter().position(|kind| *kind == value.kind());
        [*index as u64, kind.unwrap_or(0) as u64, value.word()]
    });
    for (place, word) in places.zip(triples) {
        *place = word;
    }
    *words
}

/// The answer to a request; that of a machine that does not exist is an error.
#[derive(Debug)]
pub(super) struct Answer(pub(super) Result<(), InputError>);

impl Default for Answer {
    fn default() -> Self {
        Self(Err(InputError::Unknown))
    }
}
