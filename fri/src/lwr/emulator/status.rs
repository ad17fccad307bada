//! What other threads see of a served controller, as the status that both generations share shows it. No words of its own.

use super::krc::Krc;
use super::leave::Leave;
use crate::emulator::{Status, served};
use crate::lwr::wire::{Quality, State};

/// Live state of a controller in [`super::serve`], shared by an `Arc`.
pub type KrcStatus = Status<Krc>;

served!(Krc, State, Quality, Leave, u16, to_krc);
