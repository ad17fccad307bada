//! Random programs against a controller in which rules fire and nets end as in a real one.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::*;

/// A controller in which rules fire and nets end as in a real one; it checks what it is asked for.
#[derive(Default)]
struct Controller {
    /// Nets that run, with the device that they command.
    running: BTreeMap<String, String>,
    /// Results of loaded nets.
    results: BTreeMap<String, BTreeSet<String>>,
    devices: BTreeMap<String, String>,
    /// Nets that will not run again.
    ended: BTreeSet<String>,
    rules: VecDeque<(u64, String, Vec<String>, Vec<String>)>,
}

impl Controller {
    fn serve(&mut self, engine: &mut Engine) {
        loop {
            let actions = engine.take_actions();
            if actions.is_empty() {
                return;
            }
            for action in actions {
                match action {
                    Action::Load { activity, net } => {
                        let id = format!("n{}", activity.0);
                        self.devices.insert(id.clone(), net);
                        self.results.insert(id.clone(), BTreeSet::new());
                        engine.loaded(activity, Ok(id));
                    }
                    Action::Schedule {
                        group,
                        condition,
                        stop,
                        start,
                    } => {
                        let is_loaded = |net: &String| self.results.contains_key(net);
                        if !stop.iter().chain(&start).all(is_loaded) {
                            let error = ErrorKind::Refused("invalid netname".to_owned());
                            engine.scheduled(group, Err(error));
                            continue;
                        }
                        self.rules.push_back((group.0, condition, stop, start));
                        engine.scheduled(group, Ok(group.0.to_string()));
                    }
                    Action::Cancel(net) => {
                        if self.running.contains_key(&net) {
                            self.end(engine, &net, "cancelled");
                        }
                    }
                    Action::Unload(net) => {
                        // As a real one, it ignores this for a net that runs.
                        let is_idle = !self.running.contains_key(&net);
                        if is_idle && self.results.remove(&net).is_some() {
                            self.ended.insert(net.clone());
                            self.rules.retain(|(_, _, _, start)| !start.contains(&net));
                            engine.net_state(&net, "UNLOADED", "");
                            self.retire(engine);
                        }
                    }
                }
            }
        }
    }

    fn end(&mut self, engine: &mut Engine, net: &str, result: &str) {
        self.running.remove(net);
        self.ended.insert(net.to_owned());
        self.set(engine, net, result);
        engine.net_state(net, "TERMINATED", "");
        self.retire(engine);
    }

    /// Rules whose condition can never become true any more.
    fn retire(&mut self, engine: &mut Engine) {
        let can_hold = |condition: &str| {
            let literal = |literal: &str| {
                let (net, key) = literal.split_once(".out").unwrap();
                let is_true = |results: &BTreeSet<String>| results.contains(key);
                !self.ended.contains(net) || self.results.get(net).is_some_and(is_true)
            };
            condition == "t"
                || condition.split('&').all(|or| {
                    let inside = or.trim_start_matches('(').trim_end_matches(')');
                    inside.split('|').any(literal)
                })
        };
        let (kept, retired): (VecDeque<_>, VecDeque<_>) = std::mem::take(&mut self.rules)
            .into_iter()
            .partition(|(_, condition, _, _)| can_hold(condition));
        self.rules = kept;
        for (rule, ..) in retired {
            engine.rule_state(&rule.to_string(), "INACTIVE");
        }
    }

    fn set(&mut self, engine: &mut Engine, net: &str, result: &str) {
        if let Some(results) = self.results.get_mut(net) {
            results.insert(result.to_owned());
        }
        engine.value(net, result, "true");
    }

    /// Whether a conjunction of disjunctions holds.
    fn holds(&self, condition: &str) -> bool {
        let literal = |literal: &str| {
            let (net, key) = literal.split_once(".out").unwrap();
            self.results
                .get(net)
                .is_some_and(|results| results.contains(key))
        };
        condition == "t"
            || condition.split('&').all(|or| {
                let inside = or.trim_start_matches('(').trim_end_matches(')');
                inside.split('|').any(literal)
            })
    }

    fn fire(&mut self, engine: &mut Engine) {
        let due = self
            .rules
            .iter()
            .position(|(_, condition, _, _)| self.holds(condition));
        let Some((rule, _, stop, start)) = due.and_then(|at| self.rules.remove(at)) else {
            return;
        };
        for net in stop {
            self.running.remove(&net);
            self.ended.insert(net.clone());
            self.rules.retain(|(_, _, _, start)| !start.contains(&net));
            engine.net_state(&net, "TERMINATED", "stopped by a rule");
        }
        for net in start {
            let device = self.devices[&net].clone();
            let holder = self.running.values().find(|other| **other == device);
            assert_eq!(holder, None, "{net} takes {device} from another net");
            self.running.insert(net.clone(), device);
            engine.net_state(&net, "RUNNING", "");
        }
        engine.rule_state(&rule.to_string(), "FIRED");
        self.retire(engine);
    }
}

#[derive(Clone, Debug)]
enum Step {
    Begin(Vec<usize>, bool),
    /// Parts, each with its device and how it refers to the one before it.
    BeginAll(Vec<(usize, usize)>),
    Cancel(usize),
    Release(usize),
    Fire,
    Blend(usize),
    End(usize, usize),
    Serve,
}

fn step() -> impl Strategy<Value = Step> {
    let devices = proptest::sample::subsequence(vec![0, 1, 2], 1..=2);
    prop_oneof![
        4 => (devices, any::<bool>()).prop_map(|(devices, now)| Step::Begin(devices, now)),
        2 => proptest::collection::vec((0_usize..3, 0_usize..6), 1..4).prop_map(Step::BeginAll),
        1 => (0_usize..20).prop_map(Step::Cancel),
        1 => (0_usize..20).prop_map(Step::Release),
        6 => Just(Step::Fire),
        2 => (0_usize..4).prop_map(Step::Blend),
        3 => (0_usize..4, 0_usize..4).prop_map(|(net, result)| Step::End(net, result)),
        8 => Just(Step::Serve),
    ]
}

/// A part of a call, in one of the relations to the part before it.
fn part(number: usize, device: usize, link: usize) -> Part {
    let mut part = Part::new(vec![start(&device.to_string())], When::Follow);
    part.starts[0].net = device.to_string();
    let trigger = |part: usize, key: &str| {
        let keys = vec![key.to_owned()];
        Some(Trigger { part, keys })
    };
    match (link, number.checked_sub(1)) {
        (1, Some(before)) => part.after = vec![vec![before]],
        (2, Some(_)) => part.trigger = trigger(0, "completed"),
        (3, Some(_)) => part.trigger = trigger(0, "until_touch"),
        (4, Some(before)) => part.instead_of = Some(before),
        (5, _) => part.after_failure = true,
        _ => {}
    }
    part
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    /// Whatever a program does: no net is unloaded while it runs, no device is commanded twice, and once everything has
    /// been cancelled, each activity has ended and nothing is left in the controller.
    #[test]
    fn any_program_leaves_nothing_behind(steps in proptest::collection::vec(step(), 0..80)) {
        const ENDS: [&str; 4] = ["completed", "until_touch", "failed", "cancelled"];
        let mut engine = Engine::default();
        let mut controller = Controller::default();
        let mut ids = Vec::new();
        for step in steps {
            let running = |controller: &Controller, number: usize| {
                controller.running.keys().nth(number).cloned()
            };
            match step {
                Step::Begin(devices, now) => {
                    let starts = devices.iter().map(|device| Start {
                        devices: vec![device.to_string()],
                        net: device.to_string(),
                        loaded: None,
                        is_guarded: false,
                        results: ["completed", "blend", "until_touch"].map(str::to_owned).to_vec(),
                        failures: vec![Failure { key: "failed".to_owned(), error: ErrorKind::DeviceFailed { device: device.to_string(), cause: "fault".to_owned() } }],
                    });
                    let when = if now { When::Now } else { When::Follow };
                    ids.extend(engine.begin(starts.collect(), when).unwrap());
                }
                Step::BeginAll(parts) => {
                    let parts = parts.into_iter().enumerate();
                    let parts = parts.map(|(number, (device, link))| part(number, device, link));
                    ids.extend(engine.begin_all(parts.collect()).unwrap().into_iter().flatten());
                }
                Step::Cancel(number) => {
                    if let Some(id) = ids.get(number) {
                        engine.cancel(*id);
                    }
                }
                Step::Release(number) => {
                    if let Some(id) = ids.get(number) {
                        engine.release(*id);
                    }
                }
                Step::Fire => controller.fire(&mut engine),
                Step::Blend(number) => {
                    if let Some(net) = running(&controller, number) {
                        controller.set(&mut engine, &net, "blend");
                    }
                }
                Step::End(number, result) => {
                    if let Some(net) = running(&controller, number) {
                        controller.end(&mut engine, &net, ENDS[result]);
                    }
                }
                Step::Serve => controller.serve(&mut engine),
            }
        }
        for _ in 0..200 {
            for device in ["0", "1", "2"] {
                engine.cancel_device(device);
            }
            controller.serve(&mut engine);
            controller.fire(&mut engine);
        }
        controller.serve(&mut engine);
        for id in &ids {
            let state = engine.state(*id);
            prop_assert!(state.is_none_or(|state| matches!(state, State::Ended(_))), "{:?} {:?}", id, state);
            engine.release(*id);
        }
        controller.serve(&mut engine);
        prop_assert!(controller.results.is_empty(), "{:?}", controller.results);
        prop_assert!(engine.activities.is_empty() && engine.groups.is_empty() && engine.nets.is_empty());
    }
}
