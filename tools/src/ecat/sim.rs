//! `takt ecat sim`: an emulated segment at an interface, for any master at the other end of its cable, and faults
//! injected by lines of text. The slaves are those of the emulator in `takt-ethercat`.

mod fault;
mod plan;

use std::io::BufRead as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use clap::Args;
use takt_ethercat::emulator::{SharedSegment, YouBot, YouBotConfig};
use takt_ethercat::linux::monotonic;

use crate::Verdict;
use crate::emulate::segment;
use crate::output::{complain, positive_span, say};
use fault::Fault;
use plan::{Emulation, Handles, Plan};

/// Emulate a segment at an interface: slaves for any EtherCAT master, and faults on command.
///
/// Lines on standard input inject faults; `help` lists them. Exit status: 0 ended on request; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ip link add near type veth peer name far && ip link set near up && ip link set far up
  takt ecat sim near --devices tx90
  takt ecat sim near --devices ek1100,el1004,el2004,el2889,el3004,akd --slower 2
  takt ecat sim tap:ecat0 --devices line.toml --strict
  takt ecat sim near --config /etc/takt/cell.toml --segment cell1
  takt ecat sim near --second near2 --devices tx90    a ring for `takt ecat scan far --second far2`
  echo 'cut 2' | takt ecat sim near --devices youbot --duration 1min
  echo 'axis 1 no-index' | takt ecat sim near --devices station --duration 1min

A file has one [[slave]] for each slave: kind = coupler, digital, analogue, drive, tx90 or a device; outputs, inputs,
looped (terminals); axes (drive); behind = [slave, port]; alias, vendor, product, name, drift_ppm; files (FoE and BOOT); ethernet (EoE).

Devices reproduce recorded real ones, with their registers, EEPROMs and times: ek1100, el1004,
el2004, el2828, el2889, el3004, ek1914, lan9252, akd.")]
pub(crate) struct Sim {
    /// The network interface; the master is at the other end of its cable. Or `tap:NAME`: creates an interface of that
    /// name for the master.
    #[arg(value_name = "IFACE")]
    interface: String,
    /// The interface behind the last slave, for a ring of two ends; also `tap:NAME`.
    #[arg(long, value_name = "IFACE")]
    second: Option<String>,
    /// The segment: tx90, youbot, station (three servomotors at terminals), devices in their order, or a file.
    #[arg(
        long,
        value_name = "FILE|tx90|youbot|station|DEVICE,...",
        required_unless_present = "config"
    )]
    devices: Option<String>,
    /// Emulate the slaves that a segment of this cell expects, with the channels that the cell uses.
    #[arg(long, value_name = "FILE", conflicts_with = "devices")]
    config: Option<PathBuf>,
    /// Which segment of the cell; needed if it has several.
    #[arg(long, value_name = "NAME", requires = "config")]
    segment: Option<String>,
    /// Factor on the times that devices take for states, mailboxes and EEPROMs, 1 to 100.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u64).range(1..=100))]
    slower: u64,
    /// Axes fault after three cycles without a set-point, as real axes do; for masters on real-time hosts.
    #[arg(long)]
    strict: bool,
    /// Stop after this time; default: at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

impl Sim {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Emulation {
            segment,
            handles,
            loops,
        } = self.emulation()?;
        let shared = SharedSegment::new(segment);
        let commands = lines();
        let between_cycles = move || {
            for io in &loops {
                io.set_inputs(&io.outputs());
            }
        };
        segment::serve(
            &shared,
            segment::Ends {
                first: &self.interface,
                second: self.second.as_deref(),
            },
            self.duration,
            between_cycles,
            || {
                while let Ok(line) = commands.try_recv() {
                    execute(&line, &shared, &handles)?;
                }
                Ok(())
            },
        )
    }

    fn emulation(&self) -> anyhow::Result<Emulation> {
        if let Some(path) = &self.config {
            let cell = takt_devices::read_cell(path)?;
            return plan::of_cell(&cell, self.segment.as_deref(), self.strict);
        }
        match self.devices.as_deref().unwrap_or_default() {
            "tx90" => Ok(Emulation::plain(segment::tx90(self.strict)?)),
            "station" => Ok(Emulation::station()),
            "youbot" => {
                let (segment, _) = YouBot::segment(&YouBotConfig::default());
                Ok(Emulation::plain(segment))
            }
            path => {
                if let Some(devices) = Plan::of_devices(path) {
                    return devices.build(self.strict, self.slower);
                }
                let text =
                    takt_core::files::read_text(Path::new(path), takt_core::files::TEXT_BYTES_MAX)
                        .map_err(|error| {
                            anyhow!(
                                "cannot read {path}: {error}\nhint: segments without a file: tx90, youbot, station, devices by name"
                            )
                        })?;
                let plan: Plan = toml::from_str(&text).with_context(|| path.to_owned())?;
                plan.build(self.strict, self.slower)
                    .with_context(|| format!("{path} describes no valid segment"))
            }
        }
    }
}

/// Lines of standard input, read by a thread that ends with the process.
fn lines() -> Receiver<String> {
    let (to, from) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if to.send(line).is_err() {
                break;
            }
        }
    });
    from
}

fn execute(line: &str, segment: &SharedSegment, handles: &Handles) -> anyhow::Result<()> {
    let line = line.trim();
    let now = u64::try_from(monotonic()?.as_nanos()).unwrap_or(u64::MAX);
    let inject = |fault: Fault| fault.inject(segment, handles, now);
    match line {
        "" => Ok(()),
        "help" => say(fault::HELP),
        _ => match line.parse().and_then(inject) {
            Ok(text) => say(&text),
            Err(error) => {
                complain(&format!("{error}\nhint: `help` lists the commands"));
                Ok(())
            }
        },
    }
}
