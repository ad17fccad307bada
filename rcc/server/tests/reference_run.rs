//! What was seen by running the original, sentence by sentence, and what this server does then. Each case is an exchange
//! in the format of `transcripts/README.md`; a line `original` is a deviation that stays, whose reason is in the README
//! of this crate.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]

mod common;
#[path = "common/replay.rs"]
mod replay;

use replay::{Transport, replay};

/// A sentence, and an exchange that shows it.
type Case = (&'static str, &'static str);

/// Replays cases, each against a server of its own.
fn holds(cases: &[Case]) {
    const HANDSHAKE: &str = "open c\nc >> v=ver(\"2.0\")\nc << v=ok(\"handshake ok\")\n";
    for (sentence, exchange) in cases {
        let text = format!("{HANDSHAKE}{exchange}");
        replay(sentence, &text, Transport::WebSocket, None);
    }
}

/// An arm of seven joints, as the known client makes it.
macro_rules! lwr {
    () => {
        "http >> POST //devices/ name=lwr1&type=kuka_lwr_sim&min_joint=[-2.9,-2.0,-2.9,-2.0,-2.9,-2.0,-2.9]&\
         max_joint=[2.9,2.0,2.9,2.0,2.9,2.0,2.9]&max_vel=[1.9,1.9,2.2,2.2,3.5,3.2,3.2]&\
         max_acc=[7.5,7.5,9.0,9.0,14.0,13.0,13.0]\nhttp << 201\n"
    };
}

/// A net that sets its result after the time and never ends by itself.
macro_rules! lasting {
    ($seconds:literal) => {
        concat!(
            "{c=Core::Clock(),g=Core::DoubleGreater(inFirst=c.outValue,Second='",
            $seconds,
            "'),r=Core::BooleanNetcommOut(inValue=g.outValue,Key='r0'),f=Core::BooleanValue(),outTerminate=f.outValue}"
        )
    };
}

#[test]
fn messages_and_loading_are_those_of_the_original() {
    holds(&[
        (
            "a reply has the tag of its command, a push that of its subscription",
            "c >> x7=gde()\nc << x7=da({rcc:{interfaces:{},type:\"rcc\"}})\nc << x7=ds({rcc:\"op\"})\nc << x7=ok()\n",
        ),
        (
            "loading answers with a name even if the net is rejected; only state and resource show it",
            "c >> a=nene(\"{a=Core::Nope(),outTerminate=a.outValue}\",\"s0\",\"x\",0.0,1)\nc << a=ok(\"rpinet0\")\n\
             c >> b=gne(\"rpinet0\",0.1)\nc << b=ns(\"REJECTED\")\nc << b=ok()\n\
             http >> GET /nets/rpinet0/\nhttp << 200\n\
             http <<   <errorState major=\"1\" minor=\"2\" block=\"\">1:4: there is no primitive `Core::Nope`<text></errorState>\n",
        ),
        (
            "integer and float are different types",
            "c >> a=nene(\"{a=Core::BooleanValue(),outTerminate=a.outValue}\",\"s0\",\"x\",1,1)\n\
             c << a=err(\"Parameter type does not match\")\n",
        ),
        (
            "the net that asks for the end of a READY net gets it: TERMINATED",
            concat!(
                "c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=gne(\"rpinet0\",0.1)\nc << b=ns(\"READY\")\nc << b=ok()\n\
             c >> d=neab(\"rpinet0\")\nc << b=ns(\"TERMINATED\")\nc << d=ok()\n"
            ),
        ),
        (
            "unloading a RUNNING net is ignored",
            concat!(
                "c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nest(\"rpinet0\")\nc << b=ok()\nc >> d=neun(\"rpinet0\")\nc << d=ok()\n\
             c >> e=gne(\"rpinet0\",60.0)\nc << e=ns(\"RUNNING\")\nc << e=ok()\n"
            ),
        ),
        (
            "unloading a net in CANCELLING kills it",
            concat!(
                "original kills it; here it may still bring its devices to rest\n\
             c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nest(\"rpinet0\")\nc << b=ok()\nc >> d=neca(\"rpinet0\")\nc << d=ok()\n\
             c >> e=neun(\"rpinet0\")\nc << e=<text>\n\
             c >> f=gne(\"rpinet0\",60.0)\nc << f=<text>\nc << f=<text>\n"
            ),
        ),
    ]);
}

#[test]
fn rules_are_those_of_the_original() {
    holds(&[
        (
            "a syntactically wrong condition ends the process",
            "original ended the process; a client must not be able to\n\
             c >> a=nesc(\"a b c\",[],[],[],\"bad\")\nc << a=err(\"scheduling not possible\",\"<text>\")\n",
        ),
        (
            "a rule whose net ends without its condition stays ACTIVE for ever",
            concat!(
                "original ACTIVE for ever, and the net to start SCHEDULED; a condition that cannot hold any more is INACTIVE\n\
             c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nene(\"",
                lasting!("9"),
                "\")\nc << b=ok(\"rpinet1\")\n\
             c >> d=nesc(\"rpinet0.outr0\",[],[],[\"rpinet1\"])\nc << d=ok(\"0\")\n\
             c >> e=gsy(\"0\")\nc << e=rs(\"ACTIVE\")\nc << e=ok()\n\
             c >> f=nest(\"rpinet0\")\nc << f=ok()\n\
             c <& e=rs(\"INACTIVE\")\nc >> g=neab(\"rpinet0\")\nc << g=ok()\nc <&\n"
            ),
        ),
        (
            "an immediate start is a rule that has FIRED; only unknown rules are errors",
            concat!(
                "c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nest(\"rpinet0\")\nc << b=ok()\n\
             c >> d=gsy(\"0\")\nc << d=rs(\"FIRED\")\nc << d=ok()\n\
             c >> e=gsy(\"1\")\nc << e=err(\"Invalid synchronization rule\")\n"
            ),
        ),
        (
            "a successor's clock begins with one period: there is no cycle between two nets",
            concat!(
                "c >> a=nene(\"",
                lasting!("0.02"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nene(\"{c=Core::Clock(),t=Core::BooleanValue(Value='true'),e=Core::EdgeDetection(inValue=t.outValue),\
             s=Core::DoubleSnapshot(inSnapshot=e.outValue,inValue=c.outValue),\
             o=Core::DoubleNetcommOut(inValue=s.outValue,Key='first'),f=Core::BooleanValue(),outTerminate=f.outValue}\")\n\
             c << b=ok(\"rpinet1\")\n\
             c >> d=gne(\"rpinet1\",60.0)\nc << d=ns(\"READY\")\nc << d=ok()\n\
             c >> e=nesc(\"rpinet0.outr0\",[\"rpinet0\"],[],[\"rpinet1\"])\n\
             c << d=ns(\"SCHEDULED\")\nc << e=ok(\"0\")\n\
             c >> f=nest(\"rpinet0\")\nc << f=ok()\n\
             c << d=ns(\"RUNNING\")\nc << d=nc({outfirst:\"0.001\"})\n"
            ),
        ),
        (
            "a second net that commands a joint: the start answers ok, the rule is FIREFAILED",
            concat!(
                lwr!(),
                "original ok although nothing starts; here the reply has the cause\n\
             c >> a=nene(\"{m=RobotArm::JointMonitor(Robot='lwr1',Axis='0'),j=RobotArm::JointPosition(inPosition=m.outCommandedPosition,\
             Robot='lwr1',Axis='0'),f=Core::BooleanValue(),outTerminate=f.outValue}\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nene(\"{m=RobotArm::JointMonitor(Robot='lwr1',Axis='0'),j=RobotArm::JointPosition(inPosition=m.outCommandedPosition,\
             Robot='lwr1',Axis='0'),f=Core::BooleanValue(),outTerminate=f.outValue}\")\nc << b=ok(\"rpinet1\")\n\
             c >> d=nest(\"rpinet0\")\nc << d=ok()\n\
             c >> e=nest(\"rpinet1\")\nc << e=err(\"net start failed\",\"<text>\",{holder:\"net rpinet0 of session s0\",resource:\"lwr1_Joint_0\"})\n"
            ),
        ),
    ]);
}

#[test]
fn values_are_those_of_the_original_where_stated() {
    holds(&[
        (
            "Snapshot ignores its Value until a reset",
            "original 0, a defect: its start hook is never called\n\
             http >> POST /eval/ dionet={b=Core::BooleanValue(),v=Core::DoubleValue(Value='1'),\
             s=Core::DoubleSnapshot(inSnapshot=b.outValue,inValue=v.outValue,Value='42'),outS=s.outValue}\n\
             http << 200\nhttp <<   <data key=\"outS\">42</data>\n",
        ),
        (
            "null plus one is one, not null",
            "original 1, the stale value; here null propagates, as in the second implementation of the original's authors\n\
             http >> POST /eval/ dionet={t=Core::BooleanValue(Value='true'),v=Core::DoubleValue(Value='5'),\
             n=Core::DoubleSetNull(inValue=v.outValue,inNull=t.outValue),a=Core::DoubleAdd(inFirst=n.outValue,Second='1'),\
             i=Core::DoubleIsNull(inValue=a.outValue),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">true</data>\n",
        ),
        (
            "And with null takes its parameter's default, true",
            "original true; here it is the logic of three values\n\
             http >> POST /eval/ dionet={t=Core::BooleanValue(Value='true'),n=Core::BooleanSetNull(inValue=t.outValue,inNull=t.outValue),\
             a=Core::BooleanAnd(inFirst=n.outValue,inSecond=t.outValue),i=Core::BooleanIsNull(inValue=a.outValue),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">true</data>\n",
        ),
        (
            "the outputs of an inactive fragment are null",
            "http >> POST /eval/ dionet={b=Core::BooleanValue(),f={c=Core::DoubleValue(Value='1'),outV=c.outValue}(inActive=b.outValue),\
             i=Core::DoubleIsNull(inValue=f.outV),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">true</data>\n",
        ),
        (
            "an index beyond an array ends the thread, and the net stays RUNNING for ever",
            "original ended the thread; sizes are checked at load here\n\
             c >> a=nene(\"{a=Core::DoubleArray(Size='3'),g=Core::DoubleArrayGet(inArray=a.outArray,Size='3',Index='7'),\
             f=Core::BooleanValue(),outTerminate=f.outValue}\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=gne(\"rpinet0\",0.1)\nc << b=ns(\"REJECTED\")\nc << b=ok()\n",
        ),
        (
            "a net of a shorter period than its executor's runs too slowly",
            "original ran it five times too slow, silently\n\
             c >> a=nene(\"{f=Core::BooleanValue(),outTerminate=f.outValue}\",\"s0\",\"\",0.0005,1)\nc << a=ok(\"rpinet0\")\n\
             c >> b=gne(\"rpinet0\",0.1)\nc << b=ns(\"REJECTED\")\nc << b=ok()\n",
        ),
        (
            "a joint position out of range: outError is 1, and nothing is commanded",
            concat!(
                lwr!(),
                "http >> POST /eval/ dionet={p=Core::DoubleValue(Value='9'),\
             j=RobotArm::JointPosition(inPosition=p.outValue,Robot='lwr1',Axis='0'),outE=j.outError}\n\
             http << 200\nhttp <<   <data key=\"outE\">1</data>\n"
            ),
        ),
    ]);
}

#[test]
fn known_client_finds_what_it_relies_on() {
    holds(&[
        (
            "nets for an evaluation have no outTerminate",
            concat!(
                lwr!(),
                "http >> POST //eval/ dionet={m=RobotArm::JointMonitor(Robot='lwr1',Axis='3'),\
             o=Core::DoubleNetcommOut(inValue=m.outCommandedPosition,Key='d0')}\n\
             http << 200\nhttp <<   <data key=\"outd0\">0</data>\n"
            ),
        ),
        (
            "device names are any text",
            "http >> POST //devices/ name=Test device Lwr4&type=kuka_lwr_sim&min_joint=[-1,-1,-1,-1,-1,-1,-1]&\
             max_joint=[1,1,1,1,1,1,1]&max_vel=[1,1,1,1,1,1,1]&max_acc=[1,1,1,1,1,1,1]\nhttp << 201\n\
             c >> d=gde()\nc << d=da({\"Test device Lwr4\":{<text>\nc << d=ds({\"Test device Lwr4\":\"<text>\nc << d=ok()\n\
             http >> POST /eval/ dionet={m=RobotArm::JointMonitor(Robot='Test device Lwr4',Axis='0'),outP=m.outCommandedPosition}\n\
             http << 200\nhttp <<   <data key=\"outP\">0</data>\n",
        ),
        (
            "a rotation by zero is the identity about any axis, zero and -0 included",
            "http >> POST /eval/ dionet={z=Core::DoubleValue(Value='-0'),v=World::VectorFromXYZ(inX=z.outValue,inY=z.outValue,inZ=z.outValue),\
             a=Core::DoubleValue(Value='0'),r=World::RotationFromAxisAngle(inAxis=v.outValue,inAngle=a.outValue),\
             i=World::RotationIsNull(inValue=r.outValue),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">false</data>\n",
        ),
        (
            "a rotation by more about the zero axis is null",
            "http >> POST /eval/ dionet={z=Core::DoubleValue(),v=World::VectorFromXYZ(inX=z.outValue,inY=z.outValue,inZ=z.outValue),\
             a=Core::DoubleValue(Value='1'),r=World::RotationFromAxisAngle(inAxis=v.outValue,inAngle=a.outValue),\
             i=World::RotationIsNull(inValue=r.outValue),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">true</data>\n",
        ),
        (
            "TimeDiff with unconnected ports is null, and the net is not refused",
            "http >> POST /eval/ dionet={d=Core::TimeDiff(),i=Core::DoubleIsNull(inValue=d.outValue),outNull=i.outValue}\n\
             http << 200\nhttp <<   <data key=\"outNull\">true</data>\n",
        ),
        (
            "the youBot stands upright at zero, and a projected pose is reached",
            "http >> POST //devices/ name=arm&type=kuka_youbot_arm_sim&min_joint=[-2.9,-1.1,-2.6,-1.7,-2.8]&\
             max_joint=[2.9,1.5,2.5,1.7,2.8]&max_vel=[1,1,1,1,1]&max_acc=[1,1,1,1,1]\nhttp << 201\n\
             http >> POST /eval/ dionet={j=Core::DoubleArray(Size='5'),k=ArmKinematics::Kin(inJoints=j.outArray,Robot='arm'),\
             p=KUKA::youBot::PositionPreservingProject(inFlange=k.outFrame),\
             i=ArmKinematics::InvKin(inFrame=p.outValue,inHintJoints=j.outArray,Robot='arm'),\
             g=Core::DoubleArrayGet(inArray=i.outJoints,Size='5',Index='0'),n=Core::DoubleIsNull(inValue=g.outValue),\
             outF=k.outFrame,outNone=n.outValue,outJ=g.outValue}\n\
             http << 200\nhttp <<   <data key=\"outF\">{pos:{x:0.033,y:<number>,z:0.608<text>\n\
             http <<   <data key=\"outJ\"><number></data>\n",
        ),
    ]);
}

#[test]
fn known_client_finds_results_and_statistics() {
    holds(&[
        (
            "statistics of a net have its root module first, with times of evaluation and latency in ms",
            concat!(
                "c >> a=nene(\"",
                lasting!("9"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             http >> GET /nets/rpinet0/stats\nhttp << 200\nhttp << <stats>\nhttp <<   <module name=\"ROOT\">\n\
             http <<     <exec min=\"<number>\" average=\"<number>\" <text> total=\"<number>\"/>\n\
             http <<     <latency min=\"<number>\" average=\"<number>\" <text>\n"
            ),
        ),
        (
            "a net ends by its own rule only; a chain on a net that has ended fires at once, from values that are kept",
            concat!(
                "c >> a=nene(\"",
                lasting!("0.0"),
                "\")\nc << a=ok(\"rpinet0\")\n\
             c >> b=nene(\"",
                lasting!("9"),
                "\")\nc << b=ok(\"rpinet1\")\n\
             c >> d=nesc(\"rpinet0.outr0\",[\"rpinet0\"],[],[])\nc << d=ok(\"0\")\n\
             c >> e=gsy(\"0\")\nc << e=rs(\"ACTIVE\")\nc << e=ok()\n\
             c <& e=rs(\"FIRED\")\nc >> f=nesc(\"t\",[],[],[\"rpinet0\"])\nc << f=ok(\"1\")\nc <&\n\
             c >> g=nesc(\"rpinet0.outr0\",[\"rpinet0\"],[],[\"rpinet1\"])\nc << g=ok(\"2\")\n\
             c >> h=nesc(\"t\",[\"rpinet1\"],[],[])\nc << h=ok(\"3\")\n"
            ),
        ),
    ]);
}
