//! Status of a served cabinet for other threads, by the type that both generations share.

use super::cabinet::Cabinet;
use super::exit::ExitReason;
use crate::emulator::{Status, served};
use crate::sunrise::wire::{Quality, SessionState};

/// Live state of a cabinet in [`super::serve`], shared by an `Arc`.
pub type CabinetStatus = Status<Cabinet>;

served!(
    Cabinet,
    SessionState,
    Quality,
    ExitReason,
    i32,
    to_cabinet,
    Cabinet::close_session
);
