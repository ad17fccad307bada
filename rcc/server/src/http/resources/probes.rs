//! `/probes/`: the names by which `/scope` finds values.

use super::super::Response;
use super::super::element::Element;
use super::Handler;

impl Handler<'_> {
    /// The probes whose names contain the query's `contains`.
    pub(super) fn probes(&self) -> Response {
        let found = self
            .controller
            .probes(self.query("contains").unwrap_or_default());
        let probes = found.probes.into_iter().map(|probe| {
            let states = probe.states.iter().enumerate();
            let states = states.map(|(number, name)| {
                let state = Element::new("state").with("number", number);
                state.text(name.clone())
            });
            Element::new("probe")
                .with("name", probe.name)
                .with("unit", probe.unit)
                .with("thread", probe.thread)
                .with("period_s", probe.period.as_secs_f64())
                .with("source", probe.source)
                .containing(states)
        });
        let all = Element::new("probes").with("left_off", found.left_off);
        self.show(&all.containing(probes))
    }
}
