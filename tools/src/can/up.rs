//! `takt can up`: configures an interface, brings it up, and prints its state or the cause of a failure. It creates no
//! interface.

use std::time::Duration;

use clap::Args;
use takt_can::linux::{Details, Interface, Setup};

use super::bitrate;
use crate::Verdict;
use crate::output::{say, span};

/// Configure a CAN interface, bring it up, and print its state.
///
/// Without options the interface is brought up with its present settings. Needs root or CAP_NET_ADMIN.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sudo takt can up can0 --bitrate 1M
  sudo takt can up can0 --bitrate 500k --sample-point 0.875 --restart 100ms --queue 1000
  sudo takt can up can1 --bitrate 1M --fd 5M
  takt can up can0 --show                         print only")]
pub(crate) struct Up {
    /// The CAN interface.
    interface: String,
    /// Bit rate: 500k, 1M, or bit/s.
    #[arg(long, value_name = "RATE", value_parser = bitrate)]
    bitrate: Option<u32>,
    /// Sample point, 0.5 to 0.95; default: the kernel's, as CiA recommends.
    #[arg(long, value_name = "SHARE", value_parser = sample_point, requires = "bitrate")]
    sample_point: Option<u32>,
    /// Enable CAN FD with this data bit rate.
    #[arg(long, value_name = "RATE", value_parser = bitrate)]
    fd: Option<u32>,
    /// Restart the controller this long after bus-off; 0ms: never.
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = span)]
    restart: Duration,
    /// Length of the send queue, frames.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    queue: u32,
    /// Do not report each bus error, only state changes.
    #[arg(long)]
    no_reports: bool,
    /// Only listen: neither send nor acknowledge.
    #[arg(long)]
    listen_only: bool,
    /// Change nothing.
    #[arg(long, conflicts_with_all = ["bitrate", "fd", "listen_only", "no_reports"])]
    show: bool,
}

/// In tenths of a percent.
fn sample_point(text: &str) -> Result<u32, String> {
    let point: f64 = text
        .parse()
        .map_err(|_| format!("`{text}` is not a number"))?;
    if !(0.5..=0.95).contains(&point) {
        return Err("must be 0.5 to 0.95".to_owned());
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "500 to 950"
    )]
    Ok((point * 1e3).round() as u32)
}

impl Up {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let interface = Interface::open(&self.interface)?;
        let details = interface.details()?;
        if !self.show {
            for step in interface.set_up(&self.setup(&details))? {
                say(&format!("{}: {step}", self.interface))?;
            }
        }
        let details = interface.details()?;
        say(&format!("{}: {}", self.interface, description(&details)))?;
        Ok(if details.up {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    /// Of a virtual interface only the queue can be set.
    fn setup(&self, details: &Details) -> Setup {
        let queue = Some(self.queue);
        if details.is_virtual() && self.bitrate.is_none() && self.fd.is_none() {
            return Setup {
                queue,
                ..Setup::default()
            };
        }
        Setup {
            bitrate: self.bitrate,
            sample_point: self.sample_point,
            data_bitrate: self.fd,
            restart: Some(self.restart),
            queue,
            report_errors: Some(!self.no_reports),
            listen_only: Some(self.listen_only),
        }
    }
}

fn description(details: &Details) -> String {
    let mut words = vec![if details.up { "up" } else { "down" }.to_owned()];
    if details.is_virtual() {
        words.push("virtual".to_owned());
    }
    if let Some(state) = details.state {
        words.push(state.to_string());
    }
    if let Some(rate) = details.bitrate {
        let point = details.sample_point.unwrap_or(0);
        words.push(format!(
            "{} kbit/s, sample point {}.{} %",
            rate / 1000,
            point / 10,
            point % 10
        ));
    }
    if let Some(rate) = details.data_bitrate.filter(|_| details.fd) {
        words.push(format!("CAN FD data {} kbit/s", rate / 1000));
    }
    if let Some((transmit, receive)) = details.counters {
        words.push(format!("errors {transmit} sending, {receive} receiving"));
    }
    if let Some(restart) = details.restart {
        words.push(match restart.is_zero() {
            true => "no automatic restart".to_owned(),
            false => format!("restart after {} ms", restart.as_millis()),
        });
    }
    if details.listen_only {
        words.push("listens only".to_owned());
    }
    if let Some(queue) = details.queue {
        words.push(format!("queue of {queue}"));
    }
    words.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::BusState;

    #[test]
    fn interface_state_is_one_line() {
        let details = Details {
            up: true,
            bitrate: Some(1_000_000),
            sample_point: Some(750),
            state: Some(BusState::ErrorActive),
            counters: Some((0, 3)),
            restart: Some(Duration::from_millis(100)),
            queue: Some(10),
            ..Details::default()
        };
        assert_eq!(
            description(&details),
            "up, error-active, 1000 kbit/s, sample point 75.0 %, errors 0 sending, 3 receiving, restart after \
             100 ms, queue of 10"
        );
        assert_eq!(description(&Details::default()), "down, virtual");
    }

    #[test]
    fn sample_point_is_parsed_and_checked() {
        assert_eq!(sample_point("0.875"), Ok(875));
        for wrong in ["87.5", "0.4", "x", "NaN"] {
            assert!(sample_point(wrong).is_err(), "{wrong}");
        }
    }
}
