//! Activities that are prepared beforehand: planned, written and loaded, so that what is left is one request. Where the arms
//! are is checked again when they begin, by the net itself. Not here: several begins of one preparation.

use std::sync::Arc;

use crate::compose::Compiled;
use crate::error::{Error, ErrorKind};
use crate::handle::{FOR_EVER, Handle};
use crate::outcome::Outcome;
use crate::session::Session;

/// An activity, or several that begin in one call, loaded and not begun. It is begun once. Dropped instead, it leaves
/// nothing on the controller. While it exists, the controller keeps the devices that it needs, so that their limits do not change.
///
/// Motions to joint positions begin from anywhere. What leads from where its arms are, such as a line, is refused with
/// [`ErrorKind::Stale`] if they rest elsewhere when it begins, by more than 2 mrad in a joint, or if what it then follows
/// leaves them elsewhere.
#[derive(Debug)]
#[must_use = "nothing moves before it is begun, and dropping it unloads it"]
pub struct Prepared {
    session: Arc<Session>,
    compiled: Compiled,
}

impl Prepared {
    /// Loads the nets of what was compiled. What stands in for something else is loaded when that turns out impossible.
    pub(crate) fn load(session: Arc<Session>, compiled: Compiled) -> Result<Self, ErrorKind> {
        let mut prepared = Self { session, compiled };
        let parts = prepared.compiled.parts.iter_mut();
        for part in parts.filter(|part| part.instead_of.is_none()) {
            for start in &mut part.starts {
                start.loaded = Some(prepared.session.load_ahead(&start.net)?);
            }
        }
        Ok(prepared)
    }

    /// Begins it with one request for each part, and returns when it runs.
    ///
    /// # Errors
    /// [`ErrorKind::Stale`] if it no longer fits. Else as [`Activity::begin`](crate::Activity::begin), but its nets are accepted
    /// already. Nothing is left of it then.
    #[track_caller]
    pub fn begin(self) -> Result<Handle, Error> {
        let handle = self.queue()?;
        handle.wait_for_begin(FOR_EVER).unwrap_or(Ok(()))?;
        Ok(handle)
    }

    /// Lets it begin after what its devices do, and returns at once.
    ///
    /// # Errors
    /// As [`Self::begin`]; what shows only when it begins is in the handle.
    #[track_caller]
    pub fn queue(mut self) -> Result<Handle, Error> {
        let stops = self.session.stops();
        if let Some(arm) = self.session.leaves_elsewhere(&self.compiled.expected) {
            let cause = "what it follows leaves the arm elsewhere";
            return Err(ErrorKind::stale(&arm, cause).into());
        }
        for start in self.compiled.parts.iter().flat_map(|part| &part.starts) {
            let net = start.loaded.as_ref();
            if let Some(cause) = net.and_then(|net| self.session.why_unusable(net)) {
                let device = start.devices.first().map_or("wait", String::as_str);
                return Err(ErrorKind::stale(device, &cause).into());
            }
        }
        let compiled = std::mem::take(&mut self.compiled);
        let nets = nets(&compiled);
        let begun = compiled.begin(&self.session, stops);
        match &begun {
            // The engine has them.
            Ok(_) => self.session.hand_over(&nets),
            Err(_) => self.session.unload(&nets),
        }
        begun
    }

    /// Begins it and waits until it has ended.
    ///
    /// # Errors
    /// As [`Self::begin`] and [`Handle::wait`].
    #[track_caller]
    pub fn run(self) -> Result<Outcome, Error> {
        self.begin()?.wait()
    }
}

/// The nets that are loaded.
fn nets(compiled: &Compiled) -> Vec<String> {
    let starts = compiled.parts.iter().flat_map(|part| &part.starts);
    starts.filter_map(|start| start.loaded.clone()).collect()
}

impl Drop for Prepared {
    fn drop(&mut self) {
        self.session.unload(&nets(&self.compiled));
    }
}
