//! The instructions. Each checks all it accesses, so that invalid object code is a fault of the program only.

use super::robot::{Order, Target};
use super::{FaultKind, Machine, Phase, Thread};
use crate::builtin;
use crate::code::{
    ATTRIBUTES, GLOBAL, Instruction, MOVE_INC, MOVE_JOINTS, MOVE_PATH, MOVE_POSITION, Opcode,
    RANGES,
};

type Result<T> = std::result::Result<T, FaultKind>;

/// Words that one step copies.
const WORDS_PER_STEP: u32 = 16;
/// Steps that a predefined function counts as.
const BUILTIN_STEPS: u32 = 8;
/// Steps that the beginning of a motion counts as.
const MOVE_STEPS: u32 = 400;

/// What follows an instruction.
enum Next {
    Instruction,
    Jump(u32),
    /// The same instruction again, in the next cycle.
    Again,
    /// The next instruction, in the next cycle.
    Later,
    End,
}

fn int(word: u64) -> i64 {
    word.cast_signed()
}

fn checked_int(value: Option<i64>) -> Result<u64> {
    let value = value.ok_or(FaultKind::Overflow)?;
    let value = i32::try_from(value).map_err(|_| FaultKind::Overflow)?;
    Ok(i64::from(value).cast_unsigned())
}

fn checked_real(value: f64) -> Result<u64> {
    if value.is_finite() {
        Ok(value.to_bits())
    } else {
        Err(FaultKind::NotANumber)
    }
}

fn relation(number: u32, order: Option<std::cmp::Ordering>) -> Result<u64> {
    use std::cmp::Ordering::{Equal, Greater, Less};
    let order = order.ok_or(FaultKind::NotANumber)?;
    let holds = match number {
        0 => order == Equal,
        1 => order != Equal,
        2 => order == Less,
        3 => order != Greater,
        4 => order == Greater,
        5 => order != Less,
        _ => return Err(FaultKind::BadCode),
    };
    Ok(holds.into())
}

/// Steps that an instruction counts as.
fn cost(instruction: &Instruction) -> u32 {
    let words = match instruction.opcode {
        Opcode::Load | Opcode::Store => instruction.c,
        Opcode::Fetch | Opcode::Put | Opcode::Enter | Opcode::Return => instruction.a,
        Opcode::Builtin => return BUILTIN_STEPS,
        Opcode::Move => return MOVE_STEPS,
        _ => 0,
    };
    1 + words / WORDS_PER_STEP
}

impl Machine {
    /// Executes a thread until it waits, ends, or has used its steps. A thread that has none left goes on in the next cycle;
    /// an instruction that counts as more than all steps is executed alone.
    pub(super) fn run_thread(&mut self, number: usize, share: u32) -> Result<()> {
        let mut left = share;
        loop {
            let Some(mut thread) = self.threads.get(number).copied().filter(|t| t.is_alive) else {
                return Ok(());
            };
            let code = self.program.code.get(thread.pc as usize).copied();
            let instruction = code.ok_or(FaultKind::BadCode)?;
            // A jump is at the end of a loop or before a routine, which is no line that the program comes to.
            let is_jump = instruction.opcode == Opcode::Jump;
            if !is_jump && self.waits_before(number, thread) {
                return Ok(());
            }
            let cost = cost(&instruction);
            if cost > left && left < share {
                return Ok(());
            }
            left = left.saturating_sub(cost);
            let location = self.program.locations.get(thread.pc as usize);
            if let Some(location) = location.filter(|_| !is_jump) {
                self.location = *location;
                thread.line = location.line;
            }
            let next = self.step(number, &mut thread, instruction)?;
            let mut goes_on = left > 0 && self.phase == Phase::Running;
            match next {
                Next::Instruction => thread.pc += 1,
                Next::Jump(target) => thread.pc = target,
                Next::Again => goes_on = false,
                Next::Later => {
                    thread.pc += 1;
                    goes_on = false;
                }
                Next::End => thread.is_alive = false,
            }
            if let Some(slot) = self.threads.get_mut(number) {
                // A program that has ended has no threads.
                thread.is_alive &= slot.is_alive;
                *slot = thread;
            }
            if !goes_on {
                return Ok(());
            }
        }
    }

    /// Whether the program waits, from now on, before the line that a thread comes to: at a breakpoint, or behind a step.
    fn waits_before(&mut self, number: usize, thread: Thread) -> bool {
        let location = self.program.locations.get(thread.pc as usize).copied();
        let Some(location) = location.filter(|l| l.line != thread.line && l.line != 0) else {
            return false;
        };
        if !self.is_stepping && !self.breakpoints.contains(&location.line) {
            return false;
        }
        self.is_stepping = false;
        self.location = location;
        self.phase = Phase::Paused;
        if let Some(slot) = self.threads.get_mut(number) {
            slot.line = location.line;
        }
        true
    }

    fn words(&self, at: usize, words: usize) -> Result<&[u64]> {
        let end = at.checked_add(words).ok_or(FaultKind::BadCode)?;
        self.memory.get(at..end).ok_or(FaultKind::BadCode)
    }

    fn copy(&mut self, from: usize, to: usize, words: usize) -> Result<()> {
        self.words(from, words)?;
        self.words(to, words)?;
        self.memory.copy_within(from..from + words, to);
        Ok(())
    }

    fn push(&mut self, thread: &mut Thread, word: u64) -> Result<()> {
        let limit = thread.base + self.program.stack as usize;
        let slot = self.memory.get_mut(thread.sp).filter(|_| thread.sp < limit);
        *slot.ok_or(FaultKind::BadCode)? = word;
        thread.sp += 1;
        Ok(())
    }

    fn grow(&self, thread: &mut Thread, words: usize) -> Result<usize> {
        let first = thread.sp;
        let top = first.checked_add(words).ok_or(FaultKind::BadCode)?;
        if top > thread.base + self.program.stack as usize {
            return Err(FaultKind::BadCode);
        }
        thread.sp = top;
        Ok(first)
    }

    fn shrink(thread: &mut Thread, words: usize) -> Result<usize> {
        let top = thread.sp.checked_sub(words);
        let top = top.filter(|top| *top >= thread.base);
        thread.sp = top.ok_or(FaultKind::BadCode)?;
        Ok(thread.sp)
    }

    fn pop(&self, thread: &mut Thread) -> Result<u64> {
        let at = Self::shrink(thread, 1)?;
        self.memory.get(at).copied().ok_or(FaultKind::BadCode)
    }

    fn pop_real(&self, thread: &mut Thread) -> Result<f64> {
        self.pop(thread).map(f64::from_bits)
    }

    fn address(&self, thread: &Thread, scope: u32, at: u32) -> usize {
        if scope == GLOBAL {
            at as usize
        } else {
            thread.fp.saturating_add(at as usize)
        }
    }

    fn pop_address(&self, thread: &mut Thread) -> Result<usize> {
        usize::try_from(int(self.pop(thread)?)).map_err(|_| FaultKind::BadCode)
    }

    #[expect(clippy::too_many_lines, reason = "a table of instructions")]
    fn step(&mut self, number: usize, thread: &mut Thread, i: Instruction) -> Result<Next> {
        match i.opcode {
            Opcode::Const => self.push(thread, u64::from(i.a) | u64::from(i.b) << 32)?,
            Opcode::Load => {
                let from = self.address(thread, i.a, i.b);
                let to = self.grow(thread, i.c as usize)?;
                self.copy(from, to, i.c as usize)?;
            }
            Opcode::Store => {
                let from = Self::shrink(thread, i.c as usize)?;
                let to = self.address(thread, i.a, i.b);
                self.copy(from, to, i.c as usize)?;
            }
            Opcode::Addr => {
                let at = self.address(thread, i.a, i.b);
                self.push(thread, at as u64)?;
            }
            Opcode::Index => {
                let index = int(self.pop(thread)?) - i64::from(i.a.cast_signed());
                let index = usize::try_from(index).map_err(|_| FaultKind::Index)?;
                if index >= i.b as usize {
                    return Err(FaultKind::Index);
                }
                let at = self.pop_address(thread)? + index * i.c as usize;
                self.push(thread, at as u64)?;
            }
            Opcode::Fetch => {
                let from = self.pop_address(thread)?;
                let to = self.grow(thread, i.a as usize)?;
                self.copy(from, to, i.a as usize)?;
            }
            Opcode::Put => {
                let from = Self::shrink(thread, i.a as usize)?;
                let to = self.pop_address(thread)?;
                self.copy(from, to, i.a as usize)?;
            }
            Opcode::Take => {
                let at = self.pop_address(thread)?;
                let event = self.memory.get_mut(at).ok_or(FaultKind::BadCode)?;
                let was = std::mem::take(event);
                self.push(thread, was)?;
            }
            Opcode::Drop => {
                Self::shrink(thread, i.a as usize)?;
            }
            Opcode::Enter | Opcode::Call | Opcode::Return => {
                return self.routine(number, thread, i);
            }
            Opcode::Jump => return Ok(Next::Jump(i.a)),
            Opcode::Unless => {
                if self.pop(thread)? == 0 {
                    return Ok(Next::Jump(i.a));
                }
            }
            Opcode::Trap => return Err(FaultKind::NoResult),
            Opcode::In
            | Opcode::Out
            | Opcode::Move
            | Opcode::Sync
            | Opcode::Wait
            | Opcode::Yield
            | Opcode::Now
            | Opcode::TimedOut
            | Opcode::SetTimedOut
            | Opcode::Fork
            | Opcode::Join
            | Opcode::End
            | Opcode::Pause
            | Opcode::Halt => return self.outside(number, thread, i),
            _ => self.arithmetic(thread, i)?,
        }
        Ok(Next::Instruction)
    }

    fn routine(&mut self, number: usize, thread: &mut Thread, i: Instruction) -> Result<Next> {
        let depth = self.program.calls as usize;
        match i.opcode {
            Opcode::Enter => {
                let first = self.grow(thread, i.a as usize)?;
                let locals = self.memory.get_mut(first..first + i.a as usize);
                locals.ok_or(FaultKind::BadCode)?.fill(0);
                Ok(Next::Instruction)
            }
            Opcode::Call => {
                if thread.calls >= depth {
                    return Err(FaultKind::BadCode);
                }
                let slot = self.returns.get_mut(number * depth + thread.calls);
                let slot = slot.ok_or(FaultKind::BadCode)?;
                (slot.pc, slot.fp, slot.line) = (thread.pc + 1, thread.fp, thread.line);
                thread.calls += 1;
                let top = thread.sp.checked_sub(i.b as usize);
                thread.fp = top.ok_or(FaultKind::BadCode)?;
                Ok(Next::Jump(i.a))
            }
            _ => {
                let from = Self::shrink(thread, i.a as usize)?;
                let calls = thread.calls.checked_sub(1).ok_or(FaultKind::BadCode)?;
                let slot = self.returns.get(number * depth + calls).copied();
                let slot = slot.ok_or(FaultKind::BadCode)?;
                thread.calls = calls;
                if thread.fp < thread.base || thread.fp > from {
                    return Err(FaultKind::BadCode);
                }
                self.copy(from, thread.fp, i.a as usize)?;
                thread.sp = thread.fp + i.a as usize;
                (thread.fp, thread.line) = (slot.fp, slot.line);
                Ok(Next::Jump(slot.pc))
            }
        }
    }

    fn arithmetic(&mut self, thread: &mut Thread, i: Instruction) -> Result<()> {
        use Opcode as O;
        let word = match i.opcode {
            O::NegInt => checked_int(int(self.pop(thread)?).checked_neg())?,
            O::NegReal => checked_real(-self.pop_real(thread)?)?,
            O::ToReal => (int(self.pop(thread)?) as f64).to_bits(),
            O::SwapToReal => {
                let top = self.pop(thread)?;
                let below = (int(self.pop(thread)?) as f64).to_bits();
                self.push(thread, below)?;
                top
            }
            O::Not => u64::from(self.pop(thread)? == 0),
            O::Builtin => return self.builtin(thread, i.a),
            O::AddReal | O::SubReal | O::MulReal | O::DivReal | O::CompareReal => {
                let b = self.pop_real(thread)?;
                let a = self.pop_real(thread)?;
                match i.opcode {
                    O::AddReal => checked_real(a + b)?,
                    O::SubReal => checked_real(a - b)?,
                    O::MulReal => checked_real(a * b)?,
                    O::DivReal if b == 0.0 => return Err(FaultKind::DivisionByZero),
                    O::DivReal => checked_real(a / b)?,
                    _ => relation(i.a, a.partial_cmp(&b))?,
                }
            }
            _ => {
                let b = int(self.pop(thread)?);
                let a = int(self.pop(thread)?);
                match i.opcode {
                    O::AddInt => checked_int(a.checked_add(b))?,
                    O::SubInt => checked_int(a.checked_sub(b))?,
                    O::MulInt => checked_int(a.checked_mul(b))?,
                    O::DivInt | O::ModInt if b == 0 => return Err(FaultKind::DivisionByZero),
                    O::DivInt => checked_int(a.checked_div(b))?,
                    O::ModInt => checked_int(a.checked_rem(b))?,
                    O::And => u64::from(a != 0 && b != 0),
                    O::Or => u64::from(a != 0 || b != 0),
                    O::Exor => u64::from((a != 0) != (b != 0)),
                    O::CompareInt => relation(i.a, Some(a.cmp(&b)))?,
                    _ => return Err(FaultKind::BadCode),
                }
            }
        };
        self.push(thread, word)
    }

    fn builtin(&mut self, thread: &mut Thread, number: u32) -> Result<()> {
        let words = builtin::argument_words(number).ok_or(FaultKind::BadCode)?;
        let first = Self::shrink(thread, words)?;
        let result = builtin::run(number, self.words(first, words)?);
        let (result, words) = result.ok_or(FaultKind::NotANumber)?;
        for word in result.iter().take(words) {
            self.push(thread, *word)?;
        }
        Ok(())
    }

    fn write_output(&mut self, number: usize, value: u64) -> Result<()> {
        let signal = self.program.system.signals.get(number);
        if signal.is_some_and(|s| s.bits > 0 && value >> s.bits.min(63) != 0) {
            return Err(FaultKind::SignalRange);
        }
        let output = self.outputs.get_mut(number);
        *output.ok_or(FaultKind::BadCode)? = Some(value);
        Ok(())
    }

    /// Signals, time, threads, and the end.
    fn outside(&mut self, number: usize, thread: &mut Thread, i: Instruction) -> Result<Next> {
        match i.opcode {
            Opcode::In => {
                let signal = i.a as usize;
                let written = self.outputs.get(signal).copied().flatten();
                let is_out = self
                    .program
                    .system
                    .signals
                    .get(signal)
                    .is_some_and(|s| s.direction == crate::spec::Direction::Out);
                let value = if is_out {
                    Some(written.unwrap_or(0))
                } else {
                    self.inputs.get(signal).copied().flatten()
                };
                self.push(thread, value.ok_or(FaultKind::NoInput)?)?;
            }
            Opcode::Out => {
                let value = self.pop(thread)?;
                self.write_output(i.a as usize, value)?;
            }
            Opcode::Move => return self.begin_move(number, thread, i),
            Opcode::Sync => {
                let mut robots = self.robots.iter().enumerate();
                let moves =
                    robots.any(|(k, robot)| thread.moved & (1 << k) != 0 && !robot.is_idle());
                if moves {
                    return Ok(Next::Again);
                }
            }
            Opcode::Wait => {
                let until = match thread.until {
                    Some(until) => until,
                    None => self.now() + self.pop_real(thread)?,
                };
                // Less than half a cycle is rounding.
                if self.now() + self.period_s / 2.0 < until {
                    thread.until = Some(until);
                    return Ok(Next::Again);
                }
                thread.until = None;
            }
            Opcode::Yield => return Ok(Next::Later),
            Opcode::Now => {
                let now = self.now().to_bits();
                self.push(thread, now)?;
            }
            Opcode::TimedOut => self.push(thread, thread.timed_out.into())?,
            Opcode::SetTimedOut => thread.timed_out = i.a != 0,
            Opcode::Fork => return self.fork(number, thread, i.a),
            Opcode::Join => {
                let mut threads = self.threads.iter();
                if threads.any(|t| t.is_alive && t.parent == number + 1) {
                    return Ok(Next::Again);
                }
            }
            Opcode::End => return Ok(Next::End),
            Opcode::Pause => {
                self.phase = Phase::Paused;
                return Ok(Next::Later);
            }
            _ => {
                self.halt();
                return Ok(Next::End);
            }
        }
        Ok(Next::Instruction)
    }

    fn fork(&mut self, number: usize, parent: &Thread, target: u32) -> Result<Next> {
        let mut threads = self.threads.iter_mut().enumerate();
        let free = threads.find(|(k, thread)| *k != number && !thread.is_alive);
        let (_, thread) = free.ok_or(FaultKind::BadCode)?;
        *thread = Thread {
            is_alive: true,
            parent: number + 1,
            pc: target,
            fp: parent.fp,
            sp: thread.base,
            base: thread.base,
            timed_out: parent.timed_out,
            ..Thread::default()
        };
        Ok(Next::Instruction)
    }

    fn begin_move(&mut self, number: usize, thread: &mut Thread, i: Instruction) -> Result<Next> {
        let index = i.b as usize;
        let robot = self.robots.get(index).ok_or(FaultKind::BadCode)?;
        if !robot.is_idle() && robot.owner() != number {
            return Err(FaultKind::SharedRobot);
        }
        if !robot.takes_order() {
            return Ok(Next::Again);
        }
        let (target, via) = self.pop_targets(thread, i)?;
        let mut order = self.order(index)?;
        for (bit, (least, most)) in RANGES.iter().enumerate().rev() {
            if i.c & (1 << bit) == 0 {
                continue;
            }
            let value = self.pop_real(thread)?;
            if !(*least..=*most).contains(&value) {
                return Err(FaultKind::Attribute);
            }
            if let Some(attribute) = order.attributes.get_mut(bit) {
                *attribute = value;
            }
        }
        order.path = i.a & MOVE_PATH;
        order.is_incremental = i.a & MOVE_INC != 0;
        order.at = self.location;
        let robot = self.robots.get_mut(index).ok_or(FaultKind::BadCode)?;
        robot.order(order, target, via, number)?;
        thread.moved |= 1 << index;
        Ok(Next::Instruction)
    }

    /// The target, and the auxiliary point of an arc.
    fn pop_targets(&self, thread: &mut Thread, i: Instruction) -> Result<(Target, Option<Target>)> {
        let target = self.pop_target(thread, i.a)?;
        let via = if i.a & MOVE_PATH == 2 {
            Some(self.pop_target(thread, i.a >> 8)?)
        } else {
            None
        };
        Ok((target, via))
    }

    fn pop_target(&self, thread: &mut Thread, kind: u32) -> Result<Target> {
        let words = if kind & MOVE_POSITION != 0 { 3 } else { 7 };
        let first = Self::shrink(thread, words)?;
        let words = self.words(first, words)?;
        if kind & MOVE_JOINTS != 0 {
            let mut joints = [f64::NAN; super::MAIN_JOINTS];
            for (joint, word) in joints.iter_mut().zip(words) {
                *joint = f64::from_bits(*word).to_radians();
            }
            return Ok(Target::Joints(joints));
        }
        if kind & MOVE_POSITION != 0 {
            let mut position = [0.0; 3];
            for (value, word) in position.iter_mut().zip(words) {
                *value = f64::from_bits(*word) / 1000.0;
            }
            let finite = position.iter().all(|v| v.is_finite());
            return finite
                .then_some(Target::Position(position.into()))
                .ok_or(FaultKind::NotANumber);
        }
        let frame = builtin::frame(words).ok_or(FaultKind::NotANumber)?;
        Ok(Target::Frame(frame))
    }

    /// What the record of the robot gives where a motion has no attribute.
    fn order(&self, robot: usize) -> Result<Order> {
        let record = self.program.robot_records.get(robot);
        let first = *record.ok_or(FaultKind::BadCode)? as usize;
        let words = self.words(first, super::RECORD_WORDS as usize)?;
        let real = |at: usize| words.get(at).map_or(f64::NAN, |w| f64::from_bits(*w));
        let frame = |at: usize| {
            let pose = words.get(at..at + 7).unwrap_or_default();
            builtin::frame(pose).ok_or(FaultKind::NotANumber)
        };
        let mut attributes = [0.0; ATTRIBUTES.len()];
        // In the order of the attributes: the record has them in another one.
        for (attribute, at) in attributes.iter_mut().zip([3, 4, 5, 0, 1, 6]) {
            *attribute = real(at);
        }
        attributes[7] = real(2);
        for (bit, (least, most)) in RANGES.iter().enumerate().take(8) {
            let value = attributes.get(bit).copied().unwrap_or(f64::NAN);
            if bit != 6 && !(*least..=*most).contains(&value) {
                return Err(FaultKind::Attribute);
            }
        }
        let mut order = Order::default();
        order.attributes = attributes;
        (order.base, order.tool) = (frame(7)?, frame(14)?);
        Ok(order)
    }
}
