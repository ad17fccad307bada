//! `/status/`: state of the controller in one response: its threads with their histograms, and the usage of all
//! quotas. The page displays it; nothing is judged here.

use takt_core::controller::{NETS_MAX, SESSIONS_MAX};

use super::super::Response;
use super::super::element::Element;
use super::Handler;
use super::nets::ms;
use crate::dio::all_devices;
use crate::server::SLOTS_MAX;
use crate::site::Counters;

/// Upper bounds of the histogram buckets, ns; longer times are in the total count only.
pub(super) const BOUNDS_NS: [u64; 14] = [
    1_000,
    2_000,
    5_000,
    10_000,
    20_000,
    50_000,
    100_000,
    200_000,
    500_000,
    1_000_000,
    2_000_000,
    5_000_000,
    10_000_000,
    100_000_000,
];

/// Cumulative counts up to each of [`BOUNDS_NS`], from buckets given by upper bound and count.
pub(super) fn cumulative(buckets: impl Iterator<Item = (i64, u64)>) -> [u64; BOUNDS_NS.len()] {
    let mut counts = [0; BOUNDS_NS.len()];
    for (upper_ns, count) in buckets {
        let upper_ns = u64::try_from(upper_ns).unwrap_or(0);
        for (bound, sum) in BOUNDS_NS.iter().zip(&mut counts) {
            *sum += if upper_ns <= *bound { count } else { 0 };
        }
    }
    counts
}

impl Handler<'_> {
    pub(super) fn status(&self) -> Response {
        let (controller, counters) = (self.controller, &self.site.counters);
        let of = |name: &str, used: usize, bound: usize| {
            let element = Element::new("count").with("name", name);
            element.with("used", used).with("bound", bound)
        };
        let clients = usize::try_from(Counters::read(&counters.clients)).unwrap_or(usize::MAX);
        let status = Element::new("status")
            .with("version", env!("CARGO_PKG_VERSION"))
            .with("allocations", controller.real_time_allocations())
            .containing([
                of("nets", controller.nets().len(), NETS_MAX),
                of("sessions", controller.sessions().len(), SESSIONS_MAX),
                of("clients", clients, SLOTS_MAX),
            ])
            .containing(self.threads())
            .containing(all_devices(controller).iter().map(|device| {
                Element::new("device")
                    .with("name", &device.name)
                    .with("type", &device.kind)
                    .with("state", device.status.word())
            }));
        self.show(&status)
    }

    fn threads(&self) -> Vec<Element> {
        let thread = |thread: &super::metrics::Thread| {
            let super::metrics::Thread {
                name,
                period,
                stats,
                clock,
            } = thread;
            let latency = stats.latency_buckets().map(|(bound, n)| (bound.0, n));
            let execution = stats.execution_buckets().map(|(bound, n)| (bound.0, n));
            let figure = |name, summary: &takt_core::Summary, counts: [u64; BOUNDS_NS.len()]| {
                let bounds = BOUNDS_NS.iter().zip(counts);
                let buckets = bounds.map(|(bound, count)| {
                    let bound = ms(std::time::Duration::from_nanos(*bound));
                    Element::new("bucket")
                        .with("le", bound)
                        .with("count", count)
                });
                Element::new(name)
                    .with("p50", ms(summary.p50))
                    .with("p99", ms(summary.p99))
                    .with("max", ms(summary.max))
                    .with("count", summary.count)
                    .containing(buckets)
            };
            let phase_error = clock.as_ref().map(|clock| {
                let buckets = stats.phase_error_buckets().map(|(bound, n)| (bound.0, n));
                figure("phaseerror", &stats.phase_error, cumulative(buckets))
                    .with("device", &clock.device)
                    .with("state", clock.state.to_string())
                    .with("phase", ms(clock.phase))
            });
            Element::new("thread")
                .with("name", name)
                .with("period", ms(*period))
                .with("cycles", stats.cycles)
                .with("missed", stats.overruns)
                .containing([
                    figure("latency", &stats.latency, cumulative(latency)),
                    figure("execution", &stats.execution, cumulative(execution)),
                ])
                .containing(phase_error)
        };
        super::metrics::threads(self.controller)
            .iter()
            .map(thread)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cumulative_counts_round_buckets_up() {
        let counts = cumulative([(900, 1), (1_000, 2), (1_001, 4), (i64::MAX, 8)].into_iter());
        assert_eq!(counts[..3], [3, 7, 7]);
        assert_eq!(counts[BOUNDS_NS.len() - 1], 7);
    }
}
