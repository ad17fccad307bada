//! Two arms assemble a workpiece. A mobile base brings two supply boxes; both arms lift each of them onto the bench as one. The left
//! arm fetches the socket, the right one the peg, and pushes it in until it feels the bottom; then it fetches a screw, and drives it
//! in under impedance control until the torque is reached. The program connects to nothing and prints nothing: its caller does.
//! The same in Python is `rcc/python/examples/assembly.py`.

mod station;

use takt_api::{Arm, Cell, Control, Gripper, Handle, Pose, coupled, together, when};

use station::{
    AROUND, BACK, BEYOND, BIT, BOXES, CARRY, CONTACT, DOCK, DOWN, DRIVER, FORTH, GRASP, GRIP,
    HEIGHTS, HELD, IN_HOLE, JAMMED, LIFT, ON_FACE, PRESS, SCREW, SCREW_WITHIN, SCREWED, SEATED,
    STANDS, THREAD, TORQUE, UNEVEN, UNSCREWS, WEIGHT, complete, contact_limits, fail, limits,
    maintain, perform, ready,
};
pub(crate) use station::{Done, Order, Progress, Station, Step};

/// Assembles one workpiece.
pub(crate) fn run(cell: &Cell, order: Order, report: &dyn Fn(Progress<'_>)) -> Done<Vec<Step>> {
    let mut station = Station::new(cell, order, report)?;
    station.home()?;
    station.work()?;
    Ok(station.steps)
}

impl Station<'_> {
    /// The first step: all devices at their places.
    pub(crate) fn home(&mut self) -> Done {
        self.step("start and dock", Self::start)
    }

    /// All others.
    pub(crate) fn work(&mut self) -> Done {
        let is_unloaded = self.order.is_unloaded;
        for [from, to] in BOXES.into_iter().filter(|_| !is_unloaded) {
            self.step("unload a box", |it| it.unload(from, to))?;
        }
        let home = self.base.go_to(Pose::IDENTITY).begin()?;
        self.step("fetch the parts", Self::fetch)?;
        self.step("insert the peg", Self::insert)?;
        self.step("drive the screw", Self::screw)?;
        self.step("deliver", Self::deliver)?;
        complete("the base goes home", &home)
    }

    /// After a fault: the screwdriver rests, and the arms are stiff where they are. Hands keep what they hold.
    pub(crate) fn recover(&self) -> Done {
        perform("driver off", self.driver.set_analogue(0, 0.0))?;
        perform("stiff", self.bit.switch_to(Control::position()))
    }

    /// The base docks while the arms take their posture, and the hands open.
    fn start(&self) -> Done {
        let [left, right] = &self.arms;
        let dock = |x| self.base.go_to(Pose::xyz(x, 0.0, 0.0));
        let mut all = vec![left.ptp(ready(1.0)), right.ptp(ready(-1.0))];
        all.extend(self.hands.each_ref().map(Gripper::open));
        if self.order.is_unloaded {
            return perform("start", together(all));
        }
        all.push(dock(DOCK));
        perform("start", together(all))?;
        let is_docked = left.input(0);
        if !self.cell.holds(&is_docked)? {
            self.note("the base docks beside its place: it docks again");
            perform("dock again", dock(DOCK + 0.1).then(dock(DOCK)))?;
        }
        if !self.cell.holds(&is_docked)? {
            return fail(
                "the base docks beside its place twice, the boxes stay on it\nhint: clear the dock and the wheels",
            );
        }
        Ok(())
    }

    /// Both arms lift a box from the platform onto the bench: from its grasp on as one.
    fn unload(&self, from: f64, to: f64) -> Done {
        let [platform, bench] = HEIGHTS;
        let [left, right] = &self.arms;
        let lines = |x, z| {
            together([(left, GRIP), (right, -GRIP)].map(|(arm, y)| self.lin(arm, [x, y, z], DOWN)))
        };
        let above = [(left, GRIP), (right, -GRIP)]
            .map(|(arm, y)| self.ptp(arm, [from, y, platform + 0.12]));
        perform("reach the box", together(above).then(lines(from, platform)))?;
        self.carry(from, to)?;
        perform("release the box", self.both(|hand| hand.move_to(0.04)))?;
        perform("leave the box", lines(to, bench + 0.15))
    }

    /// Grasps a box with both hands, and carries it; where a hand slips, the box is set down, and grasped harder.
    fn carry(&self, from: f64, to: f64) -> Done {
        let [platform, bench] = HEIGHTS;
        let place = |x, z| Pose::quaternion([x, 0.0, z], DOWN);
        let [left, right] = self.arms.each_ref().map(|arm| arm.force().z());
        let is_carried = (left.clone() + right.clone()).under(-WEIGHT);
        let slips = (left - right).abs().over(UNEVEN) | !is_carried;
        for force in GRASP {
            perform("grasp the box", self.both(|hand| hand.grasp(0.01, force)))?;
            let load = coupled(place(from, platform), &self.arms)?.with_limits(limits(CARRY));
            let lift = load.lin(place(from, platform + LIFT)).speed(0.3);
            perform("lift the box", lift)?;
            if !self.cell.holds(&slips)? {
                let up = self.round(load.lin(place(from, platform + 0.2)));
                let across = self.round(load.lin(place(to, bench + 0.27)));
                let down = load.lin(place(to, bench));
                return perform("carry the box", up.then(across).then(down));
            }
            perform("set the box down", load.lin(place(from, platform)))?;
            perform("release the box", self.both(|hand| hand.move_to(0.04)))?;
            self.note("a hand slips: the box is set down and grasped harder");
        }
        fail("a hand slips at its largest force, the box is set down\nhint: clean the pads")
    }

    /// The left arm fetches the socket, the right one the peg: over the boxes when the left one leaves them.
    fn fetch(&self) -> Done {
        let ([left, right], [a, b], [[_, pegs], [_, sockets]]) = (&self.arms, &self.hands, BOXES);
        perform("open", together([a.move_to(0.08), b.move_to(0.05)]))?;
        let socket = self.take(0, 0.06, [sockets, 0.0, 0.06], "box 2 has no socket")?;
        let peg = self.take(1, 0.03, [pegs, 0.0, 0.1], "box 1 has no peg")?;
        complete("lift the socket", &socket)?;
        complete("lift the peg", &peg)?;
        let before = self.lin(right, [HELD[0], SEATED - 0.15, HELD[2]], FORTH);
        perform("meet", together([self.lin(left, HELD, BACK), before]))
    }

    /// Grasps a part of a width, and begins to lift it out of its box.
    fn take(&self, side: usize, width: f64, at: [f64; 3], missing: &str) -> Done<Handle> {
        let (arm, hand) = (&self.arms[side], &self.hands[side]);
        perform("reach the part", self.reach(arm, at))?;
        let [x, y, z] = at;
        let up = self.lin(arm, [x, y, z + 0.2], DOWN);
        if let Err(error) = perform("grasp the part", hand.grasp(width, GRASP[1])) {
            perform("leave the box", up)?;
            return fail(&format!(
                "{missing}: {error}\nhint: fill the box, and assemble again; the other hand keeps what it holds"
            ));
        }
        let [_, beside, _] = arm.base().position();
        let clear = self.lin(arm, [x, y + 0.25 * beside.signum(), z + 0.3], DOWN);
        Ok(self.round(up).then(clear).begin()?)
    }

    /// The right arm inserts the peg until it feels the bottom, and presses.
    fn insert(&self) -> Done {
        let right = &self.arms[1];
        let at =
            |arm: &Arm, [x, z]: [f64; 2], y| self.lin(arm, [HELD[0] + x, y, HELD[2] + z], FORTH);
        let slow = right.clone().with_limits(contact_limits());
        let [mouth, bottom] = CONTACT.map(|force| (-right.force().x()).over(force));
        let (mut place, mut others, mut jams) = ([0.0; 2], AROUND.into_iter(), 0);
        perform("approach", self.round(at(right, place, SEATED - 0.04)))?;
        loop {
            let enter = at(&slow, place, SEATED - IN_HOLE).until("mouth", mouth.clone());
            let entered = self.round(enter).begin()?;
            let insert = at(&slow, place, SEATED + BEYOND).until("contact", bottom.clone());
            let outcome = insert.run()?;
            entered.wait_to_end()?;
            let left = SEATED - self.tip(right, 0.0)?;
            if !outcome.is_stopped_by("contact") {
                return fail("the peg meets no socket\nhint: does the left hand hold it?");
            }
            if left < JAMMED {
                break;
            }
            perform("draw the peg back", at(&slow, place, SEATED - 0.04))?;
            if left > ON_FACE {
                self.note("the peg meets the face beside the hole: it is tried around it");
                place = others.next().ok_or("the peg does not find the hole; both hands keep their parts\nhint: put peg and socket into their places")?;
            } else if jams > 0 {
                return fail(&format!(
                    "the peg jams {:.1} mm before its seat, twice; both hands hold their parts\nhint: remove burrs, or replace the parts",
                    left * 1e3
                ));
            } else {
                jams += 1;
                self.note("the peg jams: it is drawn back, and inserted again");
            }
        }
        maintain("press the peg", &self.press(right, PRESS).begin()?)?;
        // Else the contact is lost when the fingers open.
        maintain("hold", &right.hold().begin()?)?;
        perform("release the peg", self.hands[1].move_to(0.05))?;
        perform("leave the peg", at(right, place, SEATED - 0.2))
    }

    /// The right arm fetches a screw, and drives it in under impedance control.
    fn screw(&self) -> Done {
        let (bit, [sx, sy, sz]) = (&self.bit, SCREW);
        perform("fetch a screw", self.reach(bit, SCREW))?;
        perform("take the screw", self.lin(bit, [sx, sy, sz + 0.19], DOWN))?;
        let [x, z] = [HELD[0] + THREAD[0], HELD[2] + THREAD[1]];
        let before = Pose::quaternion([x, SEATED - 0.02, z], FORTH);
        perform("turn", bit.ptp_to(self.world.pose(before)))?;
        let soft = Control::cartesian([2000.0, 2000.0, 2000.0, 300.0, 300.0, 300.0], [0.7; 6]);
        perform("impedance", bit.switch_to(soft))?;
        let driven = |what, speed| perform(what, self.driver.set_analogue(0, speed));
        let torque = self.driver.analogue_input(0)?;
        let tight = torque.clone().over(TORQUE);
        // Known in each cycle: what it lasts is time of the controller.
        let passed = |span| torque.clone().over(-100.0).lasting(span);
        for is_last in [false, true] {
            let press = self.press(bit, PRESS).until("tight", tight.clone());
            let press = press.until("late", passed(SCREW_WITHIN)).begin()?;
            maintain("press the screw", &press)?;
            driven("driver on", DRIVER)?;
            let ended = press.wait_to_end()?;
            driven("driver off", 0.0)?;
            let left = (SCREWED - self.tip(bit, BIT)?) * 1e3;
            if !ended.is_stopped_by("tight") {
                perform("draw the screw back", bit.lin(self.world.pose(before)))?;
                if is_last {
                    return fail(&format!(
                        "the screw does not reach {TORQUE} Nm, twice: {left:.1} mm before its seat\nhint: is there one at the bit?"
                    ));
                }
                self.note("the screw does not bite: it is drawn back, and pressed again");
                continue;
            }
            if left < JAMMED * 1e3 {
                break;
            }
            driven("driver back", -DRIVER)?;
            let off = self.driver.set_analogue(0, 0.0);
            perform("driver off", when(passed(UNSCREWS)).start(off))?;
            if is_last {
                return fail(&format!(
                    "the screw is tight {left:.1} mm before its seat, twice: it was turned back\nhint: replace screw and socket"
                ));
            }
            self.note("the screw is tight before its seat: it is turned back, and driven again");
        }
        let away = self.lin(bit, [x, SEATED - 0.15, z], FORTH);
        perform("leave the screw", away)?;
        perform("stiff", bit.switch_to(Control::position()))
    }

    /// The left arm puts the workpiece into the second box; both arms go back.
    fn deliver(&self) -> Done {
        let ([left, _], [_, [_, x]]) = (&self.arms, BOXES);
        let over = self.round(self.lin(left, [x, 0.15, 0.36], DOWN));
        let place = over.then(self.reach(left, [x, 0.0, STANDS]));
        perform("place the workpiece", place)?;
        perform("release the workpiece", self.hands[0].move_to(0.08))?;
        perform("leave the workpiece", self.lin(left, [x, 0.0, 0.36], DOWN))
    }
}
