//! Frames that can set something in motion are sent only when somebody stands by it: asked on a terminal,
//! or told by `--yes`. It decides by what a frame can do, not by what is connected.

use takt_can::AnyFrame;
use takt_can::canopen::{Message, NmtCommand};
use takt_can::linux::Interface;

use crate::confirm;

/// Asks if needed.
///
/// # Errors
/// If the answer is no, or nobody can answer.
pub(super) fn motion<'a>(
    interface: &str,
    frames: impl IntoIterator<Item = &'a AnyFrame>,
    confirmed: bool,
) -> anyhow::Result<()> {
    let Some(frame) = frames.into_iter().find(|frame| can_move(frame)) else {
        return Ok(());
    };
    deed(interface, &frame.to_string(), confirmed)
}

/// The same for what is done with many frames: `what` can set something in motion.
///
/// # Errors
/// If the answer is no, or nobody can answer.
pub(super) fn deed(interface: &str, what: &str, confirmed: bool) -> anyhow::Result<()> {
    let confirmed = confirmed || is_virtual(interface);
    confirm::motion(&format!("on {interface}, {what}"), confirmed)
}

/// Nothing that moves is on an interface that has no controller.
fn is_virtual(interface: &str) -> bool {
    let details = Interface::open(interface).and_then(|interface| interface.details());
    details.is_ok_and(|details| details.is_virtual())
}

/// Whether a frame is none of those that are known to move nothing: questions, states, network management
/// other than start.
fn can_move(frame: &AnyFrame) -> bool {
    let AnyFrame::Classic(classic) = frame else {
        return matches!(frame, AnyFrame::Fd(_));
    };
    if classic.is_remote() {
        return false;
    }
    match Message::decode(classic) {
        Message::Nmt(command, _) => command == NmtCommand::Start,
        // An upload asks only. Client commands are told by the three highest bits.
        Message::SdoRequest(_, [command, ..]) => !matches!(command >> 5, 2..=5),
        Message::Time(..)
        | Message::Emergency(..)
        | Message::SdoResponse(..)
        | Message::Heartbeat(..)
        | Message::Guard(_)
        | Message::Lss(..) => false,
        Message::Sync(_) | Message::Tpdo(..) | Message::Rpdo(..) | Message::Unknown => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::log::parse_frame;

    #[test]
    fn only_what_is_known_to_move_nothing_passes() {
        for (text, moves) in [
            ("000#0105", true),
            ("000#0200", false),
            ("000#8005", false),
            ("080#", true),
            ("205#0F00", true),
            ("185#0F00", true),
            ("605#4041600000000000", false),
            ("605#2B4060000F000000", true),
            ("605#0000000000000000", true),
            ("605#8041600000000008", false),
            ("605#C241600000000000", true),
            ("705#R", false),
            ("705#05", false),
            ("18FEF100#00", true),
            ("123##100", true),
            ("20000080#0000000000000000", false),
        ] {
            assert_eq!(can_move(&parse_frame(text).unwrap()), moves, "{text}");
        }
    }

    #[test]
    fn without_a_terminal_the_word_must_be_given() {
        let (start, ask) = (
            parse_frame("000#0105").unwrap(),
            parse_frame("705#R").unwrap(),
        );
        assert!(motion("nosuchcan0", [&ask], false).is_ok());
        assert!(motion("nosuchcan0", [&ask, &start], true).is_ok());
    }
}
