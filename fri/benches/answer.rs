//! Time from a received datagram to its answer, in process: decoding, session, guards, encoding. `cargo bench -p takt-fri`.
//!
//! The baseline is the minimum of a C client with a fixed layout: copy the datagram into a struct, copy a prepared answer out,
//! with the two counters patched. It checks nothing and could not work for Sunrise, whose messages have no fixed layout; so the
//! ratio is an upper bound of the cost of the checks. Each sample includes one reading of the clock, on both
//! sides. The last line is JSON.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::hint::black_box;
use std::time::Duration;
use takt_fri::error::EncodeError;
use takt_fri::linux::monotonic;
use takt_fri::lwr::emulator::{Krc, KrcConfig};
use takt_fri::lwr::wire::{Cmd, Msr};
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX, Monitoring, unframe};
use takt_fri::{lwr, sunrise};

const SAMPLES: usize = 200_000;
type Failure = Box<dyn std::error::Error>;

/// Sorted durations of single runs, ns.
struct Samples(Vec<u64>);

impl Samples {
    /// `run` measures itself, so that what it prepares is not counted.
    fn take(mut run: impl FnMut(u32) -> Result<Duration, Failure>) -> Result<Self, Failure> {
        let mut samples = Vec::with_capacity(SAMPLES);
        for index in 0..u32::try_from(SAMPLES)? {
            samples.push(u64::try_from(run(index)?.as_nanos())?);
        }
        samples.sort_unstable();
        Ok(Self(samples))
    }

    fn quantile(&self, per_mille: usize) -> u64 {
        self.0[(self.0.len() - 1) * per_mille / 1000]
    }
}

/// A measurement in command mode, for any sequence number.
fn lwr_measurement() -> Msr {
    let mut krc = Krc::new(KrcConfig::default(), Duration::ZERO);
    let mut session = lwr::Session::new(lwr::SessionConfig::default());
    let (mut msr, mut cmd) = ([0; Msr::LEN], [0; Cmd::LEN]);
    loop {
        let now = krc.poll_timeout();
        while krc.poll_transmit(now, &mut msr).is_some() {
            if session.handle_datagram(&msr, now).is_err() {
                continue;
            }
            if let Some(found) = session.measurement().filter(|it| it.is_commanding()) {
                return *found;
            }
            if let Ok(len) = session.answer(None, &mut cmd) {
                let _answered = krc.handle_datagram(&cmd[..len], now);
            }
        }
    }
}

/// A monitoring message in COMMANDING_ACTIVE.
fn sunrise_message(dialect: Dialect) -> Monitoring {
    let config = CabinetConfig {
        dialect,
        ..CabinetConfig::default()
    };
    let mut cabinet = Cabinet::new(config, Duration::ZERO);
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
    loop {
        let now = cabinet.poll_timeout();
        while let Some(len) = cabinet.poll_transmit(now, &mut message) {
            let _taken = session.handle_datagram(&message[..len], now);
            if let (Ok(()), Some(found)) = (session.engage(), session.message()) {
                return *found;
            }
            if let Ok(built) = session.answer(&sunrise::Demand::Hold, &mut answer) {
                let _answered = cabinet.handle_datagram(&answer[..built.len], now);
            }
        }
    }
}

/// A copy in, a copy out, two counters patched.
fn baseline(datagram: &[u8], prepared: &[u8]) -> Result<Samples, Failure> {
    let (mut state, mut answer) = (vec![0; datagram.len()], vec![0; prepared.len()]);
    Samples::take(|index| {
        let before = monotonic()?;
        state.copy_from_slice(black_box(datagram));
        answer.copy_from_slice(prepared);
        answer[..4].copy_from_slice(&index.to_le_bytes());
        answer[4..6].copy_from_slice(&state[..2]);
        black_box(&answer);
        Ok(monotonic()? - before)
    })
}

fn lwr_case() -> Result<[Samples; 2], Failure> {
    let mut msr = lwr_measurement();
    let mut session = lwr::Session::new(lwr::SessionConfig::default());
    let mut datagrams = vec![[0; Msr::LEN]; 64];
    let mut cmd = [0; Cmd::LEN];
    let mut last = 0;
    let mut now = Duration::ZERO;
    let ours = Samples::take(|index| {
        let place = index as usize % datagrams.len();
        if place == 0 {
            refill(&mut datagrams, &mut msr, &mut last);
        }
        now += Duration::from_millis(2);
        let before = monotonic()?;
        let _taken = session.handle_datagram(black_box(&datagrams[place]), now);
        let mut joints = session.mirror();
        joints[0] += 1e-6;
        let _len = session.answer(Some(&joints), &mut cmd);
        black_box(&cmd);
        Ok(monotonic()? - before)
    })?;
    assert_eq!(session.counters().answered, SAMPLES as u64);
    Ok([ours, baseline(&datagrams[0], &cmd)?])
}

fn refill(datagrams: &mut [[u8; Msr::LEN]], msr: &mut Msr, last: &mut u16) {
    for datagram in datagrams {
        *last = last.wrapping_add(1);
        msr.header.sequence = *last;
        let _len: Result<usize, EncodeError> = msr.encode(datagram);
    }
}

fn sunrise_case(dialect: Dialect) -> Result<[Samples; 2], Failure> {
    let mut message = sunrise_message(dialect);
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let mut datagrams = vec![(0, [0; MESSAGE_MAX]); 64];
    let mut answer = [0; MESSAGE_MAX];
    let (mut now, mut len) = (Duration::ZERO, 0);
    let ours = Samples::take(|index| {
        let place = index as usize % datagrams.len();
        if place == 0 {
            for (len, datagram) in &mut datagrams {
                message.header.sequence += 1;
                *len = dialect
                    .frame(datagram, |buf| message.encode(buf))
                    .unwrap_or(0);
            }
        }
        let (datagram_len, datagram) = &datagrams[place];
        now += Duration::from_millis(2);
        let before = monotonic()?;
        let _taken = session.handle_datagram(black_box(&datagram[..*datagram_len]), now);
        let _engaged = session.engage();
        let mut joints = session.mirror();
        joints[0] += 1e-6;
        let built = session.answer(&sunrise::Demand::Position(joints), &mut answer);
        len = built.map_or(0, |built| built.len);
        black_box(&answer);
        Ok(monotonic()? - before)
    })?;
    assert_eq!(
        (session.counters().answered, session.counters().withheld),
        (SAMPLES as u64, 0)
    );
    assert!(unframe(&answer[..len]).is_ok());
    let (datagram_len, datagram) = &datagrams[0];
    Ok([ours, baseline(&datagram[..*datagram_len], &answer[..len])?])
}

fn main() -> Result<(), Failure> {
    let mut figures = Vec::new();
    println!(
        "received to answer ready, ns      p50     p99   p99.9   baseline p50   p99   ratio p50"
    );
    for (name, [ours, copy]) in [
        ("lwr", lwr_case()?),
        ("sunrise_v1", sunrise_case(Dialect::V1)?),
        ("sunrise_v3", sunrise_case(Dialect::V3)?),
    ] {
        let [p50, p99, p999] = [500, 990, 999].map(|it| ours.quantile(it));
        let [base_p50, base_p99] = [500, 990].map(|it| copy.quantile(it));
        let ratio = p50 as f64 / base_p50.max(1) as f64;
        println!(
            "{name:<28} {p50:>8} {p99:>7} {p999:>7} {base_p50:>14} {base_p99:>5} {ratio:>11.1}"
        );
        figures.push(format!(
            r#""{name}":{{"p50_ns":{p50},"p99_ns":{p99},"p999_ns":{p999},"baseline_p50_ns":{base_p50},"baseline_p99_ns":{base_p99},"ratio_p50":{ratio:.2}}}"#
        ));
    }
    println!(
        r#"{{"bench":"fri_answer","samples":{SAMPLES},{}}}"#,
        figures.join(",")
    );
    Ok(())
}
