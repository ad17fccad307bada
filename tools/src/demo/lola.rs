//! `takt demo --cell lola`: the machine of `examples/machine/station` on the emulated test station. It starts, calibrates, initialises,
//! executes a program in L-IRL, and stops; each state is printed with its time, and the joints are drawn over time.

mod plot;
mod trace;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use takt_client::Value;
use takt_core::Controller;
use takt_core::controller::MachineInfo;
use takt_core::device::driver::Severity;
use takt_embedded::Machines;
use takt_irl::System;
use takt_machine::machine::Status;

use crate::client::Client;
use crate::demo::cell::{AXES, Kind, MACHINE, STATION};
use crate::demo::samples::{SAMPLE_EVERY, Samples};
use crate::output::say;
use crate::signal::Stop;
pub(super) use plot::draw;
pub(super) use trace::Trace;

/// The files of the components of its machine, by the names in its text.
const FILES: [(&str, &str); 6] = [
    (
        "../viewer.component",
        include_str!("../../../examples/machine/viewer.component"),
    ),
    (
        "../report.component",
        include_str!("../../../examples/machine/report.component"),
    ),
    (
        "trajectory_generator.component",
        include_str!("../../../examples/machine/station/trajectory_generator.component"),
    ),
    (
        "initialization.component",
        include_str!("../../../examples/machine/station/initialization.component"),
    ),
    (
        "servo_controller.component",
        include_str!("../../../examples/machine/station/servo_controller.component"),
    ),
    (
        "robot_interface.component",
        include_str!("../../../examples/machine/station/robot_interface.component"),
    ),
];
/// The program and its system specification.
const PROGRAM: &str = include_str!("../../../examples/irl/lola15.irl");
const SYSTEM: &str = include_str!("../../../examples/irl/lola15.spc");

/// How long the machine may take; it takes less than a minute.
const LATEST: Duration = Duration::from_mins(3);
/// How long the joints are drawn after the machine has ended.
const AFTER: Duration = Duration::from_secs(1);

/// What became of the machine.
#[derive(Debug)]
pub(super) struct Ended {
    pub(super) samples: Samples,
    pub(super) trace: Trace,
    /// Why it is not as it should be.
    pub(super) failures: Vec<String>,
}

/// Object code of the program, as the property of the trajectory generator.
fn code() -> anyhow::Result<String> {
    let system = System::parse(SYSTEM)?;
    let compiled = takt_irl::compile(PROGRAM, &system, SYSTEM)
        .map_err(|rejection| anyhow::anyhow!(rejection.render("lola15.irl", PROGRAM)))?;
    let code = compiled.program.encode();
    let digits: String = code.iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(format!("code = '{digits}'"))
}

/// Loads the machine, starts it, and follows it to its end.
pub(super) fn follow(
    controller: &Controller,
    machines: &Machines,
    client: &mut Client,
    stop: &Stop,
    is_quiet: bool,
) -> anyhow::Result<Ended> {
    let files = FILES.map(|(name, text)| (name.to_owned(), text.to_owned()));
    let properties = BTreeMap::from([("trajectory".to_owned(), code()?)]);
    let args = [
        MACHINE.into(),
        Value::map_of(BTreeMap::from(files)),
        client.session().into(),
        Value::map_of(BTreeMap::<String, String>::new()),
        Value::map_of(properties),
    ];
    let reply = client.machine("mane", args)?;
    let name = reply.first().and_then(Value::as_str);
    let name = name.context("the controller gave no machine")?.to_owned();
    client.machine("maco", [name.as_str().into(), "start".into()])?;
    let begin = Instant::now();
    let arms = Kind::Lola.moved();
    let mut samples = Samples::of(arms);
    let mut trace = Trace::default();
    let mut ended: Option<(Duration, MachineInfo)> = None;
    loop {
        let at = begin.elapsed();
        let info = controller.machine(&name)?;
        samples.take(controller, machines, arms, at);
        let line = trace.note(at, info.state(), controller);
        if let Some(line) = line.filter(|_| !is_quiet) {
            say(&line)?;
        }
        if info.status() != Status::Active {
            ended.get_or_insert((at, info));
        }
        if ended.as_ref().is_some_and(|(end, _)| at > *end + AFTER) {
            break;
        }
        if at > LATEST || stop.is_requested() {
            // It closes the brakes.
            client.machine("maen", [name.as_str().into()])?;
            break;
        }
        std::thread::sleep(SAMPLE_EVERY);
    }
    trace.end(begin.elapsed());
    let mut failures = failures(ended.map(|(_, info)| info), machines, stop);
    if !failures.is_empty() {
        let devices = [STATION.name].into_iter().chain(AXES);
        let reports = devices.flat_map(|device| controller.device_reports(device));
        let faults = reports.filter(|report| report.event.severity > Severity::Info);
        failures.extend(faults.map(|report| report.event.text));
        failures.dedup();
    }
    Ok(Ended {
        samples,
        trace,
        failures,
    })
}

/// What is wrong at the end.
fn failures(info: Option<MachineInfo>, machines: &Machines, stop: &Stop) -> Vec<String> {
    let mut failures = Vec::new();
    match info {
        Some(info) => {
            if let Some(failure) = info.failure(0) {
                failures.push(format!("the machine had an error {failure}"));
            }
            if info.status() != Status::Finished {
                failures.push(format!("the machine is {:?}, not finished", info.status()));
            }
        }
        None if stop.is_requested() => failures.push("stopped before its end".to_owned()),
        None => failures.push(format!("the machine has not ended after {LATEST:?}")),
    }
    let open = |axis: &usize| machines.station().is_some_and(|it| !it.is_braked(*axis));
    let open = (0..AXES.len()).filter(open);
    failures.extend(open.map(|axis| format!("the brake of axis {axis} is open at the end")));
    failures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lola_program_compiles_to_object_code() {
        let code = code().unwrap();
        assert!(code.starts_with("code = '5449524c"), "{code}");
    }
}
