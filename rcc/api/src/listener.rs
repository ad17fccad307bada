//! Listeners: a program is called when a number or a condition of the controller changes. One net evaluates the expression, and
//! a thread of its own calls the program, so that a callback that is slow, fails or waits disturbs no other. Not here: reactions of
//! robots; these are conditions of activities, which the controller evaluates in its cycle.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, Location, catch_unwind};
use std::sync::Arc;

use crate::error::{Error, ErrorKind};
use crate::expression::{Condition, Number};
use crate::net::{Net, Port};
use crate::session::Session;
use crate::slot::Shared;

/// What a program can listen to: a [`Number`] or a [`Condition`].
pub trait Expression {
    /// Its value in a callback.
    type Value: Clone + PartialEq + Send + 'static;

    /// The net that evaluates it.
    #[doc(hidden)]
    fn watching_net(&self) -> String;

    /// Its value by the out values of that net, once they are known.
    #[doc(hidden)]
    fn value_of(values: &BTreeMap<String, String>) -> Option<Self::Value>;
}

/// `None` while a device does not know it.
impl Expression for Number {
    type Value = Option<f64>;

    fn watching_net(&self) -> String {
        let mut net = Net::default();
        let value = self.write(&mut net);
        let report = [("inValue", (&value).into()), ("Key", "value".into())];
        net.add("Core::DoubleNetcommOut", report);
        // A value that becomes null is reported no more.
        let unknown = net.of("Core::DoubleIsNull", &value);
        net.result("unknown", &unknown);
        finish(net)
    }

    fn value_of(values: &BTreeMap<String, String>) -> Option<Option<f64>> {
        if values.get("outunknown")? == "true" {
            return Some(None);
        }
        Some(Some(values.get("outvalue")?.parse().ok()?))
    }
}

/// Untrue while a device does not know what it depends on.
impl Expression for Condition {
    type Value = bool;

    fn watching_net(&self) -> String {
        let mut net = Net::default();
        let value = self.write(&mut net);
        let known = net.known(&value);
        net.result("value", &known);
        finish(net)
    }

    fn value_of(values: &BTreeMap<String, String>) -> Option<bool> {
        Some(values.get("outvalue")? == "true")
    }
}

fn finish(mut net: Net) -> String {
    let cancel: Port = net.add("Cancel", []).out("outCancel");
    net.finish(&cancel)
}

/// Calls of the program at each change of an expression, until it is dropped.
///
/// Booleans are reported at their change, numbers every 10 ms while they change. A callback that takes longer misses the values
/// in between, [`Self::missed`]; it is always called with the latest one. A callback that panics is not called again, and
/// [`Self::error`] has its message; the panic is printed as any other. When the listener is dropped, at most the call in
/// progress is completed.
#[derive(Debug)]
#[must_use = "a listener that is dropped ends"]
pub struct Listener {
    session: Arc<Session>,
    net: String,
    shared: Arc<Shared>,
    /// Where the program began to listen.
    place: &'static Location<'static>,
}

impl Listener {
    #[track_caller]
    pub(crate) fn start<E: Expression>(
        session: &Arc<Session>,
        expression: &E,
        callback: impl FnMut(E::Value) + Send + 'static,
    ) -> Result<Self, ErrorKind> {
        let place = Location::caller();
        let shared = Arc::new(Shared::default());
        let net = session.listen(&expression.watching_net(), &shared)?;
        let listener = Self {
            session: Arc::clone(session),
            net,
            shared: Arc::clone(&shared),
            place,
        };
        // Its net is unloaded if there is no thread.
        let thread = std::thread::Builder::new().name("takt-listener".to_owned());
        let spawned = thread.spawn(move || call_each::<E>(&shared, callback));
        spawned
            .map_err(|error| ErrorKind::Connection(format!("cannot start a thread: {error}")))?;
        Ok(listener)
    }

    /// How many values were replaced by later ones before the callback was called with them.
    pub fn missed(&self) -> u64 {
        self.shared.missed()
    }

    /// Why it has ended by itself: [`ErrorKind::Callback`], [`ErrorKind::Lost`], or [`ErrorKind::Ended`] if its net was ended on
    /// the controller. It names the line that began to listen.
    pub fn error(&self) -> Option<Error> {
        let kind = self.shared.error()?;
        let place = self.place;
        Some(Error { kind, place })
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.shared.close();
        self.session.unlisten(&self.net);
    }
}

/// Body of the thread of a listener.
fn call_each<E: Expression>(shared: &Shared, mut callback: impl FnMut(E::Value)) {
    let mut last = None;
    while let Some(values) = shared.next() {
        let value = E::value_of(&values);
        if value.is_none() || value == last {
            continue;
        }
        last.clone_from(&value);
        let call = AssertUnwindSafe(|| value.into_iter().for_each(&mut callback));
        if let Err(panic) = catch_unwind(call) {
            return shared.fail(&ErrorKind::Callback(message(&*panic)));
        }
    }
}

/// The message of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| Some((*panic.downcast_ref::<&str>()?).to_owned()));
    text.unwrap_or_else(|| "it panicked".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(key: &str, text: &str) -> impl Iterator<Item = (String, String)> {
        std::iter::once((key.to_owned(), text.to_owned()))
    }

    #[test]
    fn listener_slot_keeps_latest_and_counts_missed() {
        let shared = Shared::default();
        for text in ["1", "2", "3"] {
            shared.update(one("outvalue", text));
        }
        let values = shared.next().unwrap();
        assert_eq!(values["outvalue"], "3");
        assert_eq!(shared.missed(), 2);
        shared.update(one("outvalue", "4"));
        assert_eq!(shared.missed(), 2, "the slot was empty");
        shared.close();
        assert_eq!(shared.next(), None, "nothing after its end");
    }

    #[test]
    fn listener_panic_ends_it_with_message() {
        let shared = Shared::default();
        shared.update(one("outvalue", "true"));
        let quiet: fn(bool) = |_| std::panic::resume_unwind(Box::new("wrong".to_owned()));
        call_each::<Condition>(&shared, quiet);
        assert_eq!(
            shared.error(),
            Some(ErrorKind::Callback("wrong".to_owned()))
        );
        shared.end("");
        assert!(matches!(shared.error(), Some(ErrorKind::Callback(_))));
    }

    #[test]
    fn listener_is_called_with_changes_only() {
        let shared = Arc::new(Shared::default());
        let (sender, seen) = std::sync::mpsc::channel();
        let theirs = Arc::clone(&shared);
        let calls = move || call_each::<Number>(&theirs, move |value| sender.send(value).unwrap());
        let thread = std::thread::spawn(calls);
        for (key, text) in [
            ("outunknown", "false"),
            ("outvalue", "0"),
            ("outvalue", "0"),
            ("outvalue", "1.5"),
            ("outunknown", "true"),
        ] {
            shared.update(one(key, text));
            while shared.is_new() {
                std::thread::yield_now();
            }
        }
        // The thread has taken the last value; it calls before it waits again.
        let seen: Vec<_> = seen.iter().take(3).collect();
        shared.close();
        thread.join().unwrap();
        assert_eq!(seen, [Some(0.0), Some(1.5), None]);
    }
}
