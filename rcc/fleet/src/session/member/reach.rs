//! Whether a member has a link to the rest of its fleet, reported at the onset of each change. It makes no link: zenoh tries again by
//! itself.

/// Periods of telemetry without a link before the first report: links of a fleet that starts together are made meanwhile.
const GRACE: u32 = 3;

/// What is known about the links of a member.
#[derive(Debug)]
pub(super) struct Reach {
    /// Endpoints to which it connects; empty for one that others connect to, which may be alone.
    connect: String,
    has_link: bool,
    is_reported: bool,
    /// Periods without a link.
    without: u32,
}

/// A change that was reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// There is no link, or none any more.
    Lost,
    /// There is one again.
    Found,
}

impl Reach {
    pub(super) fn new(connect: &[String]) -> Self {
        Self {
            connect: connect.join(", "),
            has_link: false,
            is_reported: false,
            without: 0,
        }
    }

    /// Takes the number of links of this period.
    pub(super) fn handle(&mut self, links: usize) -> Option<Change> {
        if links > 0 {
            self.without = 0;
            self.has_link = true;
            let was_lost = std::mem::take(&mut self.is_reported);
            if was_lost {
                tracing::info!("the fleet is reachable again at {}", self.connect);
            }
            return was_lost.then_some(Change::Found);
        }
        self.without = self.without.saturating_add(1);
        let is_due = self.has_link || self.without >= GRACE;
        if self.connect.is_empty() || self.is_reported || !is_due {
            return None;
        }
        self.is_reported = true;
        tracing::warn!(
            "the fleet is not reachable at {}: no link\nhint: is a router or cell there, and do the certificates of both fit? \
             `takt fleet doctor --connect …` checks each; this cell tries again by itself",
            self.connect
        );
        Some(Change::Lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn link_lost_is_reported_once_and_found_again() {
        let mut reach = Reach::new(&["tcp/127.0.0.1:7447".to_owned()]);
        let reports: Vec<_> = [0, 1, 0, 0, 0, 0, 2, 0]
            .into_iter()
            .map(|links| reach.handle(links))
            .collect();
        let (lost, found) = (Some(Change::Lost), Some(Change::Found));
        assert_eq!(reports, [None, None, lost, None, None, None, found, lost]);
    }

    #[test]
    fn link_never_made_is_reported_after_grace() {
        let mut reach = Reach::new(&["tcp/127.0.0.1:7447".to_owned()]);
        let reports: Vec<_> = (0..5).filter_map(|_| reach.handle(0)).collect();
        assert_eq!(reports, [Change::Lost]);
        let mut alone = Reach::new(&[]);
        assert!((0..9).all(|_| alone.handle(0).is_none()));
    }
}
