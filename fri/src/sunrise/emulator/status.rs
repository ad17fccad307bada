//! What other threads see of a served cabinet, as the status that both generations share shows it. No words of its own.

use super::cabinet::Cabinet;
use super::leave::Leave;
use crate::emulator::{Status, served};
use crate::sunrise::wire::{Quality, SessionState};

/// Live state of a cabinet in [`super::serve`], shared by an `Arc`.
pub type CabinetStatus = Status<Cabinet>;

served!(Cabinet, SessionState, Quality, Leave, i32, to_cabinet);
