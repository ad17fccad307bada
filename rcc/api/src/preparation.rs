//! What precedes the net of an activity: where its arms will be when it begins, and whether they can follow from there.
//! An activity begins where the one before it ends, or at the joint positions that are commanded.

use std::collections::BTreeMap;

use crate::engine::{ActivityId, Start, When};
use crate::error::ErrorKind;
use crate::motion::{ArmDescription, ELSEWHERE};
use crate::order::Order;
use crate::session::Session;

/// Where an arm is when an activity begins.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Begin {
    /// Positions of its joints, rad.
    pub(crate) joints: Vec<f64>,
    /// Their velocities, rad/s.
    pub(crate) velocities: Vec<f64>,
    /// Whether it is at rest there; else it moves on until the activity takes over.
    pub(crate) is_at_rest: bool,
}

impl Begin {
    /// At rest.
    pub(crate) fn at_rest(joints: Vec<f64>) -> Self {
        Self {
            velocities: vec![0.0; joints.len()],
            joints,
            is_at_rest: true,
        }
    }
}

/// Where arms are when an activity begins, by their names, as far as known.
pub(crate) type Begins = BTreeMap<String, Begin>;

/// Where activities leave arms, by their names, as far as known: joint positions, rad.
pub(crate) type Goals = BTreeMap<String, Vec<f64>>;

/// Where earlier parts of a call leave arms, by their names: joint positions, rad, or not known.
pub(crate) type Before = BTreeMap<String, Option<Vec<f64>>>;

/// Where the latest activity of each arm leaves it.
#[derive(Debug, Default)]
pub(crate) struct KnownGoals(BTreeMap<String, (ActivityId, Vec<f64>)>);

impl KnownGoals {
    /// Records where an activity leaves its devices. What is known of other activities of these devices expires.
    pub(crate) fn record(&mut self, id: ActivityId, devices: &[String], mut goals: Goals) {
        for device in devices {
            match goals.remove(device) {
                Some(goal) => drop(self.0.insert(device.clone(), (id, goal))),
                None => drop(self.0.remove(device)),
            }
        }
    }

    fn of(&self, device: &str, id: ActivityId) -> Option<Vec<f64>> {
        let (known, goal) = self.0.get(device)?;
        (*known == id).then(|| goal.clone())
    }
}

impl Session {
    /// Checks an order, plans it as far as needed, and writes its net.
    ///
    /// `before`: where earlier parts of the same call leave arms; `None` where that is not known. `is_ahead`: it is begun
    /// later than at once.
    pub(crate) fn prepare(
        &self,
        order: &Order,
        when: When,
        before: &Before,
        is_ahead: bool,
    ) -> Result<(Start, Goals, Begins), ErrorKind> {
        order.check()?;
        let begins = if order.operation.needs_begins() {
            self.begins(order, when, before)?
        } else {
            Begins::new()
        };
        let goals = order.operation.follow(&begins, order.speed.factor());
        let goals = match goals {
            Err(_) if !order.is_checked => Goals::new(),
            goals => goals?,
        };
        let start = if is_ahead {
            order.compile_ahead(&begins)?
        } else {
            order.compile(&begins)?
        };
        Ok((start, goals, begins))
    }

    /// The arm of which it is known that it will not be where an activity was prepared for: the one that it follows leaves it
    /// elsewhere.
    pub(crate) fn leaves_elsewhere(&self, expected: &Begins) -> Option<String> {
        let is_elsewhere = |(name, begin): &(&String, &Begin)| {
            let Some(latest) = self.engine().latest(name) else {
                return false;
            };
            let Some(goal) = self.goals().of(name, latest) else {
                return true;
            };
            let mut pairs = goal.iter().zip(&begin.joints);
            pairs.any(|(goal, joint)| (goal - joint).abs() > ELSEWHERE)
        };
        let mut arms = expected.iter().filter(is_elsewhere);
        arms.next().map(|(name, _)| name.clone())
    }

    /// Where the arms of an order are when it begins.
    pub(crate) fn begins(
        &self,
        order: &Order,
        when: When,
        before: &Before,
    ) -> Result<Begins, ErrorKind> {
        let mut begins = Begins::new();
        for arm in order.operation.arms() {
            if let Some(joints) = before.get(&arm.name) {
                let begin = joints.clone().map(Begin::at_rest);
                begins.extend(begin.map(|begin| (arm.name.clone(), begin)));
                continue;
            }
            let latest = self.engine().latest(&arm.name);
            let begin = match latest {
                Some(id) if when == When::Follow => {
                    self.goals().of(&arm.name, id).map(Begin::at_rest)
                }
                Some(_) => self.moving(arm)?,
                None => self
                    .joints(arm, "outCommandedPosition")?
                    .map(Begin::at_rest),
            };
            begins.extend(begin.map(|begin| (arm.name.clone(), begin)));
        }
        Ok(begins)
    }

    /// Reads a port of all joints of an arm, rad; `None` if they are not known.
    pub(crate) fn joints(
        &self,
        arm: &ArmDescription,
        port: &str,
    ) -> Result<Option<Vec<f64>>, ErrorKind> {
        let [joints] = self.read(arm, [port])?;
        Ok(joints)
    }

    /// Where an arm is commanded that may move.
    fn moving(&self, arm: &ArmDescription) -> Result<Option<Begin>, ErrorKind> {
        let ports = ["outCommandedPosition", "outCommandedVelocity"];
        let [joints, velocities] = self.read(arm, ports)?;
        let begin = |joints: Vec<f64>| Begin {
            velocities: velocities.unwrap_or_else(|| vec![0.0; joints.len()]),
            joints,
            is_at_rest: false,
        };
        Ok(joints.map(begin))
    }

    fn read<const N: usize>(
        &self,
        arm: &ArmDescription,
        ports: [&str; N],
    ) -> Result<[Option<Vec<f64>>; N], ErrorKind> {
        let values = self.evaluate(&arm.reader(&ports))?;
        let mut letters = ["q", "v"].into_iter();
        Ok(ports.map(|_| {
            let letter = letters.next()?;
            let joint = |axis: usize| values.get(&format!("out{letter}{axis}"))?.parse().ok();
            (0..arm.joints.len()).map(joint).collect()
        }))
    }
}
