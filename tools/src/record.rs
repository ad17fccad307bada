//! `takt record`: what recordings contain, whole files from those that were cut off, and flight files on request.

mod csv;
mod plot;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Subcommand;
use serde_json::json;
use takt_core::record::{Contents, contents, recover};

use crate::Verdict;
use crate::http::Site;
use crate::output::say;

/// How long the controller may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a flight file may take: the second that follows, and a slow disk.
const COMPLETE_TIMEOUT: Duration = Duration::from_secs(60);

/// Inspect and repair recordings (`takt run --record`, `takt demo --record`).
#[derive(Debug, Subcommand)]
pub(crate) enum Record {
    /// Print the topics of a recording and how long it is. Exit status 1 if it is cut off.
    Info {
        /// The recording; any MCAP file.
        file: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Copy all whole messages of a recording that a crash or a full disk cut off to a new file with an index, which all viewers open.
    Recover {
        /// The recording.
        file: PathBuf,
        /// The new file, which must not exist.
        #[arg(long, short, value_name = "FILE")]
        output: PathBuf,
    },
    /// Write the numbers of a recording as CSV: a row for each instant, a column for each value, named as probes are. Empty
    /// fields are values that were not known, or did not change then.
    Csv {
        /// The recording or flight file; any MCAP file with messages of ROS 2.
        file: PathBuf,
        /// Write these values only; * stands for any characters, such as `left.joint.*.measured`.
        #[arg(long, value_name = "NAME")]
        probe: Vec<String>,
        /// The new file; else standard output.
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Draw values of a recording over time: a plot for each unit, as SVG.
    Plot {
        /// The recording or flight file; any MCAP file with messages of ROS 2.
        file: PathBuf,
        /// The values; * stands for any characters, such as `left.joint.*.following_error`.
        #[arg(long, value_name = "NAME", required = true)]
        probe: Vec<String>,
        /// The picture.
        #[arg(long, value_name = "FILE")]
        svg: PathBuf,
    },
    /// Write the last ten seconds of all devices of a running controller, and the second that follows, to a flight file on its
    /// host. Prints the path; the file is complete when the command ends.
    Flight {
        #[command(flatten)]
        site: Site,
        /// List the flight files instead, oldest first.
        #[arg(long)]
        list: bool,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

impl Record {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Info { file, json } => {
                let found = contents(&file)?;
                if json {
                    say(&as_json(&found).to_string())?;
                } else {
                    print(&found)?;
                }
                if !found.is_cut {
                    return Ok(Verdict::Good);
                }
                if !json {
                    say(&format!(
                        "the file is cut off: a crash or a full disk\nhint: takt record recover {} --output FILE",
                        file.display()
                    ))?;
                }
                Ok(Verdict::Failed)
            }
            Self::Recover { file, output } => {
                let copied = recover(&file, &output)?;
                say(&format!("{}: {copied} messages", output.display()))?;
                Ok(Verdict::Good)
            }
            Self::Csv {
                file,
                probe,
                output,
            } => csv::run(&file, &probe, output.as_deref()),
            Self::Plot { file, probe, svg } => plot::run(&file, &probe, &svg),
            Self::Flight { site, list, json } => flight(&site, list, json),
        }
    }
}

/// Requests a flight file and waits until it is complete, or lists those that there are.
fn flight(site: &Site, list: bool, json: bool) -> anyhow::Result<Verdict> {
    let http = site.client(ANSWER_TIMEOUT)?;
    if list {
        let files = http.get("/flights/")?;
        if json {
            say(&files.to_string())?;
            return Ok(Verdict::Good);
        }
        for file in files["flight"].as_array().into_iter().flatten() {
            let kib = file["bytes"].as_u64().unwrap_or(0).div_ceil(1024);
            let path = file["path"].as_str().unwrap_or_default();
            let state = match file["complete"].as_bool() {
                Some(false) => "  (is being written)",
                _ => "",
            };
            say(&format!("{kib:>7} KiB  {path}{state}"))?;
        }
        return Ok(Verdict::Good);
    }
    let written = http.post("/flights/")?;
    let path = written["path"].as_str().unwrap_or_default();
    let is_complete = || -> anyhow::Result<bool> {
        let files = http.get("/flights/")?;
        let mut files = files["flight"].as_array().into_iter().flatten();
        Ok(files.any(|file| file["path"] == path && file["complete"] == true))
    };
    let until = Instant::now() + COMPLETE_TIMEOUT;
    while !is_complete()? {
        anyhow::ensure!(
            Instant::now() < until,
            "{path} is not complete after {COMPLETE_TIMEOUT:?}\nhint: see the log of the controller: its disk may be full"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    say(&if json {
        written.to_string()
    } else {
        path.to_owned()
    })?;
    Ok(Verdict::Good)
}

fn print(found: &Contents) -> anyhow::Result<()> {
    let seconds = found.duration().as_secs_f64();
    say(&format!("{seconds:.3} s, {} messages", found.messages()))?;
    let width = found.topics.keys().map(String::len).max().unwrap_or(0);
    for (name, topic) in &found.topics {
        let (messages, kib) = (topic.messages, topic.bytes.div_ceil(1024));
        say(&format!(
            "{name:width$}  {messages:>9}  {kib:>7} KiB  {}",
            topic.schema
        ))?;
    }
    Ok(())
}

fn as_json(found: &Contents) -> serde_json::Value {
    let topics = found.topics.iter().map(|(name, topic)| {
        json!({
            "name": name,
            "type": topic.schema,
            "messages": topic.messages,
            "bytes": topic.bytes,
        })
    });
    json!({
        "begin_ns": found.begin,
        "end_ns": found.end,
        "messages": found.messages(),
        "is_cut": found.is_cut,
        "topics": topics.collect::<Vec<_>>(),
    })
}
