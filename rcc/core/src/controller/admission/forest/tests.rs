//! What nets come to together under rules given as text, with weights in microseconds.

use proptest::prelude::*;

use super::*;
use crate::controller::rules::condition::Parser;
use crate::executor::rules::{Literal, NetActions};

/// A rule as its condition, the nets that it stops and those that it starts.
type Given<'t> = (&'t str, &'t [u32], &'t [u32]);

fn succession((condition, stop, start): Given<'_>, in_one_thread: bool) -> Succession {
    let condition = Parser::parse(condition).unwrap();
    let literals = condition.literals.iter().map(|(net, key)| Literal {
        net: net.trim_start_matches('n').parse().unwrap(),
        question: match key.as_str() {
            "terminated" => Question::Terminated,
            key => Question::Value(key.bytes().map(usize::from).sum()),
        },
        value: None,
        last: false,
    });
    let rule = Rule::new(
        0,
        literals.collect(),
        condition.steps,
        NetActions::default(),
    );
    let ids = |nets: &[u32]| nets.iter().copied().map(NetId).collect::<Vec<_>>();
    Succession::of(&rule, &ids(stop), &ids(start), in_one_thread)
}

/// Nets with their weights by number, and those of them that run.
fn nets(weights: &[u64], running: &[u32]) -> BTreeMap<NetId, Candidate> {
    let candidate = |(id, weight): (u32, &u64)| {
        let candidate = Candidate {
            weight: *weight,
            runs: running.contains(&id),
            resources: ResourceSet::default(),
        };
        (NetId(id), candidate)
    };
    (0..).zip(weights).map(candidate).collect()
}

fn most_of(nets: &BTreeMap<NetId, Candidate>, rules: &[Given<'_>]) -> u64 {
    let rules: Vec<_> = rules.iter().map(|rule| succession(*rule, true)).collect();
    most_together(nets, rules.iter().collect(), 0)
}

fn most(weights: &[u64], running: &[u32], rules: &[Given<'_>]) -> u64 {
    most_of(&nets(weights, running), rules)
}

// Successors.

#[test]
fn idle_net_weighs_nothing() {
    assert_eq!(most(&[100, 30], &[0], &[]), 100);
    assert_eq!(most(&[100, 30], &[0], &[("n1.x", &[], &[])]), 100);
}

#[test]
fn successor_adds_nothing_to_its_predecessor() {
    assert_eq!(most(&[100, 30], &[0], &[("n0.terminated", &[], &[1])]), 100);
    assert_eq!(most(&[30, 100], &[0], &[("n0.x", &[0], &[1])]), 100);
    assert_eq!(
        most(&[30, 100], &[0], &[("n0.x & n0.terminated", &[], &[1])]),
        100
    );
}

#[test]
fn stopped_net_counts_unless_running() {
    let rules: [Given<'_>; 2] = [("n0.terminated", &[], &[1]), ("t", &[1], &[2])];
    assert_eq!(most(&[10, 50, 20], &[0], &rules), 70);
    assert_eq!(most(&[10, 50, 20], &[1], &rules[1..]), 50);
}

#[test]
fn concurrent_net_adds_its_weight() {
    for condition in ["n0.x", "t", "n0.x | n0.terminated", "!n0.terminated"] {
        assert_eq!(
            most(&[100, 30], &[0], &[(condition, &[], &[1])]),
            130,
            "{condition}"
        );
    }
}

#[test]
fn chain_weighs_its_heaviest_net() {
    let chain: [Given<'_>; 3] = [
        ("n0.terminated", &[], &[1]),
        ("n1.terminated", &[], &[2]),
        ("n2.terminated", &[], &[3]),
    ];
    for running in [&[][..], &[0]] {
        assert_eq!(most(&[10, 50, 20, 40], running, &chain), 50);
    }
    // Started by hand, a net of it runs beside the first.
    assert_eq!(most(&[10, 50, 20, 40], &[0, 2], &chain), 90);
}

#[test]
fn successor_of_several_replaces_all() {
    let joined: [Given<'_>; 1] = [("n0.terminated & n1.terminated", &[], &[2])];
    assert_eq!(most(&[400, 400, 800], &[0, 1], &joined), 800);
    assert_eq!(most(&[400, 400, 700], &[0, 1], &joined), 800);
}

#[test]
fn several_successors_of_one_add_up() {
    assert_eq!(
        most(&[100, 60, 70], &[0], &[("n0.terminated", &[], &[1, 2])]),
        130
    );
}

#[test]
fn circular_waiting_nets_count_once() {
    let circle: [Given<'_>; 2] = [("n0.terminated", &[], &[1]), ("n1.terminated", &[], &[0])];
    assert_eq!(most(&[10, 30], &[], &circle), 30);
    assert_eq!(most(&[10, 30], &[0], &circle), 30);
}

// Rules that fit one by one.

#[test]
fn compatible_rules_count_both() {
    let both: [Given<'_>; 2] = [("n0.terminated", &[], &[1]), ("n0.x", &[0], &[2])];
    assert_eq!(most(&[500, 300, 600], &[0], &both), 900);
}

#[test]
fn exclusive_rules_count_the_heavier() {
    let chosen: [Given<'_>; 3] = [
        ("n0.terminated & n0.x", &[], &[1]),
        ("n0.terminated & !n0.x & n0.y", &[], &[2]),
        ("n0.terminated & !(n0.x | n0.y)", &[], &[3]),
    ];
    assert_eq!(most(&[500, 300, 700, 600], &[0], &chosen), 700);
    let stopped: [Given<'_>; 2] = [("n0.x & !n0.y", &[0], &[1]), ("n0.y", &[0], &[2])];
    assert_eq!(most(&[500, 300, 600], &[0], &stopped), 600);
}

#[test]
fn changeable_values_exclude_nothing() {
    // Net 0 is stopped by one of them only; net 3 runs on and may say either.
    let one_sided: [Given<'_>; 2] = [("n0.x", &[0], &[1]), ("!n0.x", &[], &[2])];
    assert_eq!(most(&[500, 300, 600], &[0], &one_sided), 1100);
    let foreign: [Given<'_>; 2] = [("n3.x", &[0], &[1]), ("!n3.x", &[0], &[2])];
    assert_eq!(most(&[500, 300, 600, 0], &[0, 3], &foreign), 900);
}

#[test]
fn stopped_net_values_may_change_across_threads() {
    let given: [Given<'_>; 2] = [("n0.x", &[0], &[1]), ("!n0.x", &[0], &[2])];
    let rules = given.map(|rule| succession(rule, false));
    let nets = nets(&[500, 300, 600], &[0]);
    assert_eq!(most_together(&nets, rules.iter().collect(), 0), 900);
}

#[test]
fn nets_with_common_resource_are_alternatives() {
    let mut nets = nets(&[500, 300, 600, 50], &[0]);
    for id in [1, 2] {
        nets.get_mut(&NetId(id)).unwrap().resources.insert(7);
    }
    let rules: [Given<'_>; 3] = [
        ("n0.terminated", &[], &[1]),
        ("n0.x", &[0], &[2]),
        ("n1.terminated", &[], &[3]),
    ];
    assert_eq!(most_of(&nets, &rules[..2]), 600);
    // The successor of one of them does without it, and so runs beside the other.
    assert_eq!(most_of(&nets, &rules), 900);
    nets.get_mut(&NetId(3)).unwrap().resources.insert(7);
    assert_eq!(most_of(&nets, &rules), 600);
}

#[test]
fn net_started_by_two_rules_counts_once() {
    let either: [Given<'_>; 2] = [("n0.x", &[0], &[2]), ("n1.x", &[1], &[2])];
    assert_eq!(most(&[10, 20, 300], &[0, 1], &either), 330);
    let same: [Given<'_>; 2] = [("n0.x", &[0], &[2]), ("n0.y", &[0], &[2])];
    assert_eq!(most(&[10, 20, 300], &[0, 1], &same), 320);
}

#[test]
fn sum_within_bound_skips_search() {
    let rule = succession(("n0.terminated", &[], &[1]), true);
    let nets = nets(&[100, 30], &[0]);
    assert_eq!(most_together(&nets, vec![&rule], 130), 130);
    assert_eq!(most_together(&nets, vec![&rule], 129), 100);
}

#[test]
fn many_rules_are_bounded_from_above() {
    let nets = nets(&[10; 1001], &[0]);
    let conditions: Vec<_> = (1..=1000)
        .map(|id| {
            (
                format!("n0.terminated & {}n0.x", if id % 2 == 0 { "!" } else { "" }),
                [id],
            )
        })
        .collect();
    let rules: Vec<Given<'_>> = conditions
        .iter()
        .map(|(c, id)| (&**c, &[][..], &id[..]))
        .collect();
    let most = most_of(&nets, &rules);
    assert!((5_000..=10_000).contains(&most), "{most}");
}

/// A rule about one net, as the executor sees it.
#[derive(Clone, Copy, Debug)]
struct Simple {
    /// The net of its condition.
    after: u32,
    start: u32,
    /// Whether it stops that net; else the net has to end by itself.
    stops: bool,
    /// The value of the net that it needs, if any.
    needs: Option<bool>,
}

impl Simple {
    fn succession(self) -> Succession {
        let Self { after, start, .. } = self;
        let value = self
            .needs
            .map(|value| format!("{}n{after}.x", if value { "" } else { "!" }));
        let end = (!self.stops).then(|| format!("n{after}.terminated"));
        let literals: Vec<_> = end.into_iter().chain(value).collect();
        let condition = if literals.is_empty() {
            "t".to_owned()
        } else {
            literals.join(" & ")
        };
        let stop = if self.stops { vec![after] } else { vec![] };
        succession((&condition, &stop, &[start]), true)
    }
}

/// Fires rules in some order, each once, as the executor does, and returns the most that ran at once. In each turn
/// the net of a rule gives out a value, and ends by itself if the rule waits for that.
fn played(weights: &[u64], rules: &[Simple], turns: &[(usize, bool)]) -> u64 {
    let mut waiting = vec![true; rules.len()];
    let mut running = BTreeSet::from([0_u32]);
    let (mut gone, mut ended_by_itself) = (BTreeSet::new(), BTreeSet::new());
    let mut values = BTreeMap::new();
    let mut most = 0;
    for (at, value) in turns.iter().map(|(at, value)| (at % rules.len(), *value)) {
        let rule = rules[at];
        if running.contains(&rule.after) {
            values.insert(rule.after, value);
        }
        if !rule.stops && running.remove(&rule.after) {
            ended_by_itself.insert(rule.after);
            gone.insert(rule.after);
        }
        let holds = (rule.stops || ended_by_itself.contains(&rule.after))
            && rule
                .needs
                .is_none_or(|needed| values.get(&rule.after) == Some(&needed));
        if waiting[at] && holds && !gone.contains(&rule.start) && !running.contains(&rule.start) {
            waiting[at] = false;
            if running.remove(&rule.after) {
                gone.insert(rule.after);
            }
            running.insert(rule.start);
        }
        let load = running.iter().map(|net| weights[*net as usize]).sum();
        most = most.max(load);
    }
    most
}

fn simple() -> impl Strategy<Value = Simple> {
    let parts = (0..6_u32, 1..6_u32, any::<bool>(), any::<Option<bool>>());
    let rule = parts.prop_map(|(after, start, stops, needs)| Simple {
        after,
        start,
        stops,
        needs,
    });
    rule.prop_filter("a net that follows itself", |rule| rule.after != rule.start)
}

proptest! {
    #[test]
    fn no_firing_order_exceeds_bound(
        weights in prop::collection::vec(1..100_u64, 6),
        rules in prop::collection::vec(simple(), 1..8),
        turns in prop::collection::vec((0..8_usize, any::<bool>()), 0..16),
    ) {
        let successions: Vec<_> = rules.iter().map(|rule| rule.succession()).collect();
        let bound = most_together(&nets(&weights, &[0]), successions.iter().collect(), 0);
        prop_assert!(played(&weights, &rules, &turns) <= bound);
    }
}
