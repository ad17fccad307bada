//! Which outputs of nets the robot program does not take: it does not share them, or shares them with another type. Nothing is
//! written here.

use takt_fri::sunrise::IoError;
use takt_fri::sunrise::wire::Name;

use crate::config::IiwaIo;
use crate::fri::RefusedOutput;

/// Which outputs are refused, digital ones before numbers.
#[derive(Debug)]
pub(super) struct Refusals {
    names: Vec<Name>,
    refused: Vec<Refusal>,
}

/// Whether an output is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Refusal {
    /// It is, or nothing was commanded.
    #[default]
    None,
    /// It is not, which is to be reported.
    New(IoError),
    /// It is not, which was reported.
    Reported(IoError),
}

impl Refusals {
    pub(super) fn new(io: &IiwaIo) -> Self {
        let names = io.bool_out.iter().chain(&io.real_out);
        let names: Vec<_> = names
            .map(|name| Name::new(name).unwrap_or_default())
            .collect();
        let refused = vec![Refusal::None; names.len()];
        Self { names, refused }
    }

    /// Notes whether the output of that number was written; the same error is reported once.
    pub(super) fn note(&mut self, number: usize, written: Result<(), IoError>) {
        let Some(refused) = self.refused.get_mut(number) else {
            return;
        };
        *refused = match (written, *refused) {
            (Ok(()), _) => Refusal::None,
            (Err(error), Refusal::Reported(before)) if before == error => *refused,
            (Err(error), _) => Refusal::New(error),
        };
    }

    /// The next refusal to be reported.
    pub(super) fn next(&self) -> Option<RefusedOutput> {
        let (number, error) = self.first_new()?;
        let name = *self.names.get(number)?;
        Some(RefusedOutput { name, error })
    }

    /// It was reported.
    pub(super) fn confirm(&mut self) {
        let reported = self.first_new();
        if let Some((number, error)) = reported
            && let Some(refused) = self.refused.get_mut(number)
        {
            *refused = Refusal::Reported(error);
        }
    }

    fn first_new(&self) -> Option<(usize, IoError)> {
        let mut all = self.refused.iter().enumerate();
        all.find_map(|(number, refused)| match refused {
            Refusal::New(error) => Some((number, *error)),
            Refusal::None | Refusal::Reported(_) => None,
        })
    }
}
