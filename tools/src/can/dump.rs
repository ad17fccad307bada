//! `takt can dump`: one decoded frame per line, live or from a recording. `stat` evaluates them.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use serde_json::json;
use takt_can::AnyFrame;
use takt_can::canopen::Message;

use super::dbc::{self, Database};
use super::feed::{Feed, Seen};
use super::filter::{Filter, is_shown};
use crate::Verdict;
use crate::output::{complain, positive_span, say};
use crate::signal::Stop;

/// Print frames, one per line, with their CANopen meaning, or the signals that a DBC file describes.
///
/// Filters: an identifier (181, 18FEF100), identifier and mask (180:780, 180~780 for all others), node=5,
/// nmt, sync, time, emcy, pdo, sdo, heartbeat, lss, error; a leading ! inverts a filter. Several filters are combined.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can dump can0
  takt can dump any --filter node=5 --filter '!sync' --time delta
  takt can dump can0 --log > fault.log             in the format of candump -L -x, for --from and canplayer
  takt can dump --from fault.blf --filter error
  takt can dump can0 --dbc car.dbc --filter 123")]
pub(crate) struct Dump {
    /// CAN interfaces, or any.
    #[arg(required_unless_present = "from", conflicts_with = "from")]
    interfaces: Vec<String>,
    /// Read a recording instead: candump log or text, ASC, BLF, TRC, pcap or pcapng.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Print only these frames.
    #[arg(long, value_name = "FILTER")]
    filter: Vec<Filter>,
    /// Decode signals by this DBC file; may be given several times.
    #[arg(long, value_name = "FILE", conflicts_with = "log")]
    dbc: Vec<PathBuf>,
    /// Reference of the time stamps.
    #[arg(long, value_name = "KIND", default_value = "zero")]
    time: Time,
    /// Write a candump log.
    #[arg(long)]
    log: bool,
    /// Write one JSON object per frame.
    #[arg(long, conflicts_with = "log")]
    json: bool,
    /// Stop after this many frames.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Stop after this time; default: at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span, conflicts_with = "from")]
    duration: Option<Duration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Time {
    /// The first frame.
    Zero,
    /// The previous frame.
    Delta,
    /// 1970.
    Absolute,
}

/// Longest wait before the next check for the end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

impl Dump {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let database = Database::open(&self.dbc)?;
        let mut feed = Feed::open(&self.interfaces, self.from.as_deref())?;
        let stop = Stop::listen()?;
        let until = self.duration.map(|duration| Instant::now() + duration);
        let mut printer = Printer {
            time: self.time,
            reference: None,
        };
        let mut left = self.count.unwrap_or(u64::MAX);
        let mut lost = 0;
        if !self.log && !self.json {
            say(HEADER)?;
        }
        while left > 0 && !stop.is_requested() && until.is_none_or(|until| Instant::now() < until) {
            let seen = feed.next(POLL_INTERVAL)?;
            complain_of_losses(feed.dropped(), &mut lost);
            let Some(seen) = seen else {
                if feed.is_live() {
                    continue;
                }
                break;
            };
            if is_shown(&self.filter, &seen.received.frame) {
                left -= 1;
                say(&self.line(&mut printer, &database, &seen))?;
            }
        }
        // A frame reports only the losses before it.
        complain_of_losses(feed.read_dropped(), &mut lost);
        Ok(Verdict::Good)
    }

    fn line(&self, printer: &mut Printer, database: &Database, seen: &Seen) -> String {
        if self.log {
            seen.record().to_string()
        } else if self.json {
            object(seen, database).to_string()
        } else {
            printer.line(seen, database)
        }
    }
}

/// Reports frames that were lost since the last report.
fn complain_of_losses(dropped: u64, reported: &mut u64) {
    let lost = dropped.saturating_sub(*reported);
    if lost > 0 {
        complain(&format!("{lost} frames lost before they were read"));
        *reported = dropped;
    }
}

const HEADER: &str = "     time s  iface           id   len  data";

/// Formats frames as text.
struct Printer {
    time: Time,
    /// Zero of the time stamps.
    reference: Option<Duration>,
}

impl Printer {
    fn line(&mut self, seen: &Seen, database: &Database) -> String {
        let at = seen.received.at;
        let reference = match self.time {
            Time::Absolute => Duration::ZERO,
            Time::Zero | Time::Delta => *self.reference.get_or_insert(at),
        };
        if self.time == Time::Delta {
            self.reference = Some(at);
        }
        // A recording may jump back.
        let (sign, time) = match at.checked_sub(reference) {
            Some(time) => ("", time),
            None => ("-", reference.saturating_sub(at)),
        };
        let time = format!("{sign}{}.{:06}", time.as_secs(), time.subsec_micros());
        let direction = seen
            .direction
            .map_or_else(String::new, |direction| direction.to_string());
        let interface = &seen.interface;
        let content = content(&seen.received.frame, database);
        let line = format!("{time:>11}  {interface:<8} {direction:1} {content}");
        line.trim_end().to_owned()
    }
}

/// Identifier, length, data and meaning.
fn content(frame: &AnyFrame, database: &Database) -> String {
    let id = frame
        .id()
        .map_or_else(|| "ERROR".to_owned(), |id| id.to_string());
    let mut data = String::new();
    for byte in frame.data() {
        let _ = write!(data, "{byte:02X} ");
    }
    let (len, meaning) = match frame {
        AnyFrame::Classic(classic) => {
            if classic.is_remote() {
                data = "remote".to_owned();
            }
            (
                usize::from(classic.dlc()),
                meaning(frame).unwrap_or_default(),
            )
        }
        AnyFrame::Fd(fd) => {
            let rate = if fd.bit_rate_switch { " BRS" } else { "" };
            let passive = if fd.sender_is_passive { " ESI" } else { "" };
            (fd.data().len(), format!("CAN FD{rate}{passive}"))
        }
        AnyFrame::Error(_) => (8, meaning(frame).unwrap_or_default()),
    };
    let signals = database.decode(frame);
    let meaning = signals.map_or(meaning, |signals| dbc::text(&signals));
    let data = data.trim_end();
    format!("{id:>8}  [{len:>2}]  {data:<23}  {meaning}")
}

fn meaning(frame: &AnyFrame) -> Option<String> {
    match frame {
        AnyFrame::Classic(frame) => {
            let message = Message::decode(frame);
            (message != Message::Unknown).then(|| message.to_string())
        }
        AnyFrame::Fd(_) => None,
        AnyFrame::Error(frame) => {
            let state = frame.state().map(|state| format!(" -> {state}"));
            Some(format!("{}{}", frame.causes(), state.unwrap_or_default()))
        }
    }
}

fn object(seen: &Seen, database: &Database) -> serde_json::Value {
    let frame = &seen.received.frame;
    let kind = match frame {
        AnyFrame::Classic(frame) if frame.is_remote() => "remote",
        AnyFrame::Classic(_) => "data",
        AnyFrame::Fd(_) => "fd",
        AnyFrame::Error(_) => "error",
    };
    let at = seen.received.at;
    json!({
        "version": 1,
        "at_us": u64::try_from(at.as_micros()).unwrap_or(u64::MAX),
        "interface": &*seen.interface,
        "kind": kind,
        "id": frame.id().map(|id| id.raw()),
        "extended": frame.id().is_some_and(|id| id.is_extended()),
        "frame": frame.to_string(),
        "direction": seen.direction.map(|direction| direction.to_string()),
        "meaning": meaning(frame),
        "dbc": database.decode(frame).map(|signals| dbc::json(&signals)),
    })
}
