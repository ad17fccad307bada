//! Components: a net with declared properties, data ports and operations. The text is a declaration, then the net. What
//! runs components, and in which thread, is decided elsewhere.

mod check;
mod configuration;
mod declaration;
mod parse;

use std::ops::Range;

use takt_net::{LoadContext, Plan, Rejection};

use crate::diagnostic::Diagnostics;

pub use configuration::{Configuration, Data, Refusal, RefusalReason};
pub use declaration::{
    ARRAY_MAX, Component, DECLARATIONS_MAX, Declared, EVERY_MAX, Operation, Port, Property,
};

impl Component {
    /// Reads a component file. Its net is parsed, but not loaded: that needs its devices.
    ///
    /// # Errors
    /// All errors of the declarations, of the syntax of the net, and where they do not fit together.
    pub fn parse(text: &str) -> Result<(Self, Diagnostics), Diagnostics> {
        let (component, mut found) = parse::parse(text);
        if let Some(component) = &component
            && !found.has_errors()
        {
            check::check(component, &mut found);
        }
        found.or(component)
    }

    /// Loads the net with the values of its properties: what `configure` does.
    ///
    /// # Errors
    /// All faults of the net, at locations of the component file.
    pub fn load(
        &self,
        configuration: &Configuration,
        context: &LoadContext<'_>,
    ) -> Result<Plan, Diagnostics> {
        takt_net::load(&self.net_text(configuration), context)
            .map_err(|rejection| self.locate(configuration, rejection))
    }

    /// Faults of the net, as it is loaded with the values of its properties, at locations of the component file.
    #[must_use]
    pub fn locate(&self, configuration: &Configuration, rejection: Rejection) -> Diagnostics {
        let filled = self.fill(configuration);
        let mut found = Diagnostics::default();
        for fault in rejection.faults {
            let at = filled.original(fault.at, self.net_start);
            let cause = fault.kind.to_string();
            found.error(
                at,
                cause,
                "the language of nets is described in docs/nets.md",
            );
        }
        found
    }

    /// The text of the net with the values of its properties.
    #[must_use]
    pub fn net_text(&self, configuration: &Configuration) -> String {
        self.fill(configuration).text
    }

    fn fill(&self, configuration: &Configuration) -> Filled {
        let mut filled = Filled::default();
        let mut copied = 0;
        for (at, name) in check::references(&self.net) {
            let index = self.properties.iter().position(|p| p.declared.name == name);
            let value = index.and_then(|index| configuration.values().get(index));
            let Some(value) = value.and_then(Option::as_ref) else {
                continue;
            };
            filled
                .text
                .push_str(self.net.get(copied..at.start).unwrap_or_default());
            let start = filled.text.len();
            filled.text.push_str(&format!("'{}'", value.net_text()));
            filled.pieces.push((start..filled.text.len(), at.clone()));
            copied = at.end;
        }
        filled
            .text
            .push_str(self.net.get(copied..).unwrap_or_default());
        filled
    }
}

/// A net with values, and where they stand.
#[derive(Debug, Default)]
struct Filled {
    text: String,
    /// Replaced bytes and what stood there.
    pieces: Vec<(Range<usize>, Range<usize>)>,
}

impl Filled {
    /// The bytes of the component file for bytes of the filled text.
    fn original(&self, at: Range<usize>, net_start: usize) -> Range<usize> {
        let one = |byte: usize, is_end: bool| {
            let before = self.pieces.iter().rev().find(|(new, _)| new.start <= byte);
            let original = match before {
                None => byte,
                Some((new, old)) if byte < new.end => {
                    if is_end {
                        old.end
                    } else {
                        old.start
                    }
                }
                Some((new, old)) => old.end + (byte - new.end),
            };
            net_start + original
        };
        let start = one(at.start, false);
        start..one(at.end, true).max(start)
    }
}

#[cfg(test)]
mod tests;
