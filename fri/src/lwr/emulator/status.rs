//! Status of a served KRC for other threads, by the type that both generations share.

use super::exit::ExitReason;
use super::krc::Krc;
use crate::emulator::{Status, served};
use crate::lwr::wire::{Quality, State};

/// Live state of a controller in [`super::serve`], shared by an `Arc`.
pub type KrcStatus = Status<Krc>;

served!(Krc, State, Quality, ExitReason, u16, to_krc, |_| {});
