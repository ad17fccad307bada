//! Values that pass from net to net: two plans, and the copies between their boxes that an executor
//! makes.

mod common;

use common::{Bench, PERIOD};
use takt_net::netcomm::NetBoxes;
use takt_net::{ArmBinding, Devices, Image, Limits, LoadContext, Moment, Plan, Registry, load};

/// A controller with one net, `rpinet0`, and no devices.
struct One(NetBoxes);

impl Devices for One {
    fn arm(&self, _name: &str) -> Option<ArmBinding> {
        None
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }

    fn net(&self, name: &str) -> Option<NetBoxes> {
        (name == "rpinet0").then(|| self.0.clone())
    }
}

fn load_beside(text: &str, other: &Plan) -> Result<Bench, Vec<String>> {
    let boxes = NetBoxes {
        inbox: other.inbox().clone(),
        outbox: other.outbox().clone(),
    };
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &One(boxes),
        period: PERIOD,
        limits: Limits::default(),
    };
    let plan = load(text, &context).map_err(|rejection| rejection.lines(text))?;
    Ok(Bench {
        plan,
        image: Image::default(),
        moment: Moment::default(),
    })
}

fn outbox(plan: &Plan) -> Vec<u64> {
    plan.outbox_words().collect()
}

/// Every type with an example value.
const VALUES: [(&str, &str); 8] = [
    ("Core::Boolean", "true"),
    ("Core::Int", "-7"),
    ("Core::Double", "0.1"),
    ("World::Vector", "{x:1,y:2,z:3}"),
    ("World::Rotation", "{a:0,b:-0,c:0}"),
    ("World::Frame", "{pos:{x:1,y:2,z:3},rot:{a:0,b:-0,c:0}}"),
    ("World::Twist", "{vel:{x:1,y:2,z:3},rot:{x:4,y:5,z:6}}"),
    (
        "World::Wrench",
        "{force:{x:1,y:2,z:3},torque:{x:4,y:5,z:6}}",
    ),
];

const NEVER: &str = "never=Core::BooleanValue(),outTerminate=never.outValue";

#[test]
fn every_type_and_null_is_read_between_nets() {
    for (ty, value) in VALUES {
        for (array, value) in [
            ("", value.to_owned()),
            ("Array", format!("[{value},{value}]")),
        ] {
            let size = if array.is_empty() { "" } else { ",Size='2'" };
            let mut giver = Bench::new(&format!(
                "{{v={ty}{array}NetcommIn(Key='v',Value='{value}'),\
                 n=Core::BooleanNetcommIn(Key='null'),\
                 s={ty}{array}SetNull(inValue=v.outValue,inNull=n.outValue{size}),\
                 o={ty}{array}NetcommOut(inValue=s.outValue,Key='k'),{NEVER}}}"
            ));
            let mut reader = load_beside(
                &format!(
                    "{{i={ty}{array}InterNetcommIn(RemoteNet='rpinet0',RemoteKey='k'),\
                     t=Core::TimeDiff(inFirst=i.outLastUpdated,inSecond=i.outLastUpdated),\
                     z=Core::DoubleNetcommOut(inValue=t.outValue,Key='t'),\
                     o={ty}{array}NetcommOut(inValue=i.outValue,Key='v'),{NEVER}}}"
                ),
                &giver.plan,
            )
            .unwrap();
            let inter = reader.plan.inter_ins()[0].clone();
            let pass = |giver: &Bench, reader: &mut Bench| {
                reader.plan.import_inter(&inter, Some(&outbox(&giver.plan)));
                reader.cycle();
                (reader.out("v"), reader.out("t"))
            };
            let null = ("null".to_owned(), "null".to_owned());
            assert_eq!(
                pass(&giver, &mut reader),
                null,
                "{ty} before the first cycle"
            );
            giver.cycle();
            let there = (value.clone(), "0".to_owned());
            assert_eq!(pass(&giver, &mut reader), there, "{ty}{array}");
            giver.write("null", "true");
            giver.cycle();
            assert_eq!(pass(&giver, &mut reader), null, "{ty}{array}");
            giver.write("null", "false");
            giver.cycle();
            assert_eq!(pass(&giver, &mut reader), there, "{ty}{array}");
            // The other net no longer exists.
            assert!(reader.plan.import_inter(&inter, None));
            reader.cycle();
            assert_eq!(reader.out("v"), "null");
        }
    }
}

#[test]
fn every_type_is_written_between_nets_on_change() {
    for (ty, value) in VALUES {
        for (array, value) in [
            ("", value.to_owned()),
            ("Array", format!("[{value},{value}]")),
        ] {
            let start = if array.is_empty() {
                String::new()
            } else {
                format!(",Value='{value}'")
                    .replace(['1', '7', '5'], "2")
                    .replace("true", "false")
            };
            let mut taker = Bench::new(&format!(
                "{{i={ty}{array}NetcommIn(Key='k'{start}),\
                 o={ty}{array}NetcommOut(inValue=i.outValue,Key='v'),{NEVER}}}"
            ));
            let mut giver = load_beside(
                &format!(
                    "{{v={ty}{array}NetcommIn(Key='v',Value='{value}'),\
                     o={ty}{array}InterNetcommOut(inValue=v.outValue,RemoteNet='rpinet0',RemoteKey='ink'),\
                     {NEVER}}}"
                ),
                &taker.plan,
            )
            .unwrap();
            let inter = giver.plan.inter_outs()[0].clone();
            let mut seen = None;
            let mut pass = |giver: &Bench, taker: &Bench| {
                taker
                    .plan
                    .import_given(&inter, &outbox(&giver.plan), &mut seen)
            };
            assert!(
                !pass(&giver, &taker),
                "no value is written before the first cycle"
            );
            giver.cycle();
            assert!(pass(&giver, &taker));
            taker.cycle();
            assert_eq!(taker.out("v"), value);
            giver.cycle();
            assert!(!pass(&giver, &taker), "an unchanged value is written once");
        }
    }
}

#[test]
fn program_and_net_write_same_inbox() {
    let mut taker = Bench::new(&format!(
        "{{a=Core::IntNetcommIn(Key='a'),b=Core::IntNetcommIn(Key='b'),\
         s=Core::IntAdd(inFirst=Core::IntMultiply(inFirst=a.outValue,Second='10').outValue,inSecond=b.outValue),\
         o=Core::IntNetcommOut(inValue=s.outValue,Key='v'),{NEVER}}}"
    ));
    let mut giver = load_beside(
        &format!(
            "{{v=Core::IntValue(Value='4'),o=Core::IntInterNetcommOut(inValue=v.outValue,\
             RemoteNet='rpinet0',RemoteKey='a'),{NEVER}}}"
        ),
        &taker.plan,
    )
    .unwrap();
    let mut seen_words: Vec<u64> = taker.plan.inbox_words().collect();
    let mut program = seen_words.clone();
    giver.cycle();
    let inter = giver.plan.inter_outs()[0].clone();
    assert!(
        taker
            .plan
            .import_given(&inter, &outbox(&giver.plan), &mut None)
    );
    // The program's box still holds the old `a`; writing `b` must not restore it.
    let entry = taker.plan.inbox().find("inb").unwrap().clone();
    entry.write("2", &mut program).unwrap();
    taker.plan.import_changes(&program, &mut seen_words);
    taker.cycle();
    assert_eq!(taker.out("v"), "42");
}

#[test]
fn missing_remote_value_is_reported_with_location() {
    let other = Bench::new(&format!(
        "{{i=Core::IntNetcommIn(Key='i'),a=Core::DoubleArrayNetcommIn(Key='a',Value='[1,2]'),\
         o=Core::IntNetcommOut(inValue=i.outValue,Key='o'),{NEVER}}}"
    ));
    let faults = |child: &str| {
        let loaded = load_beside(&format!("{{x={child},{NEVER}}}"), &other.plan);
        loaded.map(|_| ()).unwrap_err().join("\n")
    };
    for (child, expected) in [
        (
            "Core::IntInterNetcommIn(RemoteNet='rpinet9',RemoteKey='o')",
            "there is no net `rpinet9` here",
        ),
        (
            "Core::IntInterNetcommIn(RemoteNet='rpinet0',RemoteKey='p')",
            "has no value `outp`",
        ),
        (
            "Core::DoubleInterNetcommIn(RemoteNet='rpinet0',RemoteKey='o')",
            "is of type Core::int, not Core::double",
        ),
        (
            "Core::DoubleInterNetcommOut(RemoteNet='rpinet0',RemoteKey='i')",
            "is of type Core::int, not Core::double",
        ),
        (
            "Core::DoubleArrayInterNetcommOut(inValue=Core::DoubleArray(Size='3').outArray,\
             RemoteNet='rpinet0',RemoteKey='a')",
            "that value has 2 elements, the source has 3",
        ),
    ] {
        let found = faults(child);
        assert!(found.contains(expected), "{child}: {found}");
    }
}
