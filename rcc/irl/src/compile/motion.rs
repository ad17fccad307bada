//! Motions: which robot, which attributes, and whether constant targets fit the robot.

use super::scope::Value;
use super::{Checked, Code, Compiler};
use crate::code::{ATTRIBUTES, MOVE_INC, MOVE_JOINTS, MOVE_POSITION, Opcode, RANGES};
use crate::diagnostic::{Diagnostic, did_you_mean};
use crate::spec::Robot;
use crate::tree::{Expr, ExprKind, Move, Name, PathKind, Span};
use crate::types::Type;

/// Attributes of the language that are not executed, with the reason.
const REFUSED: &[(&str, &str)] = &[
    ("c_speed", "use `c_cp` or `c_ori`"),
    ("c_pass", "use `c_ptp`, `c_cp` or `c_ori`"),
    ("wobble", "program the deviation as motions"),
    ("adax_control", "robots have no additional axes here"),
    ("device", "robots have no additional devices here"),
];

impl Compiler<'_> {
    pub(super) fn motion(&mut self, motion: &Move, at: &Span) -> Checked<()> {
        let number = self.robot(motion, at)?;
        let robot = self.system.robots.get(number).cloned();
        let Some(robot) = robot else {
            return Err(super::Reported);
        };
        self.block.robots |= 1 << number;
        let is_ptp = motion.path == PathKind::Ptp;
        let mut given: [Option<&Expr>; ATTRIBUTES.len()] = [None; ATTRIBUTES.len()];
        let mut result = Ok(());
        for (name, value) in &motion.attributes {
            if name.text != "act_rob" {
                let checked = self.attribute(name, value, is_ptp, &mut given);
                result = result.and(checked);
            }
        }
        result?;
        let mut mask = 0;
        for (bit, value) in given.iter().enumerate() {
            if let Some(value) = value {
                self.value_as(value, &Type::Real)?;
                mask |= 1 << bit;
            }
        }
        let mut flags = match motion.path {
            PathKind::Ptp => 0,
            PathKind::Lin => 1,
            PathKind::Circle => 2,
        };
        let mut words = 0;
        if let Some(via) = &motion.via {
            let (kind, size) = self.target(via, &robot, motion)?;
            if kind & MOVE_JOINTS != 0 {
                let cause = "the auxiliary point of an arc is a frame or a position";
                return Err(self.error(Code::Target, &via.at, cause));
            }
            // A position is extended to a pose, so that both points have one form.
            words += size;
            flags |= kind << 8;
        }
        let (kind, size) = self.target(&motion.target, &robot, motion)?;
        flags |= kind;
        words += size;
        if motion.is_incremental {
            flags |= MOVE_INC;
        }
        self.emitter.at(at);
        let robot = u32::try_from(number).unwrap_or(0);
        self.emitter.emit(Opcode::Move, flags, robot, mask);
        self.emitter.pop(words + mask.count_ones());
        Ok(())
    }

    fn robot(&mut self, motion: &Move, at: &Span) -> Checked<usize> {
        let robots = &self.system.robots;
        let mut named = motion
            .attributes
            .iter()
            .filter(|(n, _)| n.text == "act_rob");
        let Some((_, value)) = named.next() else {
            return match robots.as_slice() {
                [_] => Ok(0),
                [] => {
                    let found = Diagnostic::new(
                        Code::Robot,
                        at.clone(),
                        "the system specification has no robot to move",
                    )
                    .hint("name one: `system_specification \"file.spc\";`");
                    Err(self.report(found))
                }
                [first, ..] => {
                    let hint = format!("name one of them: `act_rob:=\"{}\"`", first.name);
                    let found = Diagnostic::new(
                        Code::Robot,
                        at.clone(),
                        "the system has several robots, and this motion names none",
                    )
                    .hint(hint);
                    Err(self.report(found))
                }
            };
        };
        let Some(Value::Text(name)) = self.fold(value) else {
            let cause = "`act_rob` is the name of a robot, as a text that is known when the program is compiled";
            return Err(self.error(Code::NotConstant, &value.at, cause));
        };
        let name = name.to_ascii_lowercase();
        if let Some(number) = robots.iter().position(|robot| robot.name == name) {
            return Ok(number);
        }
        let hint = did_you_mean(&name, robots.iter().map(|robot| robot.name.as_str()));
        let cause = format!("the system specification has no robot `{name}`");
        let found = Diagnostic::new(Code::Robot, value.at.clone(), cause).hint(hint);
        Err(self.report(found))
    }

    fn attribute<'e>(
        &mut self,
        name: &Name,
        value: &'e Expr,
        is_ptp: bool,
        given: &mut [Option<&'e Expr>; ATTRIBUTES.len()],
    ) -> Checked<()> {
        if let Some((_, hint)) = REFUSED.iter().find(|(refused, _)| *refused == name.text) {
            let cause = format!("attribute `{}` is not supported", name.text);
            let found = Diagnostic::new(Code::Attribute, name.at.clone(), cause).hint(*hint);
            return Err(self.report(found));
        }
        let Some(bit) = ATTRIBUTES.iter().position(|known| *known == name.text) else {
            let known = ATTRIBUTES.iter().copied().chain(["act_rob"]);
            let hint = did_you_mean(&name.text, known);
            let cause = format!("a motion has no attribute `{}`", name.text);
            let found = Diagnostic::new(Code::Attribute, name.at.clone(), cause).hint(hint);
            return Err(self.report(found));
        };
        if bit != ATTRIBUTES.len() - 1 && is_ptp != (bit < 3) {
            let of = if is_ptp { "lin and circle" } else { "ptp" };
            let cause = format!("attribute `{}` is one of {of}", name.text);
            return Err(self.error(Code::Attribute, &name.at, cause));
        }
        if let Some(number) = self.fold(value).and_then(|value| value.number()) {
            let (least, most) = RANGES.get(bit).copied().unwrap_or_default();
            if !(least..=most).contains(&number) {
                let cause = format!(
                    "`{}` is {number}; it must be between {least} and {most}",
                    name.text
                );
                let mut found = Diagnostic::new(Code::Range, value.at.clone(), cause);
                if bit < 2 && number > 1.0 {
                    let part = number / 100.0;
                    found = found.hint(format!(
                        "it is a part of the largest value of each axis: {number} % is {part}"
                    ));
                }
                return Err(self.report(found));
            }
        }
        match given.get_mut(bit) {
            Some(place @ None) => {
                *place = Some(value);
                Ok(())
            }
            _ => {
                let cause = format!("attribute `{}` is given twice", name.text);
                Err(self.error(Code::Attribute, &name.at, cause))
            }
        }
    }

    /// Emits a target; its kind, and its words.
    fn target(&mut self, target: &Expr, robot: &Robot, motion: &Move) -> Checked<(u32, u32)> {
        self.check_constant(target, robot, motion)?;
        let ty = self.value(target)?;
        let kind = if ty.is("joint") || ty.is("mainjoint") {
            MOVE_JOINTS
        } else if ty.is("robtarget") || ty.is("pose") {
            0
        } else if ty.is("position") {
            MOVE_POSITION
        } else {
            let cause = format!(
                "a motion leads to a joint, mainjoint, robtarget, pose or position, not to a value of type {}",
                ty.shown()
            );
            return Err(self.error(Code::Type, &target.at, cause));
        };
        // What the interpreter does not need of a joint or a target.
        let words = match kind {
            MOVE_JOINTS | 0 => 7,
            _ => 3,
        };
        self.emitter.emit(Opcode::Drop, ty.words() - words, 0, 0);
        self.emitter.pop(ty.words() - words);
        if kind & MOVE_JOINTS != 0 && (motion.path != PathKind::Ptp) {
            let found = Diagnostic::new(
                Code::Target,
                target.at.clone(),
                "joint positions are targets of ptp motions only",
            )
            .hint("use `move ptp`, or a robtarget");
            return Err(self.report(found));
        }
        if kind & MOVE_JOINTS == 0 && robot.model.is_empty() {
            let cause = format!(
                "robot `{}` has no kinematics in the system specification: it takes joint positions only",
                robot.name
            );
            return Err(self.error(Code::Target, &target.at, cause));
        }
        Ok((kind, words))
    }

    /// Checks what is known of a target: number and range of joints, status.
    fn check_constant(&mut self, target: &Expr, robot: &Robot, motion: &Move) -> Checked<()> {
        let ExprKind::Call(name, arguments) = &target.kind else {
            return Ok(());
        };
        match (name.text.as_str(), arguments.as_slice()) {
            ("joint", [main, ..]) => self.check_constant(main, robot, motion),
            ("mainjoint", angles) => {
                let joints = robot.joints.len();
                if angles.len() != joints {
                    let cause = format!(
                        "{} joint positions, but robot `{}` has {joints} joints",
                        angles.len(),
                        robot.name
                    );
                    return Err(self.error(Code::Target, &target.at, cause));
                }
                if motion.is_incremental {
                    return Ok(());
                }
                let mut result = Ok(());
                for (number, (angle, limit)) in (1..).zip(angles.iter().zip(&robot.joints)) {
                    let value = self.fold(angle).and_then(|value| value.number());
                    if let Some(value) = value.filter(|v| !(limit.min..=limit.max).contains(v)) {
                        let cause = format!(
                            "joint {number} of `{}` goes from {} to {} deg, not to {value}",
                            robot.name, limit.min, limit.max
                        );
                        result = Err(self.error(Code::Target, &angle.at, cause));
                    }
                }
                result
            }
            ("robtarget", [_, status, ..]) => {
                if self.fold(status) != Some(Value::Int(-1)) {
                    let cause = "status and turns are not used: the robot takes the configuration nearest to where it is";
                    let found = Diagnostic::new(Code::StatusUnused, status.at.clone(), cause)
                        .hint("write -1 for any configuration, or move to joint positions before");
                    self.report(found);
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
