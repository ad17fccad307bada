//! The behaviour of running nets: order, null, fragments, Pre, termination, exchange. Single
//! primitives are tested in `primitives.rs`, error texts in `faults.rs`.

mod common;

use common::Bench;

#[test]
fn values_pass_through_net_in_one_cycle() {
    let mut net = Bench::watching(
        "Core::Double",
        "c=Core::DoubleAdd(inFirst=b.outValue,Second='1'),\
         b=Core::DoubleMultiply(inFirst=a.outValue,Second='3'),a=Core::DoubleValue(Value='2')",
        "c.outValue",
    );
    assert_eq!(net.series(1), ["7"]);
}

#[test]
fn null_propagates() {
    let mut net = Bench::watching(
        "Core::Double",
        "t=Core::BooleanValue(Value='true'),n=Core::DoubleSetNull(inValue=x.outValue,\
         inNull=t.outValue),x=Core::DoubleValue(),s=Core::DoubleAdd(inFirst=n.outValue,Second='1')",
        "s.outValue",
    );
    assert_eq!(net.series(2), ["null", "null"]);
}

#[test]
fn pre_closes_cycle_and_starts_null() {
    let mut net = Bench::watching(
        "Core::Double",
        "p=Core::DoublePre(inValue=s.outValue),z=Core::DoubleIsNull(inValue=p.outValue),\
         l=Core::DoubleConditional(inCondition=z.outValue,True='10',inFalse=p.outValue),\
         s=Core::DoubleAdd(inFirst=l.outValue,Second='1')",
        "s.outValue",
    );
    assert_eq!(net.series(3), ["11", "12", "13"]);
}

#[test]
fn path_may_leave_and_reenter_fragment() {
    let mut net = Bench::watching(
        "Core::Double",
        "f={a=Core::DoubleAdd(inFirst=parent.inX,Second='1'),\
         b=Core::DoubleAdd(inFirst=parent.inY,Second='1'),outA=a.outValue,outB=b.outValue}\
         (inX=v.outValue,inY=m.outValue),\
         m=Core::DoubleMultiply(inFirst=f.outA,Second='10'),v=Core::DoubleValue(Value='1')",
        "f.outB",
    );
    assert_eq!(net.series(1), ["21"]);
}

#[test]
fn fragment_in_port_may_feed_out_port() {
    let mut net = Bench::watching(
        "Core::Double",
        "f={outX=parent.inX}(inX=g.outX),g={outX=parent.inX}(inX=v.outValue),\
         v=Core::DoubleValue(Value='4')",
        "f.outX",
    );
    assert_eq!(net.series(1), ["4"]);
}

/// Each link passes all previous fragments: without a cache, this would take minutes.
#[test]
fn links_through_many_fragments_load_in_linear_time() {
    let many = 10_000;
    let mut children =
        "f0={outX=parent.inX}(inX=v.outValue),v=Core::DoubleValue(Value='4')".to_owned();
    for i in 1..many {
        let before = i - 1;
        children += &format!(
            ",f{i}={{outX=parent.inX}}(inX=f{before}.outX),\
             a{i}=Core::DoubleAdd(inFirst=f{i}.outX,Second='{i}')"
        );
    }
    let last = format!("a{}.outValue", many - 1);
    let mut net = Bench::watching("Core::Double", &children, &last);
    assert_eq!(net.series(1), ["10003"]);
}

/// A clock in a fragment that is switched by netcomm value `on`.
fn switched(inside: &str) -> Bench {
    Bench::watching(
        "Core::Double",
        &format!(
            "on=Core::BooleanNetcommIn(Key='on',Value='true'),\
             f={{{inside},outX=x.outValue}}(inActive=on.outValue)"
        ),
        "f.outX",
    )
}

#[test]
fn inactive_fragment_is_null_and_stops_clock() {
    let mut net = switched("x=Core::Clock(Increment='1000')");
    assert_eq!(net.series(2), ["1", "2"]);
    net.write("on", "false");
    assert_eq!(net.series(2), ["null", "null"]);
    net.write("on", "true");
    assert_eq!(net.series(2), ["3", "4"]);
}

#[test]
fn pre_in_inactive_fragment_forgets() {
    let mut net = switched("c=Core::Clock(Increment='1000'),x=Core::DoublePre(inValue=c.outValue)");
    assert_eq!(net.series(3), ["null", "1", "2"]);
    net.write("on", "false");
    assert_eq!(net.series(1), ["null"]);
    net.write("on", "true");
    assert_eq!(net.series(2), ["null", "4"]);
}

#[test]
fn primitive_is_switched_like_fragment() {
    let mut net = Bench::watching(
        "Core::Double",
        "on=Core::BooleanNetcommIn(Key='on',Value='false'),\
         c=Core::Clock(inActive=on.outValue,Increment='1000')",
        "c.outValue",
    );
    assert_eq!(net.series(1), ["null"]);
    net.write("on", "true");
    assert_eq!(net.series(2), ["1", "2"]);
}

#[test]
fn outer_fragment_switches_nested_ones() {
    let mut net = switched(
        "t=Core::BooleanValue(Value='true'),g={c=Core::Clock(Increment='1000'),outY=c.outValue}\
         (inActive=t.outValue),x=Core::DoubleAdd(inFirst=g.outY,Second='0')",
    );
    assert_eq!(net.series(1), ["1"]);
    net.write("on", "false");
    assert_eq!(net.series(1), ["null"]);
    net.write("on", "true");
    assert_eq!(net.series(1), ["2"]);
}

#[test]
fn cancelled_net_ends_itself() {
    let mut net = Bench::new("{c=Cancel(),outTerminate=c.outCancel}");
    assert!(!net.cycle());
    net.moment.cancel = true;
    assert!(net.cycle());
}

#[test]
fn inline_primitives_work_as_sources() {
    let mut net = Bench::watching(
        "Core::Double",
        "a=Core::DoubleAdd(inFirst=Core::Clock(inIncrement=Core::DoubleValue(Value='1000')\
         .outValue).outValue,Second='0')",
        "a.outValue",
    );
    assert_eq!(net.series(2), ["1", "2"]);
}

#[test]
fn written_value_arrives_with_its_time() {
    let mut net = Bench::new(
        "{i=Core::DoubleNetcommIn(Key='gain',Value='2'),o=Core::DoubleNetcommOut(\
         inValue=i.outValue,Key='echo'),c=Cancel(),outTerminate=c.outCancel}",
    );
    net.cycle();
    assert_eq!(net.out("echo"), "2");
    assert!(net.plan.take_changed());
    net.cycle();
    assert!(
        !net.plan.take_changed(),
        "an unchanged value need not be handed over"
    );
    net.write("gain", "0.1");
    net.cycle();
    assert_eq!(net.out("echo"), "0.1");
}

#[test]
fn estop_votes_in_each_cycle() {
    let net = |source: &str, every: u64| {
        let mut net = Bench::new(&format!(
            "{{in=Core::BooleanNetcommIn(Key='stop'),off=Core::BooleanSetNull(inValue=in.outValue,\
             inNull=in.outValue),say=EStop(inEStop={source}.outValue),no=Core::BooleanValue(),\
             outTerminate=no.outValue}}"
        ));
        net.moment.every = every;
        net
    };
    let vote = |net: &Bench, cycle: u64| net.image.stop.get().at(cycle);
    let mut direct = net("in", 4);
    assert_eq!(vote(&direct, 1), None);
    direct.cycle();
    assert_eq!(
        [1, 4, 5].map(|c| vote(&direct, c)),
        [Some(false), Some(false), None]
    );
    direct.write("stop", "true");
    direct.moment.cycle = 4;
    direct.cycle();
    assert_eq!(
        [5, 8, 9].map(|c| vote(&direct, c)),
        [Some(true), Some(true), None]
    );
    // Null is not a permission to move.
    let mut lost = net("off", 1);
    lost.write("stop", "true");
    lost.cycle();
    assert_eq!(vote(&lost, 1), Some(true));
}

#[test]
fn one_stopping_estop_outweighs_others() {
    let mut net = Bench::new(
        "{yes=Core::BooleanValue(Value='true'),no=Core::BooleanValue(),\
         a=EStop(inEStop=no.outValue),b=EStop(inEStop=yes.outValue),c=EStop(inEStop=no.outValue),\
         outTerminate=no.outValue}",
    );
    net.cycle();
    assert_eq!(net.image.stop.get().at(1), Some(true));
}

/// Number of additions that count for the cost of a net with these children.
fn additions_that_count(children: &str) -> usize {
    let text = format!(
        "{{x=Core::BooleanValue(Value='true'),y=Core::BooleanNot(inValue=x.outValue),
        z=Core::BooleanValue(),w=Core::BooleanNot(inValue=z.outValue),
        {children}never=Core::BooleanValue(),outTerminate=never.outValue}}"
    );
    let net = Bench::new(&text);
    let shares = &net.plan.cost().shares;
    let additions = shares.iter().find(|s| s.primitive == "Core::DoubleAdd");
    additions.map_or(0, |share| share.count)
}

/// A fragment with `count` additions and `inside`, followed by a comma.
fn fragment(name: &str, count: usize, inside: &str, args: &str) -> String {
    let each = |i| format!("a{i}=Core::DoubleAdd(First='1',Second='1'),");
    let all: String = (0..count).map(each).collect();
    format!("{name}={{{all}{inside}last=Core::BooleanValue()}}({args}),")
}

#[test]
fn exclusive_fragments_are_counted_once() {
    let [x, not_x] = ["inActive=x.outValue", "inActive=y.outValue"];
    let [z, not_z] = ["inActive=z.outValue", "inActive=w.outValue"];
    let beside = |parts: &[String]| additions_that_count(&parts.concat());
    let f = |count, active| fragment(&format!("f{count}"), count, "", active);
    assert_eq!(beside(&[f(3, x), f(5, not_x)]), 5);
    assert_eq!(beside(&[f(5, x), f(3, not_x), f(4, x)]), 9);
    // Fragments with different conditions all count.
    assert_eq!(beside(&[f(3, x), f(5, not_z), f(4, z)]), 8);
    assert_eq!(beside(&[f(2, x), f(7, z)]), 9);
    // A fragment counts with its own longest activation, not with all its content.
    let halves =
        fragment("g", 5, "", "inActive=parent.inZ") + &fragment("h", 4, "", "inActive=parent.inW");
    let whole = format!("{x},inZ=z.outValue,inW=w.outValue");
    let whole = fragment("f", 0, &halves, &whole);
    assert_eq!(beside(&[whole.clone(), f(8, not_x)]), 8);
    assert_eq!(beside(&[whole, f(4, not_x)]), 5);
}
