//! Frames that can set something in motion are sent only after a confirmation, on a terminal or by
//! `--yes`. It decides by what a frame can do, not by what is connected.

use takt_can::AnyFrame;
use takt_can::canopen::{Message, NmtCommand};
use takt_can::linux::Interface;

use crate::confirm;

/// Requests a confirmation, if needed.
///
/// # Errors
/// If the answer is no, or there is no terminal.
pub(super) fn motion<'a>(
    interface: &str,
    frames: impl IntoIterator<Item = &'a AnyFrame>,
    confirmed: bool,
) -> anyhow::Result<()> {
    let Some(frame) = frames.into_iter().find(|frame| can_move(frame)) else {
        return Ok(());
    };
    action(interface, &frame.to_string(), confirmed)
}

/// The same for an action of many frames: `what` can set something in motion.
///
/// # Errors
/// If the answer is no, or there is no terminal.
pub(super) fn action(interface: &str, what: &str, confirmed: bool) -> anyhow::Result<()> {
    let confirmed = confirmed || is_virtual(interface);
    confirm::motion(&format!("on {interface}, {what}"), confirmed)
}

/// Nothing that moves is on an interface that has no controller.
fn is_virtual(interface: &str) -> bool {
    let details = Interface::open(interface).and_then(|interface| interface.details());
    details.is_ok_and(|details| details.is_virtual())
}

/// Whether a frame can move something: all but those that are known not to, as requests, states, and network management
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
        // An upload only reads. The three highest bits are the command of the client.
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
    fn confirmation_is_needed_for_frames_that_move() {
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
    fn confirmation_without_terminal_needs_the_option() {
        let (start, request) = (
            parse_frame("000#0105").unwrap(),
            parse_frame("705#R").unwrap(),
        );
        assert!(motion("nosuchcan0", [&request], false).is_ok());
        assert!(motion("nosuchcan0", [&request, &start], true).is_ok());
    }
}
