//! Checks for every primitive of a registry: it can be built with all and with few of its ports
//! connected, handles null as its definition states, and accepts any input. Its results are tested
//! one by one.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::panic,
    reason = "shared by test files of more than one crate that need different parts"
)]

use std::fmt::Write as _;
use std::time::Duration;

use takt_net::definition::{InPort, Parameter, ParameterType};
use takt_net::netcomm::OutStatus;
use takt_net::{
    Definition, Element, Image, Limits, LoadContext, Moment, Nanos, NoDevices, NullRule, Plan,
    Registry, load,
};
use takt_tests::Random;

/// Number of elements of all arrays here, enough for a word of 32 bits.
const SIZE: usize = 32;

const CYCLES: u64 = 5;

/// The source of an in port of the primitive under test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Feed {
    /// A value that is neither null nor at a limit.
    Plain,
    Null,
    /// Written by the test: `in<i>`, and null while `n<i>` is true.
    Driven,
}

fn prefix(element: Element) -> &'static str {
    match element {
        Element::Bool => "Core::Boolean",
        Element::Int => "Core::Int",
        Element::Double => "Core::Double",
        Element::Nanos => "Core::Time",
        Element::Vector => "World::Vector",
        Element::Rotation => "World::Rotation",
        Element::Frame => "World::Frame",
        Element::Twist => "World::Twist",
        Element::Wrench => "World::Wrench",
    }
}

fn plain(port: &InPort) -> &'static str {
    match port.ty.element {
        // Neither nulls the output nor resets the primitive.
        Element::Bool if ["inNull", "inReset"].contains(&port.name) => "false",
        Element::Bool => "true",
        Element::Int | Element::Nanos => "3",
        Element::Double => "0.5",
        Element::Vector => "{x:1,y:2,z:3}",
        Element::Rotation => "{a:0.1,b:0.2,c:0.3}",
        Element::Frame => "{pos:{x:1},rot:{a:0.1}}",
        Element::Twist => "{vel:{x:1},rot:{z:2}}",
        Element::Wrench => "{force:{x:1},torque:{z:2}}",
    }
}

fn list(element: &str) -> String {
    format!("[{}]", [element; SIZE].join(","))
}

/// Children that feed in port number `i`, and the link to them.
fn feed(port: &InPort, i: usize, feed: Feed) -> (String, String) {
    let p = prefix(port.ty.element);
    let null = match feed {
        Feed::Plain => "Value='false'",
        Feed::Null => "Value='true'",
        Feed::Driven => &format!("Key='n{i}'"),
    };
    let null = format!("n{i}=Core::BooleanNetcommIn({null})");
    let null = if feed == Feed::Driven {
        null
    } else {
        null.replace("NetcommIn", "Value")
    };
    let text = plain(port);
    if port.ty.element == Element::Nanos {
        // A sum with a value that is not a number is null.
        let delta = match feed {
            Feed::Plain => "Core::DoubleValue(Value='0')".to_owned(),
            Feed::Null => "Core::DoubleValue(Value='nan')".to_owned(),
            Feed::Driven => format!("Core::DoubleNetcommIn(Key='i{i}')"),
        };
        let add = "Core::TimeAdd(inTime=Core::TimeNet().outValue";
        let children = format!("{null},v{i}={delta},s{i}={add},inDelta=v{i}.outValue)");
        return (children, format!("s{i}.outValue"));
    }
    let (array, size, value) = if port.ty.array {
        ("Array", format!(",Size='{SIZE}'"), list(text))
    } else {
        ("", String::new(), text.to_owned())
    };
    let children = format!(
        "{null},v{i}={p}{array}NetcommIn(Key='i{i}',Value='{value}'),\
         s{i}={p}{array}SetNull(inValue=v{i}.outValue,inNull=n{i}.outValue{size})"
    );
    (children, format!("s{i}.outValue"))
}

/// A net with the primitive under test as `p`, its in ports fed as by `feeds`, and an output for
/// every out port: whether it is null.
fn net(definition: &Definition, feeds: impl Fn(&InPort) -> Option<Feed>) -> String {
    let mut text = String::from("{");
    let mut args = Vec::new();
    for (i, port) in definition.inputs.iter().enumerate() {
        if let Some(how) = feeds(port) {
            let (children, link) = feed(port, i, how);
            write!(text, "{children},").unwrap();
            args.push(format!("{}={link}", port.name));
        }
    }
    if definition.parameters.iter().any(|p| p.name == "Size") {
        args.push(format!("Size='{SIZE}'"));
    }
    write!(text, "p={}({}),", definition.name, args.join(",")).unwrap();
    for (o, port) in definition.outputs.iter().enumerate() {
        let array = if port.ty.array { "Array" } else { "" };
        let (p, name) = (prefix(port.ty.element), port.name);
        if port.ty.element == Element::Nanos {
            // There is no TimeIsNull: null makes the difference null.
            write!(
                text,
                "d{o}=Core::TimeDiff(inFirst=p.{name},inSecond=Core::TimeNet().outValue),\
                 z{o}=Core::DoubleIsNull(inValue=d{o}.outValue),"
            )
        } else {
            write!(text, "z{o}={p}{array}IsNull(inValue=p.{name}),")
        }
        .unwrap();
        write!(
            text,
            "w{o}=Core::BooleanNetcommOut(inValue=z{o}.outValue,Key='w{o}'),"
        )
        .unwrap();
    }
    text + "e=Core::BooleanValue(),outTerminate=e.outValue}"
}

struct Run {
    plan: Plan,
    image: Image,
    cycle: u64,
}

impl Run {
    fn new(registry: &Registry, text: &str) -> Self {
        let context = LoadContext {
            registry,
            devices: &NoDevices,
            period: Duration::from_millis(1),
            limits: Limits::default(),
        };
        let plan = load(text, &context).unwrap_or_else(|r| panic!("{}", r.render("net", text)));
        Self {
            plan,
            image: Image::default(),
            cycle: 0,
        }
    }

    fn step(&mut self) {
        self.cycle += 1;
        let time = Nanos(i64::try_from(self.cycle).unwrap() * 1_000_000);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        self.plan.evaluate(&self.image, moment);
    }

    /// Whether each out port is null.
    fn nulls(&self) -> Vec<bool> {
        let mut words = vec![0; self.plan.outbox().words()];
        self.plan.export(&mut words);
        let watched = self
            .plan
            .outbox()
            .entries()
            .iter()
            .filter(|e| e.key.starts_with("outw"));
        watched
            .map(|entry| {
                assert_eq!(entry.status(&words), OutStatus::Current);
                let mut text = String::new();
                entry.format(&words, &mut text);
                text == "true"
            })
            .collect()
    }
}

/// The primitives that need no device.
fn definitions(registry: &Registry) -> impl Iterator<Item = &Definition> {
    let names_device = |p: &Parameter| p.ty == ParameterType::Text && p.name != "Key";
    let all = registry.definitions().iter();
    all.filter(move |d| !d.parameters.iter().any(names_device))
}

/// Builds every primitive with all ports and with the required ones alone, and runs it.
pub fn can_be_built(registry: &Registry) {
    for definition in definitions(registry) {
        let all = net(definition, |_| Some(Feed::Plain));
        let few = net(definition, |port| port.required.then_some(Feed::Plain));
        for text in [all, few] {
            let mut run = Run::new(registry, &text);
            (0..CYCLES).for_each(|_| run.step());
        }
    }
}

/// One null input makes all outputs null where the definition says so. An output that is not null
/// without it shows that the input was the reason. Control inputs are left out.
pub fn null_propagates(registry: &Registry) {
    let mut shown = 0;
    for definition in definitions(registry) {
        if definition.null != NullRule::Propagates || definition.outputs.is_empty() {
            continue;
        }
        let mut run = Run::new(registry, &net(definition, |_| Some(Feed::Plain)));
        (0..CYCLES).for_each(|_| run.step());
        shown += usize::from(run.nulls().contains(&false));
        for null in &definition.inputs {
            if null.name == "inReset" {
                continue;
            }
            let feeds = |port: &InPort| {
                let is_null = port.name == null.name;
                Some(if is_null { Feed::Null } else { Feed::Plain })
            };
            let mut run = Run::new(registry, &net(definition, feeds));
            for cycle in 1..=CYCLES {
                run.step();
                let nulls = run.nulls();
                assert!(
                    !nulls.contains(&false),
                    "{} with null at {}: {nulls:?} in cycle {cycle}",
                    definition.name,
                    null.name
                );
            }
        }
    }
    assert!(shown > 50, "only {shown} primitives give a value at all");
}

/// Values at limits or without meaning.
const fn nasty(element: Element) -> &'static [&'static str] {
    match element {
        Element::Bool => &["true", "false"],
        Element::Int => &["0", "-1", "1", "2147483647", "-2147483648", "1000"],
        Element::Double | Element::Nanos => &[
            "0", "-0", "1", "-1", "0.002", "nan", "+inf", "-inf", "1e308", "-1e308", "1e-320",
            "9.2e9", "-9.2e9",
        ],
        Element::Vector => &[
            "{}",
            "{x:1}",
            "{x:nan}",
            "{y:+inf,z:-inf}",
            "{x:1e308,y:1e308}",
        ],
        Element::Rotation => &["{}", "{a:3.14159}", "{b:1.5707963267948966}", "{c:nan}"],
        Element::Frame => &[
            "{}",
            "{pos:{x:+inf}}",
            "{pos:{x:1e308},rot:{a:3}}",
            "{rot:{b:nan}}",
        ],
        Element::Twist => &["{}", "{vel:{x:nan}}", "{rot:{z:+inf}}", "{rot:{z:1e308}}"],
        Element::Wrench => &["{}", "{force:{x:nan}}", "{torque:{z:+inf}}"],
    }
}

/// Feeds every primitive `cycles` random inputs, null among them; overflow checks are on.
pub fn survives_anything(registry: &Registry, cycles: usize) {
    with_anything(registry, cycles, |_, step| step());
}

/// As [`survives_anything`]; `around` is called with the primitive's name and must make the step.
pub fn with_anything(
    registry: &Registry,
    cycles: usize,
    mut around: impl FnMut(&str, &mut dyn FnMut()),
) {
    let mut random = Random::new(1);
    for definition in definitions(registry) {
        let mut run = Run::new(registry, &net(definition, |_| Some(Feed::Driven)));
        let inbox = run.plan.inbox().clone();
        for _ in 0..cycles {
            let mut words: Vec<u64> = run.plan.inbox_words().collect();
            for (i, port) in definition.inputs.iter().enumerate() {
                let values = nasty(port.ty.element);
                let value = values[random.below(values.len())];
                let value = if port.ty.array {
                    list(value)
                } else {
                    value.to_owned()
                };
                let null = if random.below(8) == 0 {
                    "true"
                } else {
                    "false"
                };
                for (key, text) in [
                    (format!("ini{i}"), value.as_str()),
                    (format!("inn{i}"), null),
                ] {
                    let entry = inbox.find(&key).unwrap();
                    entry.write(text, &mut words).unwrap();
                }
            }
            run.plan.import(&words);
            around(&definition.name, &mut || run.step());
        }
    }
}
