//! `takt net tap`: the values at debug taps of a net, one line for each cycle. A tap is part of the net's text; nothing
//! is added to a net that is loaded.

use std::time::{Duration, Instant};

use clap::Args;
use serde_json::{Map, Value};

use super::Server;
use crate::Verdict;
use crate::client::{TapRecord, TapRecords};
use crate::output::{complain, json_of, positive_span, say};
use crate::signal::Stop;

/// Print the values of debug taps, each cycle.
///
/// A tap is a time in s behind the name of a port in the text of the net, which says how long its values are kept:
/// `target=Core::DoubleAdd(inFirst[2]=start.outValue, …)` is `target.inFirst`. `takt net load --tap target.inFirst` adds
/// it. Without ports all taps are printed. It ends with the net, or at Ctrl-C.
#[derive(Debug, Args)]
pub(crate) struct Tap {
    /// The net, such as rpinet0.
    net: String,
    /// Tapped ports: the names of fragments, of the primitive and of the port, joined by dots.
    #[arg(value_name = "PRIMITIVE.PORT")]
    ports: Vec<String>,
    /// End after this time even if the net runs on.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// Print one JSON object per cycle.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// Time between two requests for records, which a controller keeps for seconds.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

impl Tap {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        let stop = Stop::listen()?;
        let until = self.duration.map(|duration| Instant::now() + duration);
        let first = client.taps(&self.net, 0.0)?;
        let columns = match self.columns(&first) {
            Ok(columns) => columns,
            Err(text) => {
                complain(&text);
                return Ok(Verdict::Failed);
            }
        };
        if !self.json {
            let names: Vec<_> = columns
                .iter()
                .map(|column| &*first.names[*column])
                .collect();
            say(&format!("time\t{}", names.join("\t")))?;
        }
        let (mut taps, mut expected) = (first, 0.0);
        loop {
            for record in &taps.records {
                report_loss(record.number - expected);
                expected = record.number + 1.0;
                say(&self.line(record, &columns, &taps.names))?;
            }
            let is_over = until.is_some_and(|until| Instant::now() >= until);
            if is_over || stop.is_requested() {
                return Ok(Verdict::Good);
            }
            if taps.records.is_empty() {
                std::thread::sleep(POLL_INTERVAL);
            }
            // The state is read first, so that the records of the last cycles are not missed.
            let has_ended = client.has_ended(&self.net)?;
            taps = client.taps(&self.net, taps.next)?;
            if has_ended && taps.records.is_empty() {
                return Ok(Verdict::Good);
            }
        }
    }

    /// The taps to print, by their numbers.
    fn columns(&self, taps: &TapRecords) -> Result<Vec<usize>, String> {
        if taps.names.is_empty() {
            return Err(format!(
                "{} has no taps\nhint: `takt net load --tap PRIMITIVE.PORT`, or `inValue[2]=…` in its text",
                self.net
            ));
        }
        if self.ports.is_empty() {
            return Ok((0..taps.names.len()).collect());
        }
        let column = |port: &String| {
            taps.names
                .iter()
                .position(|name| name == port)
                .ok_or_else(|| {
                    format!(
                        "{} has no tap {port}; it has {}",
                        self.net,
                        taps.names.join(", ")
                    )
                })
        };
        self.ports.iter().map(column).collect()
    }

    fn line(&self, record: &TapRecord, columns: &[usize], names: &[String]) -> String {
        let value = |column: &usize| record.values.get(*column).cloned().flatten();
        let time = seconds(record.time_ns);
        if !self.json {
            let values = columns
                .iter()
                .map(|column| value(column).unwrap_or_default());
            return [time]
                .into_iter()
                .chain(values)
                .collect::<Vec<_>>()
                .join("\t");
        }
        let values = columns.iter().map(|column| {
            let value = value(column).map_or(Value::Null, |text| json_of(&text));
            (names[*column].clone(), value)
        });
        let time = [("time_ns".to_owned(), record.time_ns.into())];
        Value::Object(time.into_iter().chain(values).collect::<Map<_, _>>()).to_string()
    }
}

/// Records that are missing: the controller had no free buffer for them, or dropped them before they were read.
fn report_loss(count: f64) {
    if count > 0.0 {
        complain(&format!("{count:.0} cycles are missing"));
    }
}

/// A logical time in s.
fn seconds(time_ns: i64) -> String {
    let (whole, part) = (
        time_ns.div_euclid(1_000_000_000),
        time_ns.rem_euclid(1_000_000_000),
    );
    format!("{whole}.{part:09}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tap(ports: &[&str], json: bool) -> Tap {
        Tap {
            net: "rpinet0".to_owned(),
            ports: ports.iter().map(|port| (*port).to_owned()).collect(),
            duration: None,
            json,
            server: Server {
                connect: None,
                token_file: None,
            },
        }
    }

    fn taps() -> TapRecords {
        let values = [Some("0.5"), None, Some("[1,2]")];
        TapRecords {
            next: 1.0,
            names: ["a.inX", "b.inY", "c.inZ"].map(str::to_owned).to_vec(),
            records: vec![TapRecord {
                number: 0.0,
                time_ns: 1_002_000_000,
                values: values.map(|value| value.map(str::to_owned)).to_vec(),
            }],
        }
    }

    #[test]
    fn taps_are_columns_in_requested_order() {
        let taps = taps();
        for (ports, json, line) in [
            (&[][..], false, "1.002000000\t0.5\t\t[1,2]"),
            (&["c.inZ", "a.inX"], false, "1.002000000\t[1,2]\t0.5"),
            (
                &[],
                true,
                r#"{"a.inX":0.5,"b.inY":null,"c.inZ":[1,2],"time_ns":1002000000}"#,
            ),
        ] {
            let tap = tap(ports, json);
            let columns = tap.columns(&taps).unwrap();
            assert_eq!(tap.line(&taps.records[0], &columns, &taps.names), line);
        }
    }

    #[test]
    fn missing_tap_names_those_that_exist() {
        let wrong = tap(&["a.inY"], false).columns(&taps()).unwrap_err();
        assert_eq!(
            wrong,
            "rpinet0 has no tap a.inY; it has a.inX, b.inY, c.inZ"
        );
        let empty = TapRecords {
            names: Vec::new(),
            ..taps()
        };
        let none = tap(&[], false).columns(&empty).unwrap_err();
        assert!(none.starts_with("rpinet0 has no taps\nhint: "), "{none}");
    }
}
