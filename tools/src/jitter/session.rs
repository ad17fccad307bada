//! A measurement from preparing the host to the finished report: the order of slices, the view, and early ends.
//!
//! Figures are measured by the cycle threads and cyclictest.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use takt_rt::host::{Host as Prepared, HostConfig, KERNEL, prepare};
use takt_rt::{Grant, Nanos, alloc, monotonic, sleep_until};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::Jitter;
use super::cyclictest::{self, Slice};
use super::host::{self, CpuTime, Host};
use super::load::Load;
use super::measure::{Hit, Measured, Plan};
use super::report::{Broke, Compare, Ratio, Report, SlicePair, ThreadReport, add_slice, pooled};
use super::trace::Tracer;
use super::view::{Scene, View};
use super::warning::{Entry, Warning};

/// How often the view is drawn and the end of the run is checked.
const POLL_EVERY: Duration = Duration::from_millis(250);
/// Margin after which the end of a slice is checked.
const AFTER_END: Duration = Duration::from_millis(2);
/// Slices of fewer cycles are not comparable.
const SLICE_CYCLES: u32 = 100;
/// Time for the load to reach its pace.
const LOAD_SETTLES: Duration = Duration::from_millis(300);

/// Measures by the options, and reports.
pub(super) fn measure(arguments: &Jitter) -> anyhow::Result<Report> {
    let mut plan = arguments.plan()?;
    let prepared = prepare(&HostConfig::default());
    let trace = plan.break_at.map(|_| Tracer::open());
    if let Some(Ok(_)) = &trace {
        plan.tracer = trace.and_then(Result::ok).map(Arc::new);
        return measure_with(arguments, &plan, &prepared, "");
    }
    let why = trace.and_then(Result::err).unwrap_or_default();
    measure_with(arguments, &plan, &prepared, &why)
}

fn measure_with(
    arguments: &Jitter,
    plan: &Plan,
    prepared: &Prepared,
    no_trace: &str,
) -> anyhow::Result<Report> {
    let mut report = Report {
        period_ns: Some(whole_ns(plan.period)),
        priority: plan.priority,
        load_workers: Some(arguments.load),
        duration_ns: whole_ns(plan.duration),
        host: Host::read(prepared.is_preempt_rt()),
        ..Report::new(format!("takt {}", env!("CARGO_PKG_VERSION")))
    };
    let mut session = Session {
        interrupt: Interrupt::new()?,
        interrupted: false,
        view: View::open(arguments.quiet, arguments.json),
        title: super::text::headline(&report),
        whole: plan.duration,
        done: Duration::ZERO,
    };
    let mut load = Load::start(arguments.load)?;
    if arguments.load > 0 {
        session.interrupted = session.interrupt.wait(LOAD_SETTLES);
    }
    let before = Counters::read(plan);
    let refused = if arguments.compare.is_some() {
        session.compare(plan, arguments.slices, &mut report)?
    } else {
        session.alone(plan, no_trace, &mut report)?
    };
    before.difference(plan, &mut report);
    let is_load_whole = load.is_whole() || session.interrupted;
    drop(load);
    report.interrupted = session.interrupted;
    report.warnings = warnings(&mut report, prepared, refused, is_load_whole);
    Ok(report)
}

fn whole_ns(span: Duration) -> u64 {
    u64::try_from(span.as_nanos()).unwrap_or(u64::MAX)
}

/// The state of a run: slices, view, progress.
struct Session {
    interrupt: Interrupt,
    /// Whether the run was ended before its time.
    interrupted: bool,
    view: View,
    title: String,
    /// How long the run takes, both tools together.
    whole: Duration,
    /// How much of it is over.
    done: Duration,
}

/// A slice of the other tool: its name and its threads.
type OtherSlice = (String, Vec<ThreadReport>);

/// What the slices before have measured, for the view.
#[derive(Clone, Copy, Default)]
struct SoFar<'a> {
    ours: &'a [ThreadReport],
    other: &'a [ThreadReport],
}

/// As many as fit, at least one. They are short, since the other load of a host changes from second to second and has
/// to affect both tools; not shorter, since each begins with cold caches.
fn usual_slices(plan: &Plan) -> u32 {
    const SLICE: Duration = Duration::from_millis(250);
    let slice = SLICE.max(plan.period * SLICE_CYCLES);
    let slices = plan.duration.as_nanos() / slice.as_nanos();
    u32::try_from(slices).unwrap_or(u32::MAX).max(1)
}

/// When to start both slices of that pair: the next instant with that pair's phase to the kernel's tick, after the
/// host has cleaned up after the slice before: the end of a process unmaps its memory on all processors.
///
/// All cycles of a slice have one phase to the tick, and those that come right behind it are twice as late as others.
/// Timers that start slices in whole milliseconds would give each tool the same phase all along, a
/// better or a worse one. So the pairs go through the phases in steps of the golden section, which cover them
/// evenly however many there are; 10 ms hold whole ticks of every usual rate.
fn start_of_slice(now: Nanos, number: u32) -> Nanos {
    const SPAN: i64 = 10_000_000;
    const STEP: i64 = 6_180_340;
    const CLEARED_UP: Nanos = Nanos(20_000_000);
    let now = now + CLEARED_UP;
    let phase = i64::from(number) * STEP % SPAN;
    now + Nanos((phase - now.0).rem_euclid(SPAN))
}

/// What one slice measures.
fn slice_of(plan: &Plan, slices: u32) -> anyhow::Result<Plan> {
    let slice = Plan {
        duration: plan.duration / slices,
        ..plan.clone()
    };
    anyhow::ensure!(
        slice.duration >= slice.period * SLICE_CYCLES,
        "slices of fewer than 100 cycles are not comparable\nhint: fewer --slices or a longer --duration"
    );
    anyhow::ensure!(
        slice.period.subsec_nanos().is_multiple_of(1000),
        "cyclictest takes whole microseconds\nhint: --period 1ms"
    );
    Ok(slice)
}

impl Session {
    /// Ours alone. Returns what the threads were refused.
    fn alone(
        &mut self,
        plan: &Plan,
        no_trace: &str,
        report: &mut Report,
    ) -> anyhow::Result<Vec<Grant>> {
        let measured = self.takt(plan, "", SoFar::default())?;
        report.threads = measured.iter().map(ThreadReport::from).collect();
        report.duration_ns = whole_ns(self.done);
        let first = |m: &&Measured| m.hit.map(|hit| hit.cycle);
        let hits = measured.iter().filter(|m| m.hit.is_some());
        report.broke = hits.min_by_key(first).and_then(|m| broke(m, no_trace));
        if let Some(broke) = &report.broke {
            // Not when it was noticed here.
            let cycles = u32::try_from(broke.cycle + 1).unwrap_or(u32::MAX);
            report.duration_ns = whole_ns(plan.period.saturating_mul(cycles));
        }
        Ok(measured.into_iter().flat_map(|m| m.refused).collect())
    }

    /// Ours and cyclictest in turns. Returns what our threads were refused.
    fn compare(
        &mut self,
        plan: &Plan,
        slices: Option<u32>,
        report: &mut Report,
    ) -> anyhow::Result<Vec<Grant>> {
        let slices = slices.unwrap_or_else(|| usual_slices(plan));
        let slice = slice_of(plan, slices)?;
        self.whole = plan.duration * 2;
        let mut refused = Vec::new();
        let mut other = Compare {
            tool: String::new(),
            command: cyclictest::command_line(&slice),
            threads: Vec::new(),
            slices: Vec::new(),
        };
        for number in 0..slices {
            let so_far = SoFar {
                ours: &report.threads,
                other: &other.threads,
            };
            let turn = format!("slice {} of {slices}", number + 1);
            let (measured, theirs) = self.pair(&slice, number, &turn, so_far)?;
            let ours: Vec<_> = measured.iter().map(ThreadReport::from).collect();
            // An incomplete pair would compare a quiet moment with nothing, unless there is no other.
            let Some((tool, theirs)) = theirs else {
                if report.threads.is_empty() {
                    report.threads = ours;
                }
                break;
            };
            refused = measured.into_iter().flat_map(|m| m.refused).collect();
            other.tool = tool;
            other.slices.push(SlicePair {
                takt_ns: pooled(&ours).quantiles(),
                other_ns: pooled(&theirs).quantiles(),
            });
            add_slice(&mut report.threads, &ours);
            add_slice(&mut other.threads, &theirs);
        }
        report.duration_ns = whole_ns(self.done) / 2;
        if !other.slices.is_empty() {
            let theirs = pooled(&other.threads).quantiles();
            report.ratio = Some(Ratio::of(&report.pooled().quantiles(), &theirs));
            report.compare = Some(other);
        }
        Ok(refused)
    }

    /// A slice of each, ours first in every other pair, so that neither tool is favoured. No slice of cyclictest if
    /// the run was interrupted, and then perhaps none of ours.
    fn pair(
        &mut self,
        slice: &Plan,
        number: u32,
        turn: &str,
        so_far: SoFar<'_>,
    ) -> anyhow::Result<(Vec<Measured>, Option<OtherSlice>)> {
        let (takt, other) = (format!("{turn}, takt"), format!("{turn}, cyclictest"));
        if number.is_multiple_of(2) {
            sleep_until(start_of_slice(monotonic(), number))?;
            let measured = self.takt(slice, &takt, so_far)?;
            if self.interrupted {
                return Ok((measured, None));
            }
            sleep_until(start_of_slice(monotonic(), number))?;
            return Ok((measured, self.cyclictest(slice, &other, so_far)?));
        }
        sleep_until(start_of_slice(monotonic(), number))?;
        let theirs = self.cyclictest(slice, &other, so_far)?;
        if theirs.is_none() {
            return Ok((Vec::new(), None));
        }
        sleep_until(start_of_slice(monotonic(), number))?;
        let measured = self.takt(slice, &takt, so_far)?;
        Ok((measured, theirs.filter(|_| !self.interrupted)))
    }

    /// Waits until the next check; whether a signal came. Every check wakes a processor, which disturbs the
    /// measurement, so checks are rare.
    fn wait(&mut self, plan: &Plan, elapsed: Duration) -> bool {
        let left = plan.duration.saturating_sub(elapsed) + AFTER_END;
        let is_polled = self.view.is_open() || plan.break_at.is_some();
        self.interrupt.wait(if is_polled {
            left.min(POLL_EVERY)
        } else {
            left
        })
    }

    /// A slice of ours, to its end or to the interruption.
    fn takt(
        &mut self,
        plan: &Plan,
        stage: &str,
        so_far: SoFar<'_>,
    ) -> anyhow::Result<Vec<Measured>> {
        let running = plan.start()?;
        while !running.is_finished() {
            let mut is_end = self.interrupted || self.wait(plan, running.elapsed());
            if self.view.is_open() {
                let mut threads = so_far.ours.to_vec();
                add_slice(&mut threads, &running.so_far());
                is_end |= self.view.show(&Scene {
                    title: &self.title,
                    stage: stage.to_owned(),
                    elapsed: self.done + running.elapsed(),
                    whole: self.whole,
                    threads,
                    other: so_far.other,
                })?;
            }
            if is_end {
                self.interrupted = true;
                // The threads end with their cycle; to wait here would be to wait for the whole time.
                running.stop();
                break;
            }
        }
        self.done += running.elapsed().min(plan.duration);
        running.join()
    }

    /// A slice of cyclictest; none if it was interrupted.
    fn cyclictest(
        &mut self,
        plan: &Plan,
        stage: &str,
        so_far: SoFar<'_>,
    ) -> anyhow::Result<Option<OtherSlice>> {
        let mut slice = Slice::start(plan)?;
        let started = Instant::now();
        while !slice.is_finished()? {
            let mut is_end = self.wait(plan, started.elapsed());
            if self.view.is_open() {
                is_end |= self.view.show(&Scene {
                    title: &self.title,
                    stage: stage.to_owned(),
                    elapsed: self.done + started.elapsed().min(plan.duration),
                    whole: self.whole,
                    threads: so_far.ours.to_vec(),
                    other: so_far.other,
                })?;
            }
            if is_end {
                self.interrupted = true;
                return Ok(None);
            }
        }
        self.done += plan.duration;
        slice.finish().map(Some)
    }
}

/// The text of a run that ended by a latency.
fn broke(measured: &Measured, no_trace: &str) -> Option<Broke> {
    let Hit {
        cycle,
        latency,
        is_marked,
    } = measured.hit?;
    let trace = match (is_marked, no_trace) {
        (true, _) => "marked, and tracing stopped; echo 1 to tracing_on goes on".to_owned(),
        (false, "") => "the kernel refused the mark".to_owned(),
        (false, why) => format!("not marked ({why})"),
    };
    Some(Broke {
        cpu: measured.cpu,
        cycle,
        latency_ns: latency.0.max(0).unsigned_abs(),
        trace,
        flight: measured.flight.clone(),
    })
}

/// What the host counts, before a run.
struct Counters {
    time: Option<CpuTime>,
    smi: Result<u32, String>,
    allocations: u64,
}

impl Counters {
    fn read(plan: &Plan) -> Self {
        Self {
            time: CpuTime::read(),
            smi: host::smi_count(plan.cpus.first().copied().flatten().unwrap_or(0)),
            allocations: alloc::real_time_allocations(),
        }
    }

    /// Puts the difference to now into the report.
    fn difference(self, plan: &Plan, report: &mut Report) {
        let now = Self::read(plan);
        report.rt_allocations = Some(now.allocations.saturating_sub(self.allocations));
        let spent = now.time.zip(self.time);
        let spent = spent.and_then(|(now, before)| now.busy_and_steal(before));
        (report.busy_percent, report.steal_percent) = spent.unzip();
        match (now.smi, self.smi) {
            (Ok(now), Ok(before)) => report.smi_count = Some(now.wrapping_sub(before)),
            (Err(why), _) | (_, Err(why)) => report.smi_unknown = Some(why),
        }
    }
}

/// Warnings of the report. A refused priority is also removed from it.
fn warnings(
    report: &mut Report,
    prepared: &Prepared,
    refused: Vec<Grant>,
    is_load_whole: bool,
) -> Vec<Entry> {
    let mut warnings = Vec::new();
    let mut fifo = None;
    for grant in refused {
        if grant.item.starts_with("SCHED_FIFO") {
            report.priority = None;
            fifo = Some(grant.to_string());
        } else {
            let grant = grant.to_string();
            warnings.push(Warning::Refused { grant });
        }
    }
    if report.priority.is_none() {
        warnings.push(Warning::NoFifo { refusal: fifo });
    }
    for grant in prepared.grants().iter().filter(|grant| grant.is_refused()) {
        warnings.push(if grant.item == KERNEL {
            Warning::NoRealTimeKernel
        } else {
            let grant = grant.to_string();
            Warning::Refused { grant }
        });
    }
    let name = report.host.virtual_machine.clone();
    warnings.extend(name.map(|name| Warning::VirtualMachine { name }));
    if is_load_whole {
        warnings.extend(report.busy_percent.and_then(Warning::of_load));
    } else {
        warnings.push(Warning::LoadEnded);
    }
    // The first long latency is found.
    if report.broke.is_none() {
        warnings.extend(Warning::of_duration(report.duration_ns));
    }
    warnings.iter().map(Warning::entry).collect()
}

/// Ctrl-C and SIGTERM, waited for with a timeout.
pub(crate) struct Interrupt {
    runtime: tokio::runtime::Runtime,
    interrupt: Signal,
    terminate: Signal,
}

impl Interrupt {
    pub(crate) fn new() -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("cannot wait for signals")?;
        let guard = runtime.enter();
        let listen = |kind| signal(kind).context("cannot listen for signals");
        let (interrupt, terminate) = (
            listen(SignalKind::interrupt())?,
            listen(SignalKind::terminate())?,
        );
        drop(guard);
        Ok(Self {
            runtime,
            interrupt,
            terminate,
        })
    }

    /// Waits so long, or until a signal comes; whether one came.
    pub(crate) fn wait(&mut self, span: Duration) -> bool {
        self.runtime.block_on(async {
            tokio::select! {
                _ = self.interrupt.recv() => true,
                _ = self.terminate.recv() => true,
                () = tokio::time::sleep(span) => false,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(period: Duration, duration: Duration) -> Plan {
        Plan {
            period,
            priority: None,
            cpus: vec![Some(0)],
            duration,
            break_at: None,
            tracer: None,
        }
    }

    #[test]
    fn slices_are_short_but_of_enough_cycles() {
        let slices = |period_us, duration_ms| {
            usual_slices(&plan(
                Duration::from_micros(period_us),
                Duration::from_millis(duration_ms),
            ))
        };
        assert_eq!(slices(1_000, 10_000), 40);
        assert_eq!(slices(10_000, 10_000), 10, "100 cycles of 10 ms");
        assert_eq!(slices(1_000, 120), 1);
    }

    #[test]
    fn slices_go_evenly_through_the_phases_of_the_tick() {
        let mut per_tenth = [0; 10];
        for number in 0..200 {
            let now = Nanos(i64::from(number) * 517_111_113);
            let start = start_of_slice(now, number);
            assert!((Nanos(20_000_000)..Nanos(30_000_000)).contains(&(start - now)));
            // Also within one cycle of 1 ms.
            let tenth = usize::try_from(start.0 % 1_000_000 / 100_000).unwrap();
            per_tenth[tenth] += 1;
        }
        let even = 15..=25;
        assert!(per_tenth.iter().all(|n| even.contains(n)), "{per_tenth:?}");
    }

    #[test]
    fn slices_too_short_are_refused() {
        let refused = |plan: &Plan, slices| slice_of(plan, slices).unwrap_err().to_string();
        let second = plan(Duration::from_millis(1), Duration::from_secs(1));
        assert_eq!(
            slice_of(&second, 10).unwrap().duration,
            Duration::from_millis(100)
        );
        assert!(refused(&second, 11).contains("fewer --slices"));
        let odd = plan(Duration::from_nanos(1_000_500), Duration::from_secs(1));
        assert!(refused(&odd, 1).contains("whole microseconds"));
    }
}
