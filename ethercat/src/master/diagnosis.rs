//! Locates bad cables by the error counters of all ports. A corrupted frame is counted as invalid by the first port
//! that receives it, and as forwarded by all behind; so the first port in the ring that counts invalid frames is behind
//! the bad cable. It allocates: do not call it in the cycle.

use std::fmt;

use super::event::Cable;
use super::{Master, PortCounters};

/// A cable with errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suspect {
    /// The cable.
    pub cable: Cable,
    /// Invalid frames and receive errors at its ends.
    pub errors: u64,
    /// Lost links at its ends.
    pub lost_links: u64,
}

impl fmt::Display for Suspect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cable,
            errors,
            lost_links,
        } = self;
        write!(f, "{cable}: ")?;
        if *lost_links > 0 {
            write!(
                f,
                "{lost_links} lost links (plug, supply of a neighbour, cable chain)"
            )?;
        }
        if *errors > 0 {
            let and = if *lost_links > 0 { " and " } else { "" };
            write!(
                f,
                "{and}{errors} broken frames (shield, bend, plug, disturbance)"
            )?;
        }
        Ok(())
    }
}

/// Errors and lost links that a port counted itself.
fn at_port(counters: &PortCounters, port: usize) -> (u64, u64) {
    let of = |counts: &[u64; 4]| counts.get(port).copied().unwrap_or(0);
    (
        of(&counters.invalid) + of(&counters.receive),
        of(&counters.lost_links),
    )
}

impl Master {
    /// Cables with errors since the start, worst first.
    pub fn suspects(&self) -> Vec<Suspect> {
        let mut all = Vec::new();
        for (position, number) in self.ring.iter().enumerate() {
            let Some(unit) = self.units.get(*number) else {
                continue;
            };
            let (mut errors, mut lost_links) = at_port(unit.counters(), 0);
            let parent = self.topology.parent(position);
            let above = parent.and_then(|(parent, port)| Some((*self.ring.get(parent)?, port)));
            if let Some((unit, port)) =
                above.and_then(|(number, port)| Some((self.units.get(number)?, port)))
            {
                let (more, links) = at_port(unit.counters(), port);
                errors += more;
                lost_links = lost_links.max(links);
            }
            if errors == 0 && lost_links == 0 {
                continue;
            }
            let from = above.map(|(number, port)| (number, u8::try_from(port).unwrap_or(0)));
            all.push(Suspect {
                cable: Cable {
                    from,
                    to: Some(*number),
                },
                errors,
                lost_links,
            });
        }
        all.sort_by_key(|suspect| std::cmp::Reverse((suspect.lost_links, suspect.errors)));
        all
    }
}
