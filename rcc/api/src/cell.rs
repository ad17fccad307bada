//! The cell of a controller: how a program connects to it, finds its devices, and leaves it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_client::{Client, Token};

use crate::arm::Arm;
use crate::base::Base;
use crate::description::{self, Descriptions};

use crate::error::{Error, ErrorKind};
use crate::expression::{Condition, Number};
use crate::gripper::Gripper;
use crate::io::Io;
use crate::listener::{Expression, Listener};
use crate::net::Net;
use crate::session::Session;
use crate::world::{Frame, World};

/// How long closing a cell waits until its devices are at rest.
const REST_TIMEOUT: Duration = Duration::from_secs(10);

/// The controller of a cell. Clones share the connection, and the activities belong to it: when the last clone, arm and
/// handle is gone, or the program dies, the controller cancels them, and aborts what does not end.
#[derive(Clone, Debug)]
pub struct Cell {
    session: Arc<Session>,
}

impl Cell {
    /// Connects to a controller: `host:port`, or the path of its Unix socket.
    ///
    /// # Errors
    /// If no controller listens there, it requires a token, or it is of another version ([`ErrorKind::Version`]).
    #[track_caller]
    pub fn connect(address: &str) -> Result<Self, Error> {
        Self::connect_with(address, None)
    }

    /// The same with a token.
    ///
    /// # Errors
    /// As [`Self::connect`].
    #[track_caller]
    pub fn connect_with(address: &str, token: Option<&Token>) -> Result<Self, Error> {
        let client = Client::connect_with(address, token);
        let client = client.map_err(|error| {
            if let takt_client::Error::Refused { command, text, .. } = &error
                && command == "ver"
            {
                let (address, reason) = (address.to_owned(), text.clone());
                return ErrorKind::Version { address, reason };
            }
            error.into()
        })?;
        Ok(Self::begin(client)?)
    }

    /// Connects to the controller of this host.
    ///
    /// # Errors
    /// As [`Self::connect`].
    #[track_caller]
    pub fn connect_here(token: Option<&Token>) -> Result<Self, Error> {
        Ok(Self::begin(Client::connect_here(token)?)?)
    }

    pub(crate) fn begin(client: Client) -> Result<Self, ErrorKind> {
        let session = Session::begin_with(client)?;
        Ok(Self { session })
    }

    #[cfg(feature = "embedded")]
    pub(crate) const fn of_session(session: Arc<Session>) -> Self {
        Self { session }
    }

    #[cfg(feature = "embedded")]
    pub(crate) fn session(&self) -> &Session {
        &self.session
    }

    /// An arm by its name.
    ///
    /// # Errors
    /// If the controller has no arm of that name; the error lists those that it has.
    #[track_caller]
    pub fn arm(&self, name: &str) -> Result<Arm, Error> {
        let mut arms = self.arms()?;
        let at = arms.iter().position(|arm| arm.description().name == name);
        let arm = at.map(|at| arms.swap_remove(at)).ok_or_else(|| {
            let known = arms.iter().map(|arm| arm.description().name.clone());
            ErrorKind::no_device("arm", name, known.collect())
        });
        Ok(arm?)
    }

    /// Inputs and outputs of a device.
    ///
    /// # Errors
    /// If the controller has no such device, or it has neither inputs nor outputs; the error lists those that have.
    #[track_caller]
    pub fn io(&self, device: &str) -> Result<Io, Error> {
        Ok(Io::find(&self.session, device)?)
    }

    /// All devices with inputs or outputs.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn ios(&self) -> Result<Vec<Io>, Error> {
        Ok(Io::all(&self.session)?)
    }

    /// A gripper by its name.
    ///
    /// # Errors
    /// If the controller has no gripper of that name; the error lists those that it has.
    #[track_caller]
    pub fn gripper(&self, name: &str) -> Result<Gripper, Error> {
        Ok(Gripper::find(&self.session, name)?)
    }

    /// All grippers.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn grippers(&self) -> Result<Vec<Gripper>, Error> {
        Ok(Gripper::all(&self.session)?)
    }

    /// A mobile base by its name.
    ///
    /// # Errors
    /// If the controller has no mobile base of that name; the error lists those that it has.
    #[track_caller]
    pub fn base(&self, name: &str) -> Result<Base, Error> {
        Ok(Base::find(&self.session, name)?)
    }

    /// A frame of the cell by its name: one that the cell file names, `world`, and of each device `DEVICE.base`,
    /// `DEVICE.flange` and its tools, of a mobile base also `DEVICE.odometry`, where it started.
    ///
    /// # Errors
    /// If there is no frame of that name; the error lists all.
    #[track_caller]
    pub fn frame(&self, name: &str) -> Result<Frame, Error> {
        let devices = Descriptions::read(&self.session)?;
        Ok(World::read(&self.session, &devices)?.frame(name)?)
    }

    /// All frames of the cell, by their names.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn frames(&self) -> Result<Vec<Frame>, Error> {
        let devices = Descriptions::read(&self.session)?;
        Ok(World::read(&self.session, &devices)?.frames()?)
    }

    /// All arms.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn arms(&self) -> Result<Vec<Arm>, Error> {
        let devices = Descriptions::read(&self.session)?;
        let world = World::read(&self.session, &devices)?;
        let arms = devices.all().filter_map(|(name, device)| {
            let arm = description::arm(name, device)?;
            let base = world.frame(&format!("{name}.base"));
            Some(base.map(|base| Arm::new(Arc::clone(&self.session), arm, base)))
        });
        Ok(arms.collect::<Result<_, ErrorKind>>()?)
    }

    /// Sets the speed of all activities of this program, 0 to 1, as part of their own speed: also of those that run,
    /// which take it in their next cycle. At 0 they stand still on their paths and go on with a larger factor.
    ///
    /// # Errors
    /// If the factor is not from 0 to 1, or the connection is lost.
    #[track_caller]
    pub fn set_override(&self, factor: f64) -> Result<(), Error> {
        if !(0.0..=1.0).contains(&factor) {
            let text = format!("the override is {factor}; it is from 0 to 1");
            return Err(ErrorKind::Invalid(text).into());
        }
        self.session.set_speed(factor);
        Ok(self.session.engine().lost().map_or(Ok(()), Err)?)
    }

    /// The speed that [`Self::set_override`] has set, 0 to 1.
    pub fn override_factor(&self) -> f64 {
        self.session.speed()
    }

    /// The present value of a number, in its unit; `None` if a device does not know it. The history of averages and
    /// durations begins with the call.
    ///
    /// # Errors
    /// If the controller rejects the expression, or the connection is lost.
    #[track_caller]
    pub fn value(&self, number: &Number) -> Result<Option<f64>, Error> {
        let mut net = Net::default();
        let value = number.write(&mut net);
        let arguments = [("inValue", (&value).into()), ("Key", "value".into())];
        net.add("Core::DoubleNetcommOut", arguments);
        let values = self.session.evaluate(&net.finish_once())?;
        Ok(values.get("outvalue").and_then(|text| text.parse().ok()))
    }

    /// Whether a condition holds at present; not if it depends on a number that a device does not know.
    ///
    /// # Errors
    /// As [`Self::value`].
    #[track_caller]
    pub fn holds(&self, condition: &Condition) -> Result<bool, Error> {
        let mut net = Net::default();
        let value = condition.write(&mut net);
        net.result("value", &value);
        let values = self.session.evaluate(&net.finish_once())?;
        Ok(values.get("outvalue").is_some_and(|text| text == "true"))
    }

    /// Calls `callback` with the value of a number or a condition, then at each change, until the listener is dropped: in a thread
    /// of its own, so that it may take its time and call this API. Numbers are `None` while a device does not know them.
    ///
    /// # Errors
    /// If the controller rejects the expression, or the connection is lost. What fails later is in [`Listener::error`].
    #[track_caller]
    pub fn on_change<E: Expression>(
        &self,
        expression: &E,
        callback: impl FnMut(E::Value) + Send + 'static,
    ) -> Result<Listener, Error> {
        Ok(Listener::start(&self.session, expression, callback)?)
    }

    /// Stops everything that this program began, from any thread, and waits until it is at rest: robots brake on their paths
    /// within their limits. What waits does not begin, nor does what another thread is planning or about to begin; what is
    /// begun afterwards does. It is no emergency stop: that is `takt stop`, or a switch on the robot.
    ///
    /// # Errors
    /// If the connection is lost: the controller then stops it. [`ErrorKind::Ended`] if a device still moves after 10 s.
    #[track_caller]
    pub fn stop(&self) -> Result<(), Error> {
        let Some(device) = self.halt() else {
            return Ok(self.session.engine().lost().map_or(Ok(()), Err)?);
        };
        let reason = "it did not come to rest within 10 s after its cancellation\nhint: `takt stop` stops all robots";
        let reason = reason.to_owned();
        Err(ErrorKind::Ended { device, reason }.into())
    }

    /// Cancels everything that this program began, waits until it is at rest, and ends the session.
    ///
    /// # Errors
    /// If the connection is lost, or something still moves after ten seconds; the session is ended in any case.
    #[track_caller]
    pub fn close(self) -> Result<(), Error> {
        let moving = self.halt();
        self.session.end()?;
        let Some(device) = moving else {
            return Ok(());
        };
        let reason = "it did not come to rest after its cancellation and was aborted".to_owned();
        Err(ErrorKind::Ended { device, reason }.into())
    }

    /// Stops everything and waits until it has ended; returns a device that still moves after [`REST_TIMEOUT`].
    fn halt(&self) -> Option<String> {
        let (devices, stopped) = self.session.stop();
        let until = Instant::now() + REST_TIMEOUT;
        let rests = |session: &Session| {
            let engine = session.engine();
            stopped.iter().all(|id| engine.has_ended(*id)).then_some(())
        };
        match self.session.wait_until(until, rests) {
            Some(()) => None,
            None => {
                let going = self.session.engine().busy();
                let device = devices.iter().find(|device| going.contains(*device));
                Some(device.cloned().unwrap_or_default())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Write as _};
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn controller_of_another_version_is_refused() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let other = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut line = String::new();
            BufReader::new(stream.try_clone().unwrap())
                .read_line(&mut line)
                .unwrap();
            let tag = line.split('=').next().unwrap();
            writeln!(stream, "{tag}=err(\"bad handshake\")").unwrap();
        });
        let error = Cell::connect(&address).unwrap_err();
        other.join().unwrap();
        let ErrorKind::Version { reason, .. } = &error.kind else {
            panic!("{error}");
        };
        assert_eq!(reason, "bad handshake");
    }
}
