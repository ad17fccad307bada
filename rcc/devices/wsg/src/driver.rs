//! The driver of a WSG gripper: a thread that connects to it, gives it the commands of nets and reports its values. The
//! protocol is in [`session`](crate::session).

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use takt_core::Error;
use takt_core::device::driver::{DeviceDriver, DriverEnds, DriverEvent, DriverThread};
use takt_core::device::endpoint::Endpoint;
use takt_core::device::parts::with_figures;
use takt_core::device::{DeviceDescription, DeviceStatus, Figure, Part};
use takt_net::device::Answer;
use takt_rt::Nanos;

use crate::config::WsgConfig;
use crate::session::Session;

/// Longest wait for received bytes: commands of nets wait as long.
const WAIT: Duration = Duration::from_millis(5);
/// Longest attempt to connect, and longest write.
const CONNECT_MAX: Duration = Duration::from_millis(300);
/// Time between two attempts.
const RETRY_EVERY: Duration = Duration::from_millis(500);
/// Cycle by which the freshness of commands is judged.
const CYCLE: Nanos = Nanos(20_000_000);

/// Description of the gripper.
#[must_use]
pub fn describe(config: &WsgConfig) -> DeviceDescription {
    DeviceDescription {
        name: config.name.clone(),
        kind: "schunk_wsg",
        limits: Vec::new(),
        model: "".into(),
        parts: parts(),
    }
}

fn parts() -> Vec<Part> {
    let figures = [
        Figure::state("wsg.connection", Contact::WORDS),
        Figure::number("wsg.connections"),
        Figure::number("wsg.errors"),
        Figure::number("events"),
    ];
    with_figures(&[Part::ServoGripper], figures)
}

/// State of the connection, as other threads see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Contact {
    /// No attempt was made yet.
    None,
    Connected,
    Refused,
    Unreachable,
    /// Closed by the gripper, or it was silent.
    Lost,
}

impl Contact {
    const ALL: [Self; 5] = [
        Self::None,
        Self::Connected,
        Self::Refused,
        Self::Unreachable,
        Self::Lost,
    ];

    /// Their names.
    const WORDS: [&str; 5] = ["none", "connected", "refused", "unreachable", "lost"];

    fn of(code: u64) -> Self {
        let index = usize::try_from(code).unwrap_or_default();
        Self::ALL.get(index).copied().unwrap_or(Self::None)
    }

    fn event(self, address: SocketAddr) -> Option<DriverEvent> {
        Some(match self {
            Self::None => return None,
            Self::Connected => DriverEvent::info(format!("connected to the gripper at {address}")),
            Self::Refused => DriverEvent::warning(format!(
                "the gripper at {address} refuses connections\n\
                 hint: enable TCP/IP as its command interface in its web interface, with that port; it accepts one client"
            )),
            Self::Unreachable => DriverEvent::warning(format!(
                "the gripper at {address} cannot be reached\n\
                 hint: `ping {}` shows whether the network works",
                address.ip()
            )),
            Self::Lost => DriverEvent::warning(format!(
                "the connection to the gripper at {address} is lost; the gripper stops"
            )),
        })
    }
}

/// What other threads read.
#[derive(Debug, Default)]
struct Shared {
    contact: AtomicU64,
    /// The contact that was reported last.
    reported: AtomicU64,
    connections: AtomicU64,
    errors: AtomicU64,
}

/// A running driver.
#[derive(Debug)]
pub struct Wsg {
    shared: Arc<Shared>,
    address: SocketAddr,
    thread: DriverThread,
}

impl Wsg {
    /// Starts the driver thread.
    ///
    /// # Errors
    /// If the thread cannot be created.
    pub fn start(config: &WsgConfig, ends: DriverEnds) -> Result<Self, Error> {
        let (end, clock) = ends.only(&config.name)?;
        let shared = Arc::<Shared>::default();
        let mut driver = Box::new(Driver {
            address: config.address,
            connection: None,
            retry_at: Duration::ZERO,
            end: Endpoint::new(end, &parts(), 0),
            given: 0,
            events: 0,
            shared: Arc::clone(&shared),
        });
        let thread = DriverThread::start(
            &config.name,
            config.priority,
            &config.cpus,
            move |stopping| {
                let scope = takt_rt::alloc::enter_real_time();
                while !stopping.load(Ordering::Relaxed) {
                    driver.serve();
                }
                driver.end();
                drop(scope);
                clock
            },
        )?;
        Ok(Self {
            shared,
            address: config.address,
            thread,
        })
    }
}

impl DeviceDriver for Wsg {
    fn thread(&self) -> &DriverThread {
        &self.thread
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.thread
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        let number = |figure: &AtomicU64| figure.load(Ordering::Relaxed).to_string();
        vec![
            ("connections", number(&self.shared.connections)),
            ("errors", number(&self.shared.errors)),
        ]
    }

    fn poll_event(&self) -> Option<DriverEvent> {
        let now = self.shared.contact.load(Ordering::Relaxed);
        let before = self.shared.reported.swap(now, Ordering::Relaxed);
        let changed = now != before;
        changed.then(|| Contact::of(now).event(self.address))?
    }
}

struct Connection {
    stream: TcpStream,
    session: Session,
}

impl Connection {
    fn open(address: SocketAddr, now: Duration) -> io::Result<Self> {
        let stream = TcpStream::connect_timeout(&address, CONNECT_MAX)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(CONNECT_MAX))?;
        Ok(Self {
            stream,
            session: Session::new(now),
        })
    }

    /// Receives for a moment, then sends what waits.
    fn exchange(&mut self) -> io::Result<()> {
        let mut bytes = [0; 512];
        if takt_rt::readable(self.stream.as_fd(), WAIT)? {
            let len = self.stream.read(&mut bytes)?;
            let received = bytes.get(..len).filter(|received| !received.is_empty());
            let received = received.ok_or(ErrorKind::UnexpectedEof)?;
            self.session.handle_bytes(received, now());
        }
        self.session.poll(now());
        if self.session.is_lost(now()) {
            return Err(ErrorKind::TimedOut.into());
        }
        self.send()
    }

    fn send(&mut self) -> io::Result<()> {
        let mut out = [0; 256];
        let len = self.session.transmit(&mut out);
        self.stream.write_all(out.get(..len).unwrap_or_default())
    }
}

/// Time since the start of the host.
fn now() -> Duration {
    Duration::from_nanos(u64::try_from(takt_rt::monotonic().0).unwrap_or(0))
}

struct Driver {
    address: SocketAddr,
    connection: Option<Connection>,
    retry_at: Duration,
    end: Endpoint,
    /// Number of the last command that was given.
    given: u64,
    /// Changes of the contact.
    events: u64,
    shared: Arc<Shared>,
}

impl Driver {
    /// Exchanges with the gripper for a moment, or tries to connect.
    fn serve(&mut self) {
        self.end.take();
        let Some(connection) = &mut self.connection else {
            self.connect();
            return;
        };
        let errors = connection.session.errors();
        let exchanged = connection.exchange();
        let failed = connection.session.errors() - errors;
        self.shared.errors.fetch_add(failed, Ordering::Relaxed);
        if exchanged.is_err() {
            self.lose();
        } else {
            self.command();
        }
        self.publish();
    }

    fn connect(&mut self) {
        let now = now();
        if now < self.retry_at {
            // Fails only for invalid times.
            takt_rt::sleep_until(takt_rt::monotonic() + WAIT.into()).ok();
        } else {
            self.retry_at = now + RETRY_EVERY;
            let contact = match Connection::open(self.address, now) {
                Ok(connection) => {
                    self.connection = Some(connection);
                    self.shared.connections.fetch_add(1, Ordering::Relaxed);
                    Contact::Connected
                }
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Contact::Refused,
                Err(_) => Contact::Unreachable,
            };
            self.report(contact);
        }
        // What nets command without contact is not executed later.
        self.skip();
        self.publish();
    }

    fn lose(&mut self) {
        self.connection = None;
        self.retry_at = now() + RETRY_EVERY;
        self.report(Contact::Lost);
    }

    fn report(&mut self, contact: Contact) {
        let is_new = Contact::of(self.shared.contact.load(Ordering::Relaxed)) != contact;
        if is_new {
            self.shared.contact.store(contact as u64, Ordering::Relaxed);
            self.events += 1;
        }
    }

    /// Marks the present command as given.
    fn skip(&mut self) {
        let gripper = self.end.interfaces.servo_gripper;
        let given = gripper.and_then(|it| it.order.command.read(&self.end.taken.words));
        if let Some(given) = given {
            self.given = given.cycle;
        }
    }

    /// Gives a new command of nets, and stops that of a net that ended or whose thread died.
    fn command(&mut self) {
        let (Some(connection), Some(gripper)) =
            (&mut self.connection, self.end.interfaces.servo_gripper)
        else {
            return;
        };
        let Some(given) = gripper.order.command.read(&self.end.taken.words) else {
            return;
        };
        let session = &mut connection.session;
        let is_fresh = self.end.is_fresh(takt_rt::monotonic(), CYCLE);
        if given.is_withdrawn() || !is_fresh {
            session.withdraw(given.cycle, now());
            self.given = given.cycle;
        } else if given.cycle != self.given {
            session.give(given.cycle, &given.value, now());
            self.given = given.cycle;
        }
        if connection.send().is_err() {
            self.lose();
        }
    }

    fn publish(&mut self) {
        let session = self.connection.as_ref().map(|it| &it.session);
        let is_ready = session.is_some_and(Session::is_ready);
        let status = match session {
            Some(_) if is_ready => DeviceStatus::Operational,
            Some(session) if session.values().width.is_some() => DeviceStatus::SafeOperational,
            _ => DeviceStatus::Offline,
        };
        let values = session.map(|session| *session.values()).unwrap_or_default();
        let finished = session.and_then(Session::finished);
        self.end.reported.enter(status, takt_rt::monotonic());
        if let Some(gripper) = self.end.interfaces.servo_gripper {
            let signals = &mut self.end.reported.signals;
            gripper.ready.report(signals, Some(is_ready));
            gripper.width.report(signals, values.width);
            gripper.speed.report(signals, values.speed);
            gripper.force.report(signals, values.force);
            gripper
                .grasping
                .report(signals, values.grasping.map(i32::from));
            let answer = finished.map(|(order, status)| Answer {
                order,
                error: status.0.into(),
            });
            if answer.is_some() {
                gripper.order.answer.report(signals, answer);
            }
        }
        let Shared {
            contact,
            connections,
            errors,
            ..
        } = &*self.shared;
        let counted = [contact, connections, errors].map(|count| count.load(Ordering::Relaxed));
        let [contact, connections, errors] = counted;
        let values = [contact, connections, errors, self.events].map(|it| Some(Figure::count(it)));
        self.end.report_figures(0, values);
        self.end.publish();
    }

    /// Stops a motion and says goodbye, so that the gripper keeps its part.
    fn end(&mut self) {
        if let Some(connection) = &mut self.connection {
            connection.session.withdraw(self.given, now());
            connection.session.say_goodbye();
            // The gripper stops fast if it does not receive that.
            connection.send().ok();
        }
    }
}
