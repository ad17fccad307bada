//! Whether programs may start anything now: not while the controller shuts down, and not while it is stopped. It stops
//! nothing itself.

use std::sync::Arc;

use crate::device::DeviceStatus;
use crate::error::Error;
use crate::executor::stop::EmergencyStop;
use crate::stop_channel::{Generation, StopSwitch};

/// The emergency stop, and whether the controller shuts down.
#[derive(Debug)]
pub(super) struct Permission {
    stop: Arc<EmergencyStop>,
    is_closing: bool,
}

impl Permission {
    pub(super) const fn new(stop: Arc<EmergencyStop>) -> Self {
        Self {
            stop,
            is_closing: false,
        }
    }

    /// Nothing starts any more.
    pub(super) const fn close(&mut self) {
        self.is_closing = true;
    }

    pub(super) const fn is_closing(&self) -> bool {
        self.is_closing
    }

    /// The switch of the stop channel.
    pub(super) fn switch(&self) -> &StopSwitch {
        self.stop.switch()
    }

    /// Whether devices follow no commands now, by the stop channel or by an `EStop` primitive.
    pub(super) fn is_stopped(&self) -> bool {
        self.stop.is_on(takt_rt::monotonic())
    }

    /// The generation under which a start is requested: after another stop it is void.
    pub(super) fn generation(&self) -> Generation {
        self.switch().generation()
    }

    /// An error if the controller shuts down.
    pub(super) const fn check_load(&self) -> Result<(), Error> {
        if self.is_closing {
            return Err(Error::Closing);
        }
        Ok(())
    }

    /// An error if the controller shuts down or is stopped.
    pub(super) fn check_start(&self) -> Result<(), Error> {
        self.check_load()?;
        if self.switch().is_stopped() {
            return Err(self.stopped());
        }
        Ok(())
    }

    /// The error that the controller is or was stopped, with the source of the stop.
    pub(super) fn stopped(&self) -> Error {
        let by = self.switch().last_stop();
        let by = by.map_or_else(|| "its stop channel".to_owned(), |(by, _)| by.to_string());
        Error::Stopped { by }
    }

    /// The status of a device for users, with the stop that withholds its commands.
    pub(super) fn status_text(&self, status: DeviceStatus) -> String {
        if !self.is_stopped() {
            return status.to_string();
        }
        let status = status.under(true);
        if self.switch().is_stopped() {
            return format!("{status}: {}", self.stopped());
        }
        format!("{status}: the emergency stop is on")
    }
}
