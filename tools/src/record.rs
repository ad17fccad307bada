//! `takt record`: what recordings contain, and whole files from those that were cut off.

use std::path::PathBuf;

use clap::Subcommand;
use serde_json::json;
use takt_core::record::{Contents, contents, recover};

use crate::Verdict;
use crate::output::say;

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
        }
    }
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
