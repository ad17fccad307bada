//! Frame filters in the notation of candump and by CANopen message kind. They check identifiers and kinds, not the
//! content.

use std::str::FromStr;

use takt_can::canopen::Message;
use takt_can::{AnyFrame, Id};

/// One condition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Filter {
    /// Matches all frames that the condition does not match.
    inverted: bool,
    condition: Condition,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Condition {
    /// Identifiers of this length that are equal in the bits of the mask.
    Masked { id: Id, mask: u32 },
    /// All messages of a node.
    Node(u8),
    /// A kind of CANopen message.
    Kind(Kind),
    /// Error frames.
    Error,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Nmt,
    Sync,
    Time,
    Emergency,
    Pdo,
    Sdo,
    Heartbeat,
    Lss,
}

const KINDS: [(&str, Kind); 8] = [
    ("nmt", Kind::Nmt),
    ("sync", Kind::Sync),
    ("time", Kind::Time),
    ("emcy", Kind::Emergency),
    ("pdo", Kind::Pdo),
    ("sdo", Kind::Sdo),
    ("heartbeat", Kind::Heartbeat),
    ("lss", Kind::Lss),
];

impl FromStr for Filter {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (inverted, condition_text) = match text.strip_prefix('!') {
            Some(rest) => (true, rest),
            None => (false, text),
        };
        if let Some((id, mask)) = condition_text.split_once('~') {
            let condition = masked(id, Some(mask)).ok_or_else(|| unknown(text))?;
            return Ok(Self {
                inverted: !inverted,
                condition,
            });
        }
        let kind = KINDS.iter().find(|(name, _)| *name == condition_text);
        let condition = match (
            kind,
            condition_text.strip_prefix("node="),
            condition_text.split_once(':'),
        ) {
            (Some((_, kind)), ..) => Some(Condition::Kind(*kind)),
            (None, Some(node), _) => node
                .parse()
                .ok()
                .filter(|node| (1..=127).contains(node))
                .map(Condition::Node),
            (None, None, Some((id, mask))) => masked(id, Some(mask)),
            (None, None, None) if condition_text == "error" => Some(Condition::Error),
            (None, None, None) => masked(condition_text, None),
        };
        let condition = condition.ok_or_else(|| unknown(text))?;
        Ok(Self {
            inverted,
            condition,
        })
    }
}

fn unknown(text: &str) -> String {
    let kinds: Vec<&str> = KINDS.iter().map(|(name, _)| *name).collect();
    format!(
        "`{text}` is not a filter\nhint: write an identifier (181, 18FEF100), identifier and mask (180:780, 180~780 for \
         all others), node=5, {}, or error; a leading ! inverts it",
        kinds.join(", ")
    )
}

fn masked(id: &str, mask: Option<&str>) -> Option<Condition> {
    let raw = u32::from_str_radix(id, 16).ok()?;
    let id = match id.len() {
        1..=3 => Id::standard(raw.try_into().ok()?).ok()?,
        8 => Id::extended(raw).ok()?,
        _ => return None,
    };
    let mask = match mask {
        Some(mask) => u32::from_str_radix(mask, 16).ok()?,
        None => u32::MAX,
    };
    Some(Condition::Masked { id, mask })
}

impl Filter {
    fn matches(&self, frame: &AnyFrame) -> bool {
        self.condition.matches(frame) != self.inverted
    }
}

impl Condition {
    fn matches(&self, frame: &AnyFrame) -> bool {
        match self {
            Self::Masked { id: wanted, mask } => frame.id().is_some_and(|id| {
                id.is_extended() == wanted.is_extended() && (id.raw() ^ wanted.raw()) & mask == 0
            }),
            Self::Node(node) => frame
                .classic()
                .is_some_and(|frame| of_node(&Message::decode(frame)) == Some(*node)),
            Self::Kind(kind) => frame
                .classic()
                .is_some_and(|frame| kind_of(&Message::decode(frame)) == Some(*kind)),
            Self::Error => matches!(frame, AnyFrame::Error(_)),
        }
    }
}

fn of_node(message: &Message) -> Option<u8> {
    match message {
        Message::Nmt(_, Some(node))
        | Message::Emergency(node, _)
        | Message::Tpdo(node, _)
        | Message::Rpdo(node, _)
        | Message::SdoResponse(node, _)
        | Message::SdoRequest(node, _)
        | Message::Heartbeat(node, ..)
        | Message::Guard(node) => Some(node.raw()),
        Message::Nmt(_, None)
        | Message::Sync(_)
        | Message::Time(..)
        | Message::Lss(..)
        | Message::Unknown => None,
    }
}

fn kind_of(message: &Message) -> Option<Kind> {
    Some(match message {
        Message::Nmt(..) => Kind::Nmt,
        Message::Sync(_) => Kind::Sync,
        Message::Time(..) => Kind::Time,
        Message::Emergency(..) => Kind::Emergency,
        Message::Tpdo(..) | Message::Rpdo(..) => Kind::Pdo,
        Message::SdoResponse(..) | Message::SdoRequest(..) => Kind::Sdo,
        Message::Heartbeat(..) | Message::Guard(_) => Kind::Heartbeat,
        Message::Lss(..) => Kind::Lss,
        Message::Unknown => return None,
    })
}

/// Whether a frame is shown: at least one of the filters that are not inverted matches it, if there are any, and all
/// inverted filters do.
pub(super) fn is_shown(filters: &[Filter], frame: &AnyFrame) -> bool {
    let (unwanted, wanted): (Vec<&Filter>, Vec<&Filter>) =
        filters.iter().partition(|filter| filter.inverted);
    unwanted.iter().all(|filter| filter.matches(frame))
        && (wanted.is_empty() || wanted.iter().any(|filter| filter.matches(frame)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::log::parse_frame;

    fn shows(filters: &[&str], frame: &str) -> bool {
        let filters: Vec<Filter> = filters.iter().map(|text| text.parse().unwrap()).collect();
        is_shown(&filters, &parse_frame(frame).unwrap())
    }

    #[test]
    fn filter_of_each_kind_matches_its_frames() {
        for (filter, yes, no) in [
            ("181", "181#", "182#"),
            ("181", "181#", "00000181#"),
            ("18FEF100", "18FEF100#", "100#"),
            ("180:780", "185#", "205#"),
            ("180~780", "205#", "185#"),
            ("!180:780", "205#", "185#"),
            ("node=5", "585#4B41600037020000", "586#4B41600037020000"),
            ("node=5", "000#0105", "000#0100"),
            ("nmt", "000#0105", "080#"),
            ("sync", "080#", "081#0000000000000000"),
            ("time", "100#000000000000", "080#"),
            ("emcy", "081#0000000000000000", "080#"),
            ("pdo", "205#00", "605#4041600000000000"),
            ("sdo", "605#4041600000000000", "205#00"),
            ("heartbeat", "705#05", "205#00"),
            ("lss", "7E5#0401000000000000", "705#05"),
            ("error", "20000080#0000000000000000", "705#05"),
        ] {
            assert!(shows(&[filter], yes), "{filter} {yes}");
            assert!(!shows(&[filter], no), "{filter} {no}");
        }
    }

    #[test]
    fn filters_are_combined_and_inverted_filters_exclude() {
        assert!(shows(&[], "123#"));
        assert!(shows(&["sync", "nmt"], "080#") && shows(&["sync", "nmt"], "000#0105"));
        assert!(!shows(&["sync", "nmt"], "705#05"));
        assert!(shows(&["!sync"], "705#05") && !shows(&["!sync", "pdo"], "705#05"));
        assert!(shows(&["!sync", "pdo"], "185#00") && !shows(&["pdo", "!185"], "185#00"));
        assert!(!shows(&["!sync", "!nmt"], "080#"));
    }

    #[test]
    fn invalid_filter_is_rejected_with_the_notation() {
        for text in [
            "", "1234", "800", "180:", "180:x", "node=0", "node=128", "sdos", "123~",
        ] {
            let error = text.parse::<Filter>().unwrap_err();
            assert!(error.contains("node=5"), "{error}");
        }
    }
}
