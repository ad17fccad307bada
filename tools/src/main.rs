#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(all(feature = "fri", feature = "ethercat", feature = "can")),
    allow(
        dead_code,
        unused_imports,
        reason = "used by commands that are not built"
    )
)]

mod arm;
#[cfg(feature = "can")]
mod can;
mod cell;
mod client;
mod confirm;
#[cfg(feature = "demo")]
mod demo;
mod doctor;
#[cfg(feature = "ethercat")]
mod ecat;
mod emulate;
#[cfg(feature = "fleet")]
mod fleet;
#[cfg(feature = "fri")]
mod fri;
mod grip;
mod http;
mod io;
mod irl;
mod jitter;
#[cfg(any(feature = "can", feature = "ethercat"))]
mod jog;
mod link;
mod logging;
mod machine;
mod manual;
mod motion;
mod net;
#[cfg(any(feature = "can", feature = "ethercat"))]
mod objects;
mod output;
mod page;
mod quantity;
mod record;
#[cfg(feature = "fleet")]
mod ros2;
mod run;
mod scope;
mod screen;
mod signal;
mod stop;
mod token;
mod top;
mod verdict;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub(crate) use verdict::Verdict;

/// Counts allocations in real-time threads; everything else passes straight through.
#[global_allocator]
static ALLOCATOR: takt_rt::alloc::CountingAllocator = takt_rt::alloc::CountingAllocator;

/// Robot control core: run it, try it without hardware, inspect it.
///
/// Exit status: 0 good; 1 the check failed or the controller refused; 2 wrong usage or environment; 78 the cell of
/// `takt run` cannot be read or is invalid. Durations are written with a unit: 250us, 1ms, 5s.
#[derive(Debug, Parser)]
#[command(name = "takt", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the controller in the foreground.
    Run(run::Run),
    #[cfg(feature = "demo")]
    /// Move emulated robots with nets and report; needs no hardware and no root.
    Demo(demo::Demo),
    Doctor(doctor::Doctor),
    #[command(subcommand)]
    Arm(arm::Arm),
    #[cfg(feature = "can")]
    /// Inspect CAN buses, send to them, set up interfaces.
    #[command(subcommand)]
    Can(can::Can),
    #[cfg(feature = "ethercat")]
    #[command(subcommand)]
    Ecat(ecat::Ecat),
    /// Frames of a cell.
    #[command(subcommand)]
    Cell(cell::Cell),
    /// Emulate robots and devices at an interface.
    #[command(subcommand)]
    Emulate(emulate::Emulate),
    #[cfg(feature = "fleet")]
    #[command(subcommand)]
    Fleet(fleet::Fleet),
    #[cfg(feature = "fri")]
    #[command(subcommand)]
    Fri(fri::Fri),
    Grip(grip::Grip),
    /// Read and set inputs and outputs of devices.
    #[command(subcommand)]
    Io(io::Io),
    #[command(subcommand)]
    Irl(irl::Irl),
    /// Measure how late cycles begin on this host.
    Jitter(jitter::Jitter),
    /// Check, load, command and draw state machines over components.
    #[command(subcommand)]
    Machine(machine::Machine),
    Move(motion::Move),
    /// Check, load and control primitive nets.
    #[command(subcommand)]
    Net(net::Net),
    Page(page::Page),
    #[command(subcommand)]
    Record(record::Record),
    #[cfg(feature = "fleet")]
    Ros2(ros2::Ros2),
    Scope(scope::Scope),
    Stop(stop::Stop),
    Top(top::Top),
    /// Write manual pages and shell completions, for packages.
    #[command(hide = true)]
    Manual(manual::Manual),
}

fn main() -> ExitCode {
    let result = match Arguments::parse_from(motion::arguments(std::env::args_os())).command {
        Command::Run(run) => run.run(),
        #[cfg(feature = "demo")]
        Command::Demo(demo) => demo.run(),
        Command::Doctor(doctor) => doctor.run(),
        Command::Arm(arm) => arm.run(),
        #[cfg(feature = "can")]
        Command::Can(can) => can.run(),
        #[cfg(feature = "ethercat")]
        Command::Ecat(ecat) => ecat.run(),
        Command::Cell(cell) => cell.run(),
        Command::Emulate(emulate) => emulate.run(),
        #[cfg(feature = "fleet")]
        Command::Fleet(fleet) => fleet.run(),
        #[cfg(feature = "fri")]
        Command::Fri(fri) => fri.run(),
        Command::Grip(grip) => grip.run(),
        Command::Io(io) => io.run(),
        Command::Irl(irl) => irl.run(),
        Command::Jitter(jitter) => jitter.run(),
        Command::Machine(machine) => machine.run(),
        Command::Move(motion) => motion.run(),
        Command::Net(net) => net.run(),
        Command::Page(page) => page.run(),
        Command::Record(record) => record.run(),
        #[cfg(feature = "fleet")]
        Command::Ros2(ros2) => ros2.run(),
        Command::Scope(scope) => scope.run(),
        Command::Stop(stop) => stop.run(),
        Command::Top(top) => top.run(),
        Command::Manual(manual) => manual.run(),
    };
    match result {
        Ok(Verdict::Good) => ExitCode::SUCCESS,
        Ok(Verdict::Failed) => ExitCode::from(1),
        Err(error) if output::is_closed_output(&error) => ExitCode::SUCCESS,
        Err(error) => {
            output::complain(&format!("takt: {}", output::chain(&error)));
            ExitCode::from(status_of(&error))
        }
    }
}

/// Exit status of `takt run` with an invalid cell, `EX_CONFIG` of sysexits(3): the service is not restarted.
const WRONG_CELL: u8 = 78;

fn status_of(error: &anyhow::Error) -> u8 {
    match error {
        error if is_refusal(error) => 1,
        error if error.is::<run::WrongCell>() => WRONG_CELL,
        _ => 2,
    }
}

/// Whether a controller answered with a refusal.
fn is_refusal(error: &anyhow::Error) -> bool {
    let refusal = error.downcast_ref::<takt_client::Error>();
    let is_refused = matches!(refusal, Some(takt_client::Error::Refused { .. }));
    is_refused || error.is::<client::NoNet>() || error.is::<motion::Refused>()
}
