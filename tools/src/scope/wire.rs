//! Messages of the controller's scope: requests and reports in JSON, samples in binary frames. Nothing is sent here.

use serde::{Deserialize, Serialize};

use super::trigger::Trigger;

/// The version of the messages that is understood here.
const VERSION: u64 = 1;

/// What is requested.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Request {
    pub(crate) probes: Vec<String>,
    pub(crate) every: u64,
    pub(crate) trigger: Option<Trigger>,
    pub(crate) pre_s: f64,
    pub(crate) post_s: f64,
    pub(crate) mode: Mode,
    pub(crate) rate_hz: f64,
}

/// What follows a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mode {
    /// The next one, also without a trigger if none comes for a while
    Auto,
    /// The next one, at the next trigger
    Normal,
    /// Nothing
    Single,
}

/// What the controller reports.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Event {
    /// What it samples.
    Setup(Setup),
    /// A trigger was found; its frames follow.
    Triggered(Triggered),
    /// A probe has no more values.
    Ended(Ended),
    /// Samples were lost because this client was slow.
    Lost {
        group: usize,
        samples: u64,
    },
    /// Nothing follows: a single capture is complete.
    Done,
    /// It refuses the request.
    Refused(String),
    Frame(Frame),
    /// The connection was lost.
    Closed(String),
}

/// What is sampled.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Setup {
    pub(crate) version: u64,
    pub(crate) groups: Vec<Group>,
    pub(crate) rejected: Vec<Rejected>,
}

/// Probes that are sampled in the same cycles.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Group {
    pub(crate) thread: String,
    pub(crate) period_s: f64,
    pub(crate) probes: Vec<Probe>,
}

/// A column.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Probe {
    pub(crate) name: String,
    pub(crate) unit: String,
    /// For states: their names, by number.
    pub(crate) states: Vec<String>,
}

/// A probe that cannot be sampled.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Rejected {
    pub(crate) probe: String,
    pub(crate) cause: String,
    pub(crate) hint: String,
}

/// A trigger that was found.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Triggered {
    pub(crate) time_s: f64,
    pub(crate) cause: String,
}

/// A probe without further values.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Ended {
    pub(crate) probe: String,
    pub(crate) cause: String,
}

/// Samples of a group.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Frame {
    pub(crate) group: usize,
    pub(crate) columns: usize,
    /// Samples lost before the first one.
    pub(crate) lost: u64,
    /// Time, s since the controller's start, and the columns, row after row; null is not a number.
    pub(crate) values: Vec<f64>,
}

/// A message that is not understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum WireError {
    #[error("the controller sent a message that is not understood: {0}")]
    Text(String),
    #[error("the controller sent a frame of {length} bytes with {rows} rows of {columns} columns")]
    Length {
        length: usize,
        rows: u32,
        columns: u32,
    },
    #[error(
        "the controller speaks version {0} of the scope, this program {VERSION}\nhint: use the `takt` of the controller's version"
    )]
    Version(u64),
}

/// Reads a text message; `None` if it is of a kind that is not known here.
pub(crate) fn decode_text(text: &str) -> Result<Option<Event>, WireError> {
    #[derive(Deserialize)]
    struct Lost {
        group: usize,
        samples: u64,
    }
    #[derive(Default, Deserialize)]
    #[serde(default)]
    struct Message {
        scope: Option<Setup>,
        triggered: Option<Triggered>,
        ended: Option<Ended>,
        lost: Option<Lost>,
        done: Option<serde_json::Value>,
        error: Option<serde_json::Value>,
    }
    let wrong = |why: serde_json::Error| WireError::Text(why.to_string());
    let message: Message = serde_json::from_str(text).map_err(wrong)?;
    if let Some(setup) = message.scope {
        return match setup.version {
            VERSION => Ok(Some(Event::Setup(setup))),
            other => Err(WireError::Version(other)),
        };
    }
    let triggered = message.triggered.map(Event::Triggered);
    let ended = || message.ended.map(Event::Ended);
    let lost = || {
        message.lost.map(|lost| Event::Lost {
            group: lost.group,
            samples: lost.samples,
        })
    };
    let done = || message.done.map(|_| Event::Done);
    let refused = || message.error.map(|error| Event::Refused(refusal(&error)));
    Ok(triggered
        .or_else(ended)
        .or_else(lost)
        .or_else(done)
        .or_else(refused))
}

/// Cause and hint of a refusal.
fn refusal(error: &serde_json::Value) -> String {
    let text = |key: &str| error[key].as_str().filter(|text| !text.is_empty());
    match (error.as_str().or_else(|| text("cause")), text("hint")) {
        (Some(cause), Some(hint)) => format!("{cause}\nhint: {hint}"),
        (Some(cause), None) => cause.to_owned(),
        (None, _) => error.to_string(),
    }
}

/// Bytes of a frame before its rows: group, rows, columns, lost; each u32, little-endian.
const HEAD: usize = 16;

/// Reads a binary message.
pub(crate) fn decode_frame(bytes: &[u8]) -> Result<Frame, WireError> {
    let short = || WireError::Length {
        length: bytes.len(),
        rows: 0,
        columns: 0,
    };
    let (head, body) = bytes.split_first_chunk::<HEAD>().ok_or_else(short)?;
    let mut numbers = head.as_chunks().0.iter().map(|it| u32::from_le_bytes(*it));
    let mut number = || numbers.next().unwrap_or(0);
    let (group, rows, columns, lost) = (number(), number(), number(), number());
    let (values, rest) = body.as_chunks();
    let whole = u64::from(rows) * (u64::from(columns) + 1);
    if !rest.is_empty() || values.len() as u64 != whole {
        return Err(WireError::Length {
            length: bytes.len(),
            rows,
            columns,
        });
    }
    Ok(Frame {
        group: usize::try_from(group).unwrap_or(usize::MAX),
        columns: usize::try_from(columns).unwrap_or(usize::MAX),
        lost: u64::from(lost),
        values: values.iter().map(|it| f64::from_le_bytes(*it)).collect(),
    })
}

impl Frame {
    /// Its rows: the time, s, and the columns.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (f64, &[f64])> {
        let rows = self.values.chunks_exact(self.columns.saturating_add(1));
        rows.filter_map(|row| row.split_first().map(|(time, values)| (*time, values)))
    }

    #[cfg(test)]
    pub(crate) fn of(group: usize, columns: usize, values: &[f64]) -> Self {
        Self {
            group,
            columns,
            lost: 0,
            values: values.to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(head: [u32; 4], values: &[f64]) -> Vec<u8> {
        let head = head.iter().flat_map(|it| it.to_le_bytes());
        let values = values.iter().flat_map(|it| it.to_le_bytes());
        head.chain(values).collect()
    }

    #[test]
    fn scope_frame_is_read_row_by_row() {
        let frame = decode_frame(&bytes([1, 2, 1, 7], &[0.5, 1.0, 0.501, f64::NAN])).unwrap();
        assert_eq!((frame.group, frame.columns, frame.lost), (1, 1, 7));
        let rows: Vec<_> = frame.rows().collect();
        assert_eq!(rows[0], (0.5, &[1.0][..]));
        assert!(rows[1].1[0].is_nan());
    }

    #[test]
    fn scope_frame_of_other_length_is_an_error() {
        let whole = bytes([0, 2, 1, 0], &[0.5, 1.0, 0.501, 2.0]);
        for length in 0..whole.len() {
            assert!(decode_frame(&whole[..length]).is_err(), "{length}");
        }
        let huge = bytes([0, u32::MAX, u32::MAX, 0], &[]);
        let why = decode_frame(&huge).unwrap_err().to_string();
        assert!(
            why.contains("a frame of 16 bytes with 4294967295 rows"),
            "{why}"
        );
    }

    #[test]
    fn scope_texts_are_read_or_refused() {
        let setup = r#"{"scope":{"version":1,"groups":[{"thread":"nets","period_s":0.001,"probes":[{"name":"a.b","unit":"rad"}]}],
            "rejected":[{"probe":"c","cause":"there is none","hint":"look"}]}}"#;
        let Ok(Some(Event::Setup(setup))) = decode_text(setup) else {
            panic!("{setup}");
        };
        assert_eq!(setup.groups[0].probes[0].unit, "rad");
        assert_eq!(setup.rejected[0].hint, "look");
        let lost = decode_text(r#"{"lost":{"group":0,"samples":9}}"#).unwrap();
        assert_eq!(
            lost,
            Some(Event::Lost {
                group: 0,
                samples: 9
            })
        );
        let refused = decode_text(r#"{"error":{"cause":"too many","hint":"fewer"}}"#).unwrap();
        assert_eq!(
            refused,
            Some(Event::Refused("too many\nhint: fewer".to_owned()))
        );
        let refused = decode_text(r#"{"error":"no"}"#).unwrap();
        assert_eq!(refused, Some(Event::Refused("no".to_owned())));
        let done = decode_text(r#"{"done":{"cause":"mode single has its capture"}}"#);
        assert_eq!(done, Ok(Some(Event::Done)));
        // Later kinds of messages are no errors.
        assert_eq!(decode_text(r#"{"note":1}"#), Ok(None));
        assert_eq!(
            decode_text(r#"{"scope":{"version":2}}"#),
            Err(WireError::Version(2))
        );
        assert!(decode_text("{").is_err());
    }
}
