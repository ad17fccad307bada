//! An action server: goals, cancellation, results, feedback and states by the rules of `action_msgs`. What a goal does is a
//! [`Performer`]'s matter. A thread for each action; requests wait in a bounded queue.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use takt_api::{Error, Handle, Outcome};
use takt_fleet::ros::action::{GoalStatus, Goals, Requested, UNKNOWN};
use takt_fleet::ros::keys::Qos;
use takt_fleet::ros::messages::{self, GoalId, Nanos};
use takt_fleet::ros::node::{Node, NodeError, Publisher, Request, now};
use takt_fleet::ros::types::{ActionType, CANCEL_GOAL, GOAL_STATUS_ARRAY, Type};

use crate::output::{chain, complain};
use crate::signal::Stop;

/// How often outcomes are looked for.
const TICK: Duration = Duration::from_millis(5);
/// Time between two messages of feedback.
const FEEDBACK: Duration = Duration::from_millis(50);
/// Requests that wait.
const QUEUE: usize = 64;

/// What was refused, said once in a while for each action.
#[derive(Clone, Debug, Default)]
pub(super) struct Refusals(Arc<Mutex<BTreeMap<String, Said>>>);

#[derive(Debug)]
struct Said {
    text: String,
    at: Instant,
    more: u32,
}

impl Refusals {
    /// Says a text unless it was said of the same within 10 s; how often it was left out is said with the next one.
    pub(super) fn say(&self, of: &str, text: &str) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let mut more = 0;
        if let Some(said) = all.get_mut(of) {
            if said.text == text && now - said.at < Duration::from_secs(10) {
                said.more += 1;
                return;
            }
            more = said.more;
        }
        let before = match more {
            0 => String::new(),
            more => format!(" (the text before {more} times more)"),
        };
        complain(&format!("takt: {of}: {text}{before}"));
        let text = text.to_owned();
        all.insert(
            of.to_owned(),
            Said {
                text,
                at: now,
                more: 0,
            },
        );
    }
}

/// What goals of an action do.
pub(super) trait Performer: Send + 'static {
    /// A goal that makes sense.
    type Goal: Send;

    /// Reads and checks the request of `send_goal`.
    ///
    /// # Errors
    /// The cause, for people.
    fn read(&self, message: &[u8]) -> Result<(GoalId, Self::Goal), String>;

    /// The same of a message of the topic; not every action has one.
    ///
    /// # Errors
    /// The cause, for people.
    fn read_message(&self, _message: &[u8]) -> Result<Self::Goal, String> {
        Err("this action has no topic".to_owned())
    }

    /// How long after now a goal begins.
    fn delay(&self, _goal: &Self::Goal) -> Duration {
        Duration::ZERO
    }

    /// Begins it, in place of what runs.
    ///
    /// # Errors
    /// The cause.
    fn begin(&mut self, goal: &Self::Goal) -> Result<Handle, String>;

    /// The answer of `get_result`.
    fn result(&self, status: u8, end: &End) -> Vec<u8>;

    /// A message of feedback for each of its publishers.
    fn feedback(&self, _id: GoalId, _goal: &Self::Goal, _elapsed: Duration) -> Vec<Vec<u8>> {
        Vec::new()
    }
}

/// How a goal ended.
#[derive(Debug)]
pub(super) enum End {
    /// It never began.
    NotBegun(String),
    /// As its activity did.
    Ended(Result<Outcome, Error>),
    /// There is no such goal.
    NoGoal,
}

impl End {
    fn status(&self, is_cancelled: bool) -> GoalStatus {
        match self {
            Self::Ended(Ok(Outcome::Completed | Outcome::Maintaining)) => GoalStatus::Succeeded,
            Self::Ended(Ok(Outcome::TakenOver)) => GoalStatus::Canceled,
            Self::Ended(Ok(Outcome::Cancelled)) if is_cancelled => GoalStatus::Canceled,
            Self::Ended(_) | Self::NotBegun(_) | Self::NoGoal => GoalStatus::Aborted,
        }
    }

    /// The cause, for people.
    pub(super) fn text(&self) -> String {
        match self {
            Self::NotBegun(why) => why.clone(),
            Self::Ended(Ok(Outcome::Completed | Outcome::Maintaining)) => String::new(),
            Self::Ended(Ok(Outcome::TakenOver)) => "another goal took over".to_owned(),
            Self::Ended(Ok(Outcome::Cancelled | Outcome::Skipped)) => "cancelled".to_owned(),
            Self::Ended(Ok(Outcome::Stopped(by))) => format!("stopped by {by}"),
            Self::Ended(Err(error)) => error.kind.to_string(),
            Self::NoGoal => "there is no such goal".to_owned(),
        }
    }
}

/// What comes over the network.
enum Event {
    SendGoal(Request),
    GetResult(Request),
    Cancel(Request),
    /// A goal of a topic: without answer, result and feedback.
    Topic(Vec<u8>),
}

/// Where network threads put what comes.
#[derive(Clone)]
pub(super) struct Queue {
    of: String,
    events: SyncSender<Event>,
    refusals: Refusals,
}

impl Queue {
    fn put(&self, event: Event) {
        match self.events.try_send(event) {
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => self.refusals.say(
                &self.of,
                "a request is not answered: too many wait\nhint: send fewer goals a second",
            ),
        }
    }

    /// Takes goals from a topic.
    pub(super) fn put_message(&self, message: &[u8]) {
        self.put(Event::Topic(message.to_vec()));
    }
}

/// A goal that is to begin, or has begun.
struct Running<G> {
    /// `None` of a topic.
    id: Option<GoalId>,
    goal: G,
    handle: Option<Handle>,
    begins: Instant,
    is_cancelled: bool,
}

/// The server of an action.
pub(super) struct Server<P: Performer> {
    of: String,
    performer: P,
    events: Receiver<Event>,
    goals: Goals<Request>,
    running: Vec<Running<P::Goal>>,
    status: Publisher,
    feedback: Vec<Publisher>,
    /// The states that were published last.
    published: Vec<(GoalId, Nanos, u8)>,
    fed: Instant,
    refusals: Refusals,
    stop: Stop,
}

/// Declares the endpoints of an action; `feedbacks` are the types of its feedback in the order of the performer's messages.
pub(super) fn offer<P: Performer>(
    node: &Node,
    name: &str,
    (ty, feedbacks): (&ActionType, &[Type]),
    performer: P,
    (refusals, stop): (&Refusals, &Stop),
) -> Result<(Server<P>, Queue), NodeError> {
    let (events, received) = sync_channel(QUEUE);
    let of = format!("action {name}");
    let queue = Queue {
        of: of.clone(),
        events,
        refusals: refusals.clone(),
    };
    let part = |part: &str| format!("{name}/_action/{part}");
    let service = |service: &str, ty: &Type, event: fn(Request) -> Event| {
        let queue = queue.clone();
        node.service(&part(service), ty, move |request| queue.put(event(request)))
    };
    service("send_goal", &ty.send_goal, Event::SendGoal)?;
    service("get_result", &ty.get_result, Event::GetResult)?;
    service("cancel_goal", &CANCEL_GOAL, Event::Cancel)?;
    let publisher = |ty| node.publisher(&part("feedback"), ty, Qos::TOPIC);
    let feedback = feedbacks.iter().map(publisher);
    let server = Server {
        of,
        performer,
        events: received,
        goals: Goals::default(),
        running: Vec::new(),
        status: node.publisher(&part("status"), &GOAL_STATUS_ARRAY, Qos::LATCHED)?,
        feedback: feedback.collect::<Result<_, _>>()?,
        published: Vec::new(),
        fed: Instant::now(),
        refusals: refusals.clone(),
        stop: stop.clone(),
    };
    Ok((server, queue))
}

impl<P: Performer> Server<P> {
    /// Runs until the command ends.
    pub(super) fn start(self) -> std::io::Result<JoinHandle<()>> {
        let thread = std::thread::Builder::new().name("takt-ros2".to_owned());
        thread.spawn(move || self.run())
    }

    fn run(mut self) {
        while !self.stop.is_requested() {
            match self.events.recv_timeout(TICK) {
                Ok(event) => self.take(event),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.begin_due();
            self.poll();
            self.feed();
            self.publish();
        }
        for running in &self.running {
            running.handle.iter().for_each(Handle::cancel);
        }
    }

    fn say(&self, text: &str) {
        self.refusals.say(&self.of, text);
    }

    fn answer(&self, request: Request, message: Vec<u8>) {
        if let Err(why) = request.reply(message) {
            self.say(&chain(&why.into()));
        }
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::SendGoal(request) => self.send_goal(request),
            Event::Topic(message) => {
                let read = self.performer.read_message(&message);
                let begun = read.and_then(|goal| self.try_begin(None, goal));
                if let Err(why) = begun {
                    self.say(&format!("a trajectory of the topic is not followed: {why}"));
                }
            }
            Event::GetResult(request) => match messages::decode_get_result(&request.message()) {
                Ok(id) => self.get_result(id, request),
                Err(why) => self.say(&format!("a request for a result is malformed: {why}")),
            },
            Event::Cancel(request) => match messages::decode_cancel(&request.message()) {
                Ok((id, stamp)) => self.cancel(id, stamp, request),
                Err(why) => self.say(&format!("a request to cancel is malformed: {why}")),
            },
        }
    }

    fn send_goal(&mut self, request: Request) {
        let read = self.performer.read(&request.message());
        let begun = read.and_then(|(id, goal)| {
            let stamp = now();
            if !self.goals.accept(id, stamp) {
                return Err("its identifier is known, or too many goals are to end".to_owned());
            }
            let begun = self.try_begin(Some(id), goal);
            if let Err(why) = &begun {
                // It was never a goal for its client.
                self.goals.end(id, GoalStatus::Aborted, Vec::new());
                self.goals.forget(id);
                return Err(why.clone());
            }
            Ok(stamp)
        });
        let message = match begun {
            Ok(stamp) => messages::accepted(true, stamp),
            Err(why) => {
                self.say(&format!("a goal is rejected: {why}"));
                messages::accepted(false, 0)
            }
        };
        self.answer(request, message);
    }

    /// Begins a goal, or lets it wait for its time.
    fn try_begin(&mut self, id: Option<GoalId>, goal: P::Goal) -> Result<(), String> {
        let delay = self.performer.delay(&goal);
        let handle = if delay.is_zero() {
            let handle = self.performer.begin(&goal)?;
            if let Some(id) = id {
                self.goals.set(id, GoalStatus::Executing);
            }
            Some(handle)
        } else {
            None
        };
        self.running.push(Running {
            id,
            goal,
            handle,
            begins: Instant::now() + delay,
            is_cancelled: false,
        });
        Ok(())
    }

    fn begin_due(&mut self) {
        let now = Instant::now();
        let mut ended = Vec::new();
        for (number, running) in self.running.iter_mut().enumerate() {
            if running.handle.is_some() || running.begins > now {
                continue;
            }
            match self.performer.begin(&running.goal) {
                Ok(handle) => {
                    running.handle = Some(handle);
                    if let Some(id) = running.id {
                        self.goals.set(id, GoalStatus::Executing);
                    }
                }
                Err(why) => ended.push((number, End::NotBegun(why))),
            }
        }
        for (number, end) in ended.into_iter().rev() {
            let running = self.running.remove(number);
            self.end(&running, end);
        }
    }

    fn poll(&mut self) {
        let mut number = 0;
        while let Some(running) = self.running.get(number) {
            let outcome = running
                .handle
                .as_ref()
                .and_then(|handle| handle.wait_for(Duration::ZERO));
            match outcome {
                Some(outcome) => {
                    let running = self.running.remove(number);
                    self.end(&running, End::Ended(outcome));
                }
                None => number += 1,
            }
        }
    }

    fn end(&mut self, running: &Running<P::Goal>, end: End) {
        let status = end.status(running.is_cancelled);
        if status == GoalStatus::Aborted {
            self.say(&format!("a goal failed: {}", end.text()));
        }
        let Some(id) = running.id else {
            return;
        };
        let result = self.performer.result(status as u8, &end);
        for request in self.goals.end(id, status, result.clone()) {
            self.answer(request, result.clone());
        }
    }

    fn get_result(&mut self, id: GoalId, request: Request) {
        match self.goals.request(id, request) {
            Requested::Later => {}
            Requested::Now(request, result) => self.answer(request, result),
            Requested::Unknown(request) => {
                let result = self.performer.result(UNKNOWN, &End::NoGoal);
                self.answer(request, result);
            }
            Requested::Full(_) => {
                self.say("a request for a result is not answered: too many clients wait for it");
            }
        }
    }

    fn cancel(&mut self, id: GoalId, stamp: Nanos, request: Request) {
        let (code, cancelled) = self.goals.cancel(id, stamp);
        self.answer(request, messages::cancelling(code, &cancelled));
        let is_meant = |running: &Running<P::Goal>| {
            let mut all = cancelled.iter();
            running
                .id
                .is_some_and(|id| all.any(|(other, _)| *other == id))
        };
        let mut waiting = Vec::new();
        for (number, running) in self.running.iter_mut().enumerate() {
            if is_meant(running) {
                running.is_cancelled = true;
                match &running.handle {
                    Some(handle) => handle.cancel(),
                    None => waiting.push(number),
                }
            }
        }
        for number in waiting.into_iter().rev() {
            let running = self.running.remove(number);
            self.end(&running, End::Ended(Ok(Outcome::Cancelled)));
        }
    }

    fn feed(&mut self) {
        if self.fed.elapsed() < FEEDBACK {
            return;
        }
        self.fed = Instant::now();
        for running in &self.running {
            let Some(id) = running.id.filter(|_| running.handle.is_some()) else {
                continue;
            };
            let elapsed = running.begins.elapsed();
            let all = self.performer.feedback(id, &running.goal, elapsed);
            for (publisher, message) in self.feedback.iter().zip(all) {
                // Fails only when the session is closed.
                let _ = publisher.publish(message);
            }
        }
    }

    fn publish(&mut self) {
        let statuses = self.goals.statuses();
        if statuses != self.published {
            let _ = self.status.publish(messages::goal_statuses(&statuses));
            self.published = statuses;
        }
    }
}
