//! Sessions, and what programs read and write of nets and devices: states, values and debug taps.

use crate::cell::{CellFrames, OnLoss};
use crate::controller::Controller;
use crate::controller::device_set::{DeviceDetails, DeviceInfo};
use crate::controller::nets::{Net, NetInfo, RetainedNet, Taps};
use crate::error::Error;
use crate::ids::{NetId, SessionId};

impl Controller {
    /// Opens a session, to which nets can belong.
    ///
    /// # Errors
    /// If too many are open.
    pub fn open_session(&self, description: &str) -> Result<SessionId, Error> {
        self.open_session_with(description, OnLoss::Keep)
    }

    /// As [`Self::open_session`], with what happens to its nets when its connection is lost. The caller
    /// monitors the connection.
    ///
    /// # Errors
    /// If too many are open.
    pub fn open_session_with(
        &self,
        description: &str,
        on_loss: OnLoss,
    ) -> Result<SessionId, Error> {
        self.inner.lock().sessions.open(description, on_loss)
    }

    /// What happens to the nets of a session whose connection is lost; `None` if there is no such session.
    #[must_use]
    pub fn session_on_loss(&self, id: SessionId) -> Option<OnLoss> {
        self.inner.lock().sessions.on_loss(id)
    }

    /// Replaces the description of a session.
    ///
    /// # Errors
    /// If there is no such session.
    pub fn describe_session(&self, id: SessionId, description: &str) -> Result<(), Error> {
        self.inner.lock().sessions.describe(id, description)
    }

    /// The nets of a session; `None` if there is no such session.
    #[must_use]
    pub fn session_nets(&self, id: SessionId) -> Option<Vec<NetId>> {
        let registry = self.inner.lock();
        if !registry.sessions.is_valid(id) {
            return None;
        }
        let nets = registry.nets.iter();
        let of_session = nets.filter(|(_, net)| net.session == id);
        Some(of_session.map(|(id, _)| id).collect())
    }

    /// A net; `None` once it is unloaded.
    #[must_use]
    pub fn net(&self, id: NetId) -> Option<NetInfo> {
        self.inner.lock().nets.get(id).map(|net| net.info(id))
    }

    /// All nets.
    #[must_use]
    pub fn nets(&self) -> Vec<NetId> {
        let registry = self.inner.lock();
        registry.nets.iter().map(|(id, _)| id).collect()
    }

    /// Sessions that are open, with their descriptions.
    #[must_use]
    pub fn sessions(&self) -> Vec<(SessionId, String)> {
        self.inner.lock().sessions.list()
    }

    /// Out values of a net that were reported and non-null at least once, as key and text.
    #[must_use]
    pub fn out_values(&self, id: NetId) -> Vec<(String, String)> {
        self.inner
            .lock()
            .nets
            .get_mut(id)
            .map(Net::out_values)
            .unwrap_or_default()
    }

    /// The same of Boolean values alone, if any out value changed since the version `seen`, which becomes the present one.
    #[must_use]
    pub fn new_results(&self, id: NetId, seen: &mut Option<u64>) -> Vec<(String, String)> {
        let mut registry = self.inner.lock();
        let net = registry.nets.get_mut(id);
        net.map(|net| net.new_results(seen)).unwrap_or_default()
    }

    /// In values of a net as last written, as key and text.
    #[must_use]
    pub fn in_values(&self, id: NetId) -> Vec<(String, String)> {
        let registry = self.inner.lock();
        registry
            .nets
            .get(id)
            .map(Net::in_values)
            .unwrap_or_default()
    }

    /// Writes an in value of a net; returns whether the key exists.
    ///
    /// # Errors
    /// If there is no such net, or the text is not a value of that type.
    pub fn write_in(&self, id: NetId, key: &str, text: &str) -> Result<bool, Error> {
        self.inner.lock().nets.find(id)?.write_in(id, key, text)
    }

    /// The devices.
    #[must_use]
    pub fn devices(&self) -> Vec<DeviceInfo> {
        let registry = self.inner.lock();
        registry.devices.infos(registry.permission.is_stopped())
    }

    /// The devices with limits and periods.
    #[must_use]
    pub fn device_details(&self) -> Vec<DeviceDetails> {
        let registry = self.inner.lock();
        let infos = registry.devices.infos(registry.permission.is_stopped());
        let details = |info: DeviceInfo| {
            let thread = registry.threads.serving_thread(&info.name);
            let period = registry.threads.period(thread).unwrap_or_default();
            registry.devices.details(info, period)
        };
        infos.into_iter().map(details).collect()
    }

    /// Named frames of the cell, bases of its devices, and tools.
    #[must_use]
    pub fn frames(&self) -> CellFrames {
        self.inner.lock().devices.frames.clone()
    }

    /// Replaces them, as a checked cell has them. Nets that run are not affected: programs read frames before they load nets.
    pub fn set_frames(&self, frames: CellFrames) {
        let mut registry = self.inner.lock();
        registry.devices.frames = frames;
    }

    /// The retained result of an unloaded net; `None` if it has expired.
    #[must_use]
    pub fn retained(&self, id: NetId) -> Option<RetainedNet> {
        self.inner.lock().nets.retained(id)
    }

    /// The debug taps of a net with their records from number `from` on. The recording lasts from the
    /// first poll until [`TAPS_RECORDED_FOR`](super::TAPS_RECORDED_FOR) after the last. `None` if there is no such net
    /// or it is not ready.
    ///
    /// # Errors
    /// If the taps of [`RECORDED_NETS_MAX`](super::RECORDED_NETS_MAX) other nets are recorded already.
    pub fn taps(&self, id: NetId, from: u64) -> Result<Option<Taps>, Error> {
        self.inner.lock().nets.taps(id, from)
    }
}
