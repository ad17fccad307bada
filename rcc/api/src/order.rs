//! What an activity is to do, as the net that the controller executes: an [`Operation`] writes its own part, and every
//! net has the same rest: its end, its results, the conditions that stop it, and the place from which a successor may
//! take over. A new kind of operation is a type of its own; nothing here changes for it.

use std::fmt::Debug;
use std::sync::Arc;

use crate::engine::{FITS, Failure, Start};
use crate::error::ErrorKind;
use crate::expression::Condition;
use crate::motion::ArmDescription;
use crate::net::{Net, Port};
use crate::plan::Plan;
use crate::preparation::{Begin, Begins, Goals};

/// Most conditions that stop one activity.
const UNTIL_MAX: usize = 32;

/// What an activity does with its devices.
pub(crate) trait Operation: Debug + Send + Sync {
    /// Names of the devices that it commands, each once; none for a mere wait. The first names it in errors.
    fn devices(&self) -> Vec<String>;

    /// Checks all that can be checked without the controller.
    fn check(&self) -> Result<(), ErrorKind>;

    /// The arms that it moves.
    fn arms(&self) -> Vec<&ArmDescription> {
        Vec::new()
    }

    /// Whether its net depends on where the arms are when it begins.
    fn needs_begins(&self) -> bool {
        true
    }

    /// Whether its path is that from where the arms begin, also where they move then.
    fn needs_start(&self) -> bool {
        false
    }

    /// Checks that its arms can follow, from where they begin; returns where it leaves them, as far as known.
    fn follow(&self, _begins: &Begins, _speed: f64) -> Result<Goals, ErrorKind> {
        Ok(Goals::new())
    }

    /// Plans it.
    fn plan(&self, _begins: &Begins, _speed: f64) -> Result<Plan, ErrorKind> {
        Err(ErrorKind::Unplanned {
            device: self.devices().into_iter().next().unwrap_or_default(),
            cause: "it has no path that is known before it runs".to_owned(),
        })
    }

    /// Writes what it does into a net.
    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind>;
}

/// What an operation is requested to do in each cycle.
#[derive(Debug)]
pub(crate) struct Requests<'a> {
    /// Whether it is to brake and end: it is cancelled, or a condition has held.
    pub(crate) stop: Port,
    /// Speed as part of the limits, above 0 to 1.
    pub(crate) speed: f64,
    /// Where the arms are when it begins, as far as known.
    pub(crate) begins: &'a Begins,
}

/// Where an operation is in each cycle.
#[derive(Debug)]
pub(crate) struct Ports {
    /// Whether it has ended: at its goal, or at rest after a stop.
    pub(crate) done: Port,
    /// Completed part, 0 to 1. Without it the operation cannot be blended.
    pub(crate) progress: Option<Port>,
    /// Why it fails. The net ends in the cycle in which one of the ports is true; the first in order is reported.
    pub(crate) failures: Vec<(Failure, Port)>,
    /// Further results from which a successor may take over, with their keys. `maintaining`: it reached its goal and
    /// keeps it up.
    pub(crate) results: Vec<(&'static str, Port)>,
    /// Whether it fails and still brakes: no successor takes over any more, and its end is no completion.
    pub(crate) fault: Option<Port>,
}

/// A speed as part of the limits: a product of factors that slow, each above 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Speed {
    product: f64,
    /// The first factor out of its bounds.
    wrong: Option<f64>,
}

impl Speed {
    /// As fast as the limits permit.
    pub(crate) const FULL: Self = Self {
        product: 1.0,
        wrong: None,
    };

    /// Slower by a factor. One factor never makes up for another: each is checked.
    #[must_use]
    pub(crate) fn times(self, factor: f64) -> Self {
        let product = self.product * factor;
        let is_right = factor > 0.0 && factor <= 1.0 && product > 0.0;
        Self {
            product,
            wrong: self.wrong.or_else(|| (!is_right).then_some(factor)),
        }
    }

    pub(crate) const fn factor(self) -> f64 {
        self.product
    }

    /// The first factor that is out of its bounds.
    pub(crate) const fn wrong(self) -> Option<f64> {
        self.wrong
    }
}

/// An operation with what every activity can have.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    pub(crate) operation: Arc<dyn Operation>,
    pub(crate) speed: Speed,
    /// Progress (part of the path, 0 to 1) from which a successor may take over.
    pub(crate) blend: Option<f64>,
    /// Conditions that stop it on its path, by name; the first that holds decides.
    pub(crate) until: Vec<(String, Condition)>,
    /// Progress from which on a result is true that may start another activity, 0 to below 1.
    pub(crate) marks: Vec<f64>,
    /// Whether its path is checked before its net is loaded.
    pub(crate) is_checked: bool,
}

/// The key of the result of a mark.
pub(crate) fn mark_key(number: usize) -> String {
    format!("mark_{number}")
}

impl Order {
    /// What the engine begins; the order is checked.
    pub(crate) fn compile(&self, begins: &Begins) -> Result<Start, ErrorKind> {
        self.compile_with(begins, &[])
    }

    /// The same for an order that is begun later: its net begins only if its arms are then where they are expected.
    pub(crate) fn compile_ahead(&self, begins: &Begins) -> Result<Start, ErrorKind> {
        let arms = self.operation.arms();
        let needed = arms
            .into_iter()
            .filter(|_| self.operation.needs_begins())
            .filter_map(|arm| Some((arm, begins.get(&arm.name)?)));
        self.compile_with(begins, &needed.collect::<Vec<_>>())
    }

    fn compile_with(
        &self,
        begins: &Begins,
        expected: &[(&ArmDescription, &Begin)],
    ) -> Result<Start, ErrorKind> {
        let mut net = Net::default();
        let cancel = net.add("Cancel", []).out("outCancel");
        let until = self.until.iter();
        let met: Vec<_> = until.map(|(_, until)| until.latched(&mut net)).collect();
        let stops: Vec<_> = std::iter::once(cancel.clone()).chain(met.clone()).collect();
        let stop = net.any(&stops).unwrap_or_else(|| cancel.clone());
        let requests = Requests {
            stop: stop.clone(),
            speed: self.speed.factor(),
            begins,
        };
        let mut ports = self.operation.write(&mut net, &requests)?;
        let moved = expected.iter().filter_map(|(arm, begin)| {
            let moved = arm.is_elsewhere(&mut net, &begin.joints)?;
            Some((Failure::moved(&arm.name), moved))
        });
        let moved: Vec<_> = moved.collect();
        let elsewhere: Vec<_> = moved.iter().map(|(_, port)| port.clone()).collect();
        if let Some(elsewhere) = net.any(&elsewhere) {
            let fits = net.of("Core::BooleanNot", &elsewhere);
            let first = net.first_cycle();
            let begins = net.of_two("Core::BooleanAnd", &first, &fits);
            let latched = [("inOn", (&begins).into())];
            let latched = net.add("Core::Trigger", latched).out("outActive");
            net.result(FITS, &latched);
        }
        ports.failures.splice(0..0, moved);
        let failing: Vec<_> = ports
            .failures
            .iter()
            .map(|(_, port)| port.clone())
            .collect();
        let halted: Vec<_> = std::iter::once(stop)
            .chain(failing)
            .chain(ports.fault.clone())
            .collect();
        let halted = net.any(&halted).unwrap_or_else(|| cancel.clone());
        // No successor takes over in the cycle in which the activity fails.
        let going = net.of("Core::BooleanNot", &halted);
        let ended = net.of_two("Core::BooleanAnd", &ports.done, &going);
        net.result("completed", &ended);
        let cancelled = net.of_two("Core::BooleanAnd", &ports.done, &cancel);
        net.result("cancelled", &cancelled);
        let mut results = vec!["completed".to_owned()];
        results.extend(self.blend(&mut net, &ports, &going)?);
        results.extend(self.report_conditions(&mut net, &ports.done, &cancel, &met));
        for (key, port) in &ports.results {
            let open = net.of_two("Core::BooleanAnd", port, &going);
            net.result(key, &open);
            results.push((*key).to_owned());
        }
        let mut ends = Vec::new();
        let mut failures = Vec::new();
        for (failure, port) in ports.failures {
            net.result(&failure.key, &port);
            ends.push(port);
            failures.push(failure);
        }
        ends.push(ports.done);
        let end = net.any(&ends).unwrap_or(cancel);
        Ok(Start {
            devices: self.operation.devices(),
            net: net.finish(&end),
            loaded: None,
            is_guarded: !expected.is_empty(),
            results,
            failures,
        })
    }

    /// The result from which a successor may take over in motion; reports the progress.
    fn blend(
        &self,
        net: &mut Net,
        ports: &Ports,
        going: &Port,
    ) -> Result<Option<String>, ErrorKind> {
        let Some(progress) = &ports.progress else {
            let text = "it has no progress, so that `blend` and `Event::Progress` have no meaning";
            return if self.blend.is_some() || !self.marks.is_empty() {
                Err(self.invalid(text))
            } else {
                Ok(None)
            };
        };
        for (number, mark) in self.marks.iter().enumerate() {
            let far = [("inFirst", progress.into()), ("Second", (*mark).into())];
            let far = net.add("Core::DoubleGreater", far).out("outValue");
            net.result(&mark_key(number), &far);
        }
        let report = [("inValue", progress.into()), ("Key", "progress".into())];
        net.add("Core::DoubleNetcommOut", report);
        let Some(blend) = self.blend else {
            return Ok(None);
        };
        let far = [("inFirst", progress.into()), ("Second", blend.into())];
        let far = net.add("Core::DoubleGreater", far).out("outValue");
        let moving = net.of("Core::BooleanNot", &ports.done);
        let open = net.of_two("Core::BooleanAnd", &moving, going);
        let may = net.of_two("Core::BooleanAnd", &far, &open);
        net.result("blend", &may);
        Ok(Some("blend".to_owned()))
    }

    /// One result for each condition that stops the motion; the first in order wins, and a cancel before all.
    fn report_conditions(
        &self,
        net: &mut Net,
        done: &Port,
        cancel: &Port,
        met: &[Port],
    ) -> Vec<String> {
        let mut before = cancel.clone();
        let report = |((name, _), met): (&(String, Condition), &Port)| {
            let first = net.of("Core::BooleanNot", &before);
            let at_rest = net.of_two("Core::BooleanAnd", done, met);
            let decides = net.of_two("Core::BooleanAnd", &at_rest, &first);
            let key = format!("until_{name}");
            net.result(&key, &decides);
            before = net.of_two("Core::BooleanOr", &before, met);
            key
        };
        self.until.iter().zip(met).map(report).collect()
    }

    fn invalid(&self, what: &str) -> ErrorKind {
        let device = self.operation.devices().into_iter().next();
        let name = device.unwrap_or_else(|| "wait".to_owned());
        ErrorKind::Invalid(format!("{name}: {what}"))
    }

    /// Checks all that can be checked without the controller.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] and [`ErrorKind::Limit`], which name the argument, its value and its bounds.
    pub(crate) fn check(&self) -> Result<(), ErrorKind> {
        self.operation.check()?;
        if let Some(wrong) = self.speed.wrong() {
            let text = format!("the speed is {wrong}; it is above 0, at most 1");
            return Err(self.invalid(&text));
        }
        if let Some(blend) = self.blend.filter(|blend| !(0.0..1.0).contains(blend)) {
            return Err(self.invalid(&format!("blend is {blend}; it is from 0 to below 1")));
        }
        if let Some(mark) = self.marks.iter().find(|mark| !(0.0..1.0).contains(*mark)) {
            let text = format!("an event is at progress {mark}; it is from 0 to below 1");
            return Err(self.invalid(&text));
        }
        let count = self.until.len().max(self.marks.len());
        if count > UNTIL_MAX {
            return Err(self.invalid(&format!("{count} conditions; at most {UNTIL_MAX}")));
        }
        for (number, (name, _)) in self.until.iter().enumerate() {
            let is_letter = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
            if name.is_empty() || !name.bytes().all(is_letter) {
                let text = format!("`{name}` is no name of a condition: letters, digits and `_`");
                return Err(self.invalid(&text));
            }
            let before = self.until.get(..number).unwrap_or_default();
            if before.iter().any(|(other, _)| other == name) {
                return Err(self.invalid(&format!("two conditions are called `{name}`")));
            }
        }
        Ok(())
    }
}

/// The net of an operation that is checked first.
#[cfg(test)]
pub(crate) fn text_of(operation: impl Operation + 'static) -> Result<String, ErrorKind> {
    let order = Order {
        operation: Arc::new(operation),
        speed: Speed::FULL.times(0.5),
        blend: None,
        until: Vec::new(),
        marks: Vec::new(),
        is_checked: true,
    };
    order.check()?;
    Ok(order.compile(&Begins::new())?.net)
}

#[cfg(test)]
mod tests {
    use super::Speed;

    #[test]
    fn speed_factor_never_makes_up_for_another() {
        let half = Speed::FULL.times(0.5);
        assert_eq!(half.times(0.5).factor().to_bits(), 0.25_f64.to_bits());
        assert_eq!(half.times(1.0).wrong(), None);
        assert_eq!(half.times(2.0).wrong(), Some(2.0), "0.5 and 2 are not 1");
        assert_eq!(half.times(2.0).times(0.1).wrong(), Some(2.0));
        for wrong in [0.0, -0.5, f64::INFINITY] {
            assert_eq!(half.times(wrong).wrong(), Some(wrong));
        }
        assert!(half.times(f64::NAN).wrong().is_some());
        assert!(Speed::FULL.times(1e-200).times(1e-200).wrong().is_some());
    }
}
