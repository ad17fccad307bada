//! Several activities that are begun in one call: together, in sequence, as alternatives, or at events of each other.
//! All of them are loaded and scheduled before the first one begins; the controller decides in its cycle which follows.

use std::sync::Arc;

use crate::activity::Activity;
use crate::engine::{self, Failure, Trigger, When};
use crate::error::{Error, ErrorKind};
use crate::expression::Condition;
use crate::handle::{self, Handle};
use crate::net::{Net, Port};
use crate::order::{Operation, Order, Ports, Requests, Speed, mark_key};
use crate::outcome::Outcome;
use crate::preparation::{Before, Begins, Goals};
use crate::prepared::Prepared;
use crate::session::Session;

/// What the engine begins in one call.
#[derive(Debug, Default)]
pub(crate) struct Compiled {
    /// The parts that are valid.
    pub(crate) parts: Vec<engine::Part>,
    /// Where the activities of each part leave arms, as far as known.
    pub(crate) goals: Vec<Vec<Goals>>,
    /// Of each part whether it follows no other one, and the numbers of those whose place it takes.
    pub(crate) places: Vec<(bool, Vec<usize>)>,
    /// Where arms are to be when they begin what does not replace something.
    pub(crate) expected: Begins,
}

impl Compiled {
    /// Begins it, unless a stop came since `stops` were counted.
    #[track_caller]
    pub(crate) fn begin(self, session: &Arc<Session>, stops: u64) -> Result<Handle, Error> {
        let begun = session.begin_all(self.parts, self.goals, stops)?;
        let parts = begun.into_iter().zip(self.places);
        let parts = parts.map(|(ids, (is_first, replaces))| handle::Part {
            ids,
            is_first,
            replaces,
        });
        Ok(Handle::new(Arc::clone(session), parts.collect()))
    }
}

/// What may start another activity.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// It reached its goal.
    Completed,
    /// The condition of this name stopped it, and it is at rest.
    Stopped(String),
    /// It has completed this part of its path, 0 to below 1.
    Progress(f64),
    /// It was cancelled and is at rest.
    Cancelled,
    /// A device fails, or the path leaves its reach. An end without a result, such as an abort, is no event.
    Failed,
}

/// Several activities that are begun in one call.
#[derive(Clone, Debug)]
#[must_use = "nothing moves before it is begun"]
pub struct Composite {
    session: Option<Arc<Session>>,
    parts: Vec<Planned>,
    /// The parts that what comes next follows; of each slot the one that comes to run.
    last: Vec<Vec<usize>>,
    /// Why it cannot be begun.
    invalid: Option<&'static str>,
}

/// Activities that begin together.
#[derive(Clone, Debug)]
struct Planned {
    orders: Vec<Order>,
    when: When,
    after: Vec<Vec<usize>>,
    trigger: Option<(usize, Key)>,
    after_failure: bool,
    instead_of: Option<usize>,
    /// Parts whose outcome does not count if this one begins.
    replaces: Vec<usize>,
}

#[derive(Clone, Debug)]
enum Key {
    Of(String),
    Failures,
}

impl Planned {
    const fn new(orders: Vec<Order>, when: When) -> Self {
        Self {
            orders,
            when,
            after: Vec::new(),
            trigger: None,
            after_failure: false,
            instead_of: None,
            replaces: Vec::new(),
        }
    }

    fn is_first(&self) -> bool {
        self.after.is_empty() && self.trigger.is_none()
    }

    fn commands_one_of(&self, other: &Self) -> bool {
        let devices = |part: &Self| -> Vec<String> {
            let orders = part.orders.iter();
            orders.flat_map(|order| order.operation.devices()).collect()
        };
        let others = devices(other);
        devices(self).iter().any(|device| others.contains(device))
    }
}

impl From<Activity> for Composite {
    fn from(activity: Activity) -> Self {
        together([activity])
    }
}

/// Combines activities of different devices to one that begins when all of the devices are ready, in the same cycle.
pub fn together(activities: impl IntoIterator<Item = Activity>) -> Composite {
    let activities: Vec<_> = activities.into_iter().collect();
    let session = activities.first().map(|first| Arc::clone(&first.session));
    let is_one = activities.windows(2).all(|pair| match pair {
        [first, second] => Arc::ptr_eq(&first.session, &second.session),
        _ => true,
    });
    let is_now = activities.iter().any(|activity| activity.when == When::Now);
    let when = if is_now { When::Now } else { When::Follow };
    let orders = activities.into_iter().map(|activity| activity.order);
    let invalid = (!is_one).then_some("activities of different cells cannot begin together");
    Composite {
        session,
        parts: vec![Planned::new(orders.collect(), when)],
        last: vec![vec![0]],
        invalid,
    }
}

/// The first of several activities that is possible: the next one is tried if one is invalid, or the controller rejects
/// its net or its rule.
pub fn either(activities: impl IntoIterator<Item = Activity>) -> Composite {
    let mut all = together([]);
    all.parts.clear();
    for activity in activities {
        let mut part = Composite::from(activity);
        all.join_session(&part);
        for planned in &mut part.parts {
            planned.instead_of = all.parts.len().checked_sub(1);
            planned.replaces = (0..all.parts.len()).collect();
        }
        all.parts.append(&mut part.parts);
    }
    all.last = vec![(0..all.parts.len()).collect()];
    all
}

/// Waits for a condition, without a device.
pub fn when(condition: Condition) -> Waiting {
    Waiting(condition)
}

/// A condition that is to start an activity.
#[derive(Clone, Debug)]
#[must_use = "a condition alone starts nothing"]
pub struct Waiting(Condition);

impl Waiting {
    /// Begins `next` in the cycle after the one in which the condition holds, once its devices are ready.
    pub fn start(self, next: impl Into<Composite>) -> Composite {
        Self::lead(self.0, false).on_key(Key::Of("yes".to_owned()), next.into())
    }

    /// Begins `yes` if the condition holds in the first cycle, else `no`. A condition over null does not hold.
    pub fn choose(self, yes: impl Into<Composite>, no: impl Into<Composite>) -> Composite {
        let lead = Self::lead(self.0, true);
        let mut chosen = lead.on_key(Key::Of("yes".to_owned()), yes.into());
        let yes = std::mem::replace(&mut chosen.last, vec![vec![0]]);
        let mut chosen = chosen.on_key(Key::Of("no".to_owned()), no.into());
        let of_yes = yes.into_iter().flatten().filter(|part| *part > 0);
        let of_no: Vec<_> = chosen.last.iter().flatten().copied().collect();
        let all: std::collections::BTreeSet<_> = of_yes.chain(of_no).collect();
        chosen.last = vec![all.into_iter().collect()];
        chosen
    }

    fn lead(condition: Condition, is_immediate: bool) -> Composite {
        let order = Order {
            operation: Arc::new(Wait {
                condition,
                is_immediate,
            }),
            speed: Speed::FULL,
            blend: None,
            until: Vec::new(),
            marks: Vec::new(),
            is_checked: true,
        };
        Composite {
            session: None,
            parts: vec![Planned::new(vec![order], When::Follow)],
            last: vec![vec![0]],
            invalid: None,
        }
    }
}

/// A wait without a device.
#[derive(Debug)]
struct Wait {
    condition: Condition,
    /// Whether it decides in its first cycle.
    is_immediate: bool,
}

impl Operation for Wait {
    fn devices(&self) -> Vec<String> {
        Vec::new()
    }

    fn check(&self) -> Result<(), ErrorKind> {
        Ok(())
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let yes = self.condition.latched(net);
        let no = net.of("Core::BooleanNot", &yes);
        let always = net.of_two("Core::BooleanOr", &yes, &no);
        let end: Port = if self.is_immediate {
            always
        } else {
            yes.clone()
        };
        let done = net.of_two("Core::BooleanOr", &end, &requests.stop);
        Ok(Ports {
            done,
            progress: None,
            failures: Vec::<(Failure, Port)>::new(),
            results: vec![("yes", yes), ("no", no)],
            fault: None,
        })
    }
}

impl Composite {
    fn join_session(&mut self, other: &Self) {
        match (&self.session, &other.session) {
            (Some(mine), Some(others)) if !Arc::ptr_eq(mine, others) => {
                self.invalid = Some("activities of different cells cannot begin together");
            }
            (None, Some(others)) => self.session = Some(Arc::clone(others)),
            _ => {}
        }
        self.invalid = self.invalid.or(other.invalid);
    }

    /// Appends parts; returns the number of the first.
    fn append(&mut self, mut next: Self) -> (usize, Vec<Vec<usize>>) {
        self.join_session(&next);
        let by = self.parts.len();
        for part in &mut next.parts {
            part.after
                .iter_mut()
                .flatten()
                .for_each(|number| *number += by);
            part.replaces.iter_mut().for_each(|number| *number += by);
            part.instead_of = part.instead_of.map(|number| number + by);
            part.trigger = part.trigger.take().map(|(number, key)| (number + by, key));
        }
        next.last
            .iter_mut()
            .flatten()
            .for_each(|number| *number += by);
        self.parts.append(&mut next.parts);
        (by, next.last)
    }

    /// Lets `next` follow: all are loaded and scheduled before the first one begins.
    pub fn then(mut self, next: impl Into<Self>) -> Self {
        let before = self.last.clone();
        let (first, last) = self.append(next.into());
        let own: Vec<_> = before.iter().flatten().copied().collect();
        for part in self.parts.iter_mut().skip(first) {
            if part.is_first() {
                part.after.clone_from(&before);
                part.replaces.extend(&own);
            }
        }
        self.last = last;
        self
    }

    /// Lets `next` begin at an event of the last activity, decided by the controller. What is not begun is skipped.
    pub fn on(mut self, event: Event, next: impl Into<Self>) -> Self {
        let key = match event {
            Event::Completed => "completed".to_owned(),
            Event::Stopped(name) => format!("until_{name}"),
            Event::Cancelled => "cancelled".to_owned(),
            Event::Failed => return self.on_key(Key::Failures, next.into()),
            Event::Progress(progress) => {
                let last = self.last.first().and_then(|slot| slot.first()).copied();
                let part = last.and_then(|last| self.parts.get_mut(last));
                let Some(order) = part.and_then(|part| part.orders.first_mut()) else {
                    self.invalid = Some("an event has an activity");
                    return self;
                };
                order.marks.push(progress);
                mark_key(order.marks.len() - 1)
            }
        };
        self.on_key(Key::Of(key), next.into())
    }

    fn on_key(mut self, key: Key, next: Self) -> Self {
        // The activity that the events are those of stays the same one for further events.
        let Some(of) = self.last.first().and_then(|slot| slot.first()).copied() else {
            self.invalid = Some("an event has an activity");
            return self;
        };
        let (first, last) = self.append(next);
        let (before, after) = self.parts.split_at_mut(first);
        for part in after.iter_mut().filter(|part| part.is_first()) {
            let of_part = before.get(of);
            if of_part.is_some_and(|of_part| part.commands_one_of(of_part) || of_part.is_wait()) {
                part.replaces.push(of);
            }
            part.trigger = Some((of, key.clone()));
        }
        let takes_over = after.first().is_some_and(|part| !part.replaces.is_empty());
        if takes_over && let Some(slot) = self.last.first_mut() {
            slot.extend(last.into_iter().flatten());
        }
        self
    }

    /// Lets what begins first begin also if what its devices do before fails or is cancelled.
    pub fn after_failure(mut self) -> Self {
        let firsts = self.parts.iter_mut().filter(|part| part.is_first());
        firsts.for_each(|part| part.after_failure = true);
        self
    }

    /// Begins it, and returns when its first activities run.
    ///
    /// # Errors
    /// If an activity is invalid or rejected, two that begin together have the same device, they belong to different
    /// cells, or what their devices do before fails. Nothing was begun then.
    #[track_caller]
    pub fn begin(self) -> Result<Handle, Error> {
        let handle = self.queue()?;
        handle.wait_for_begin(handle::FOR_EVER).unwrap_or(Ok(()))?;
        Ok(handle)
    }

    /// The same, but does not wait until they run.
    ///
    /// # Errors
    /// As [`Self::begin`].
    #[track_caller]
    pub fn queue(self) -> Result<Handle, Error> {
        let session = self.session()?;
        let stops = session.stops();
        self.compile(&session, false)?.begin(&session, stops)
    }

    /// Plans, writes and loads it, so that [`Prepared::begin`] later is one request for each part; nothing moves. It is to
    /// begin where its arms are now, or where what they do now leaves them.
    ///
    /// # Errors
    /// As [`Self::begin`]. [`ErrorKind::Invalid`] also if an arc or a curve is to begin by `now`: it leads from where the arm
    /// is then.
    #[track_caller]
    pub fn prepare(self) -> Result<Prepared, Error> {
        let session = self.session()?;
        let compiled = self.compile(&session, true)?;
        Ok(Prepared::load(session, compiled)?)
    }

    fn session(&self) -> Result<Arc<Session>, ErrorKind> {
        if let Some(text) = self.invalid {
            return Err(ErrorKind::Invalid(text.to_owned()));
        }
        let none = || ErrorKind::Invalid("there is no activity to begin".to_owned());
        self.session.clone().ok_or_else(none)
    }

    /// Checks what is to be prepared, and begun by `now`.
    fn check_ahead(part: &Planned) -> Result<(), ErrorKind> {
        let mut orders = part.orders.iter();
        let wrong = orders.find(|order| part.when == When::Now && order.operation.needs_start());
        let Some(order) = wrong else {
            return Ok(());
        };
        let device = order.operation.devices().into_iter().next();
        Err(ErrorKind::Invalid(format!(
            "{}: an arc or a curve by `now` cannot be prepared: it leads from where the arm is then\nhint: prepare a line, or begin \
             it without preparation",
            device.unwrap_or_default()
        )))
    }

    /// The parts that are valid: an alternative that is not valid is left out, except the last. `is_ahead`: they begin later
    /// than at once.
    fn compile(&self, session: &Session, is_ahead: bool) -> Result<Compiled, ErrorKind> {
        let mut expected = Begins::new();
        let mut before = Before::new();
        let mut goals: Vec<Vec<Goals>> = Vec::new();
        let mut kept: Vec<usize> = Vec::new();
        let mut parts: Vec<engine::Part> = Vec::new();
        for (number, part) in self.parts.iter().enumerate() {
            let has_alternative = self.parts.iter().any(|p| p.instead_of == Some(number));
            // Where a part that may be skipped begins, and what follows it, is decided on the controller.
            let is_certain =
                part.trigger.is_none() && part.instead_of.is_none() && !has_alternative;
            if !is_certain {
                before.values_mut().for_each(|known| *known = None);
            }
            let orders = part.orders.iter();
            if is_ahead {
                Self::check_ahead(part)?;
            }
            let prepared = orders.map(|order| session.prepare(order, part.when, &before, is_ahead));
            let starts: Vec<_> = match prepared.collect::<Result<Vec<_>, _>>() {
                Ok(prepared) => {
                    let (mut starts, mut ends) = (Vec::new(), Vec::new());
                    for (start, goals, begins) in prepared {
                        starts.push(start);
                        ends.push(goals);
                        if part.is_first() && part.when == When::Follow {
                            expected.extend(begins);
                        }
                    }
                    for (order, ends) in part.orders.iter().zip(&ends) {
                        for device in order.operation.devices() {
                            let end = ends.get(&device).filter(|_| is_certain).cloned();
                            before.insert(device, end);
                        }
                    }
                    goals.push(ends);
                    starts
                }
                Err(_) if has_alternative || self.has_kept_alternative(number, &kept) => continue,
                Err(error) => return Err(error),
            };
            let at = |number: &usize| kept.iter().position(|kept| kept == number);
            let trigger = part.trigger(&kept, &parts);
            if let (Some((of, Key::Of(key))), Some(_)) = (&part.trigger, &trigger) {
                self.check_event(*of, key)?;
            }
            let mut before = part.instead_of;
            while let Some(other) = before.filter(|other| !kept.contains(other)) {
                before = self.parts.get(other).and_then(|other| other.instead_of);
            }
            parts.push(engine::Part {
                starts,
                when: part.when,
                after: part
                    .after
                    .iter()
                    .map(|slot| slot.iter().filter_map(at).collect())
                    .collect(),
                trigger,
                after_failure: part.after_failure,
                instead_of: before.as_ref().and_then(at),
            });
            kept.push(number);
        }
        Ok(Compiled {
            places: self.places(&kept),
            parts,
            goals,
            expected,
        })
    }

    /// Of each part that is kept whether it follows no other one, and the numbers of those whose place it takes.
    fn places(&self, kept: &[usize]) -> Vec<(bool, Vec<usize>)> {
        let parts = kept.iter().filter_map(|number| self.parts.get(*number));
        let place = |part: &Planned| {
            let at = |number: &usize| kept.iter().position(|kept| kept == number);
            (
                part.is_first(),
                part.replaces.iter().filter_map(at).collect(),
            )
        };
        parts.map(place).collect()
    }

    /// Whether an earlier alternative of a part is valid.
    fn has_kept_alternative(&self, number: usize, kept: &[usize]) -> bool {
        let mut before = self.parts.get(number).and_then(|part| part.instead_of);
        while let Some(other) = before {
            if kept.contains(&other) {
                return true;
            }
            before = self.parts.get(other).and_then(|part| part.instead_of);
        }
        false
    }

    /// Checks that the condition that an event names exists.
    fn check_event(&self, of: usize, key: &str) -> Result<(), ErrorKind> {
        let orders = self.parts.get(of).map(|part| part.orders.as_slice());
        let [order] = orders.unwrap_or_default() else {
            let text = "events are those of one activity, not of several that begin together";
            return Err(ErrorKind::Invalid(text.to_owned()));
        };
        let Some(name) = key.strip_prefix("until_") else {
            return Ok(());
        };
        if order.until.iter().any(|(known, _)| known == name) {
            return Ok(());
        }
        let text = format!("no condition `{name}` stops the activity\nhint: add it by `until`");
        Err(ErrorKind::Invalid(text))
    }

    /// Begins it and waits until all of it has ended.
    ///
    /// # Errors
    /// As [`Self::begin`] and [`Handle::wait`].
    #[track_caller]
    pub fn run(self) -> Result<Outcome, Error> {
        self.begin()?.wait()
    }
}

impl Planned {
    /// What starts it, of the parts that are kept.
    fn trigger(&self, kept: &[usize], parts: &[engine::Part]) -> Option<Trigger> {
        let (of, key) = self.trigger.as_ref()?;
        let of = kept.iter().position(|kept| kept == of)?;
        let first = parts.get(of)?.starts.first()?;
        let keys = match key {
            Key::Of(key) => vec![key.clone()],
            Key::Failures => first.failures.iter().map(|f| f.key.clone()).collect(),
        };
        Some(Trigger { part: of, keys })
    }

    fn is_wait(&self) -> bool {
        let mut orders = self.orders.iter();
        orders.all(|order| order.operation.devices().is_empty())
    }
}
