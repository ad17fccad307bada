//! The binary form of object code. All numbers are little endian; texts and lists begin with their length as u32.
//!
//! | offset | bytes | content |
//! |---|---|---|
//! | 0 | 4 | `TIRL` |
//! | 4 | 2 | version |
//! | 6 | 4 | CRC-32 (IEEE) of all that follows |
//! | 10 | | name, CRC of source, CRC of specification, robots, signals, texts, variables, instructions, sizes |
//!
//! A file of another version, with a wrong sum, or whose content contradicts itself, is refused. Nothing is read from disk
//! here.

use super::{
    INSTRUCTIONS_MAX, Instruction, Location, Opcode, Program, Scalar, THREADS_MAX, Variable,
    WORDS_MAX,
};
use crate::spec::{Direction, Joint, Robot, Signal, SignalKind, System};

const MAGIC: &[u8; 4] = b"TIRL";
/// Version of the binary form.
pub const VERSION: u16 = 2;
const HEADER: usize = 10;

/// Why object code is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CodeError {
    /// It does not begin as object code does.
    #[error("this is not L-IRL object code\nhint: compile the source: `takt irl compile`")]
    Foreign,
    /// It has another version.
    #[error(
        "the object code has version {0}, this program reads version {VERSION}\nhint: compile the source again: \
         `takt irl compile`"
    )]
    Version(u16),
    /// Bytes have changed since it was written.
    #[error(
        "the object code is damaged: its sum is {found:08x}, not {expected:08x}\nhint: copy it again, or compile the \
         source again"
    )]
    Damaged {
        /// As stated.
        expected: u32,
        /// As computed.
        found: u32,
    },
    /// It ends early, or its content contradicts itself.
    #[error("the object code is invalid at byte {at}: {why}\nhint: compile the source again")]
    Invalid {
        /// Offset in the file.
        at: usize,
        /// The contradiction.
        why: &'static str,
    },
}

struct Writer(Vec<u8>);

#[expect(
    clippy::cast_possible_truncation,
    reason = "lists are bounded far below 2^32 by the compiler"
)]
impl Writer {
    fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }
    fn f64(&mut self, value: f64) {
        self.0.extend(value.to_le_bytes());
    }
    fn text(&mut self, text: &str) {
        self.u32(text.len() as u32);
        self.0.extend(text.as_bytes());
    }
    fn list<T>(&mut self, items: &[T], mut write: impl FnMut(&mut Self, &T)) {
        self.u32(items.len() as u32);
        items.iter().for_each(|item| write(self, item));
    }
}

struct Reader<'d> {
    data: &'d [u8],
    at: usize,
}

impl<'d> Reader<'d> {
    fn invalid(&self, why: &'static str) -> CodeError {
        CodeError::Invalid { at: self.at, why }
    }

    fn take(&mut self, len: usize) -> Result<&'d [u8], CodeError> {
        let end = self.at.checked_add(len);
        let bytes = end.and_then(|end| self.data.get(self.at..end));
        let bytes = bytes.ok_or_else(|| self.invalid("it ends early"))?;
        self.at += len;
        Ok(bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CodeError> {
        let bytes = self.take(N)?;
        bytes.try_into().map_err(|_| self.invalid("it ends early"))
    }

    fn u8(&mut self) -> Result<u8, CodeError> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn u32(&mut self) -> Result<u32, CodeError> {
        self.array().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, CodeError> {
        self.array().map(f64::from_le_bytes)
    }

    fn text(&mut self) -> Result<String, CodeError> {
        let len = self.u32()? as usize;
        let bytes = self.take(len)?;
        String::from_utf8(bytes.to_vec()).map_err(|_| self.invalid("a text is not UTF-8"))
    }

    /// The list takes no more memory than its bytes: each item has at least one.
    fn list<T>(
        &mut self,
        mut read: impl FnMut(&mut Self) -> Result<T, CodeError>,
    ) -> Result<Vec<T>, CodeError> {
        let len = self.u32()? as usize;
        if len > self.data.len() - self.at {
            return Err(self.invalid("a list is longer than the file"));
        }
        (0..len).map(|_| read(self)).collect()
    }
}

fn write_robot(w: &mut Writer, robot: &Robot) {
    w.text(&robot.name);
    w.text(&robot.model.text());
    w.list(&robot.joints, |w, joint| {
        for value in [
            joint.min,
            joint.max,
            joint.speed,
            joint.acceleration,
            joint.jerk,
        ] {
            w.f64(value);
        }
    });
    for value in [
        robot.speed,
        robot.acceleration,
        robot.jerk,
        robot.speed_ori,
        robot.speed_ptp,
        robot.acc_ptp,
    ] {
        w.f64(value);
    }
    for value in robot.base.iter().chain(&robot.tool) {
        w.f64(*value);
    }
    w.list(&robot.home, |w, value| w.f64(*value));
}

fn read_robot(r: &mut Reader<'_>) -> Result<Robot, CodeError> {
    let (name, model) = (r.text()?, r.text()?);
    let model = model.parse();
    let model = model.map_err(|_| r.invalid("a model is no chain of joints"))?;
    let joints = r.list(|r| {
        Ok(Joint {
            min: r.f64()?,
            max: r.f64()?,
            speed: r.f64()?,
            acceleration: r.f64()?,
            jerk: r.f64()?,
        })
    })?;
    let mut robot = Robot {
        name,
        model,
        joints,
        speed: r.f64()?,
        acceleration: r.f64()?,
        jerk: r.f64()?,
        speed_ori: r.f64()?,
        speed_ptp: r.f64()?,
        acc_ptp: r.f64()?,
        base: [0.0; 6],
        tool: [0.0; 6],
        home: Vec::new(),
    };
    for value in robot.base.iter_mut().chain(&mut robot.tool) {
        *value = r.f64()?;
    }
    robot.home = r.list(Reader::f64)?;
    Ok(robot)
}

impl Program {
    /// The binary form.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let mut w = Writer(Vec::new());
        w.text(&self.name);
        w.u32(self.source_crc);
        w.u32(self.system_crc);
        w.list(&self.system.robots, write_robot);
        w.list(&self.system.signals, |w, signal| {
            w.text(&signal.name);
            w.0.push(signal.direction as u8);
            w.0.push(signal.kind as u8);
            w.u32(signal.channel.into());
            w.0.push(signal.bits);
            let io = signal.io.as_ref();
            w.text(&io.map_or_else(String::new, ToString::to_string));
        });
        w.list(&self.texts, |w, text| w.text(text));
        w.list(&self.variables, |w, variable| {
            w.text(&variable.name);
            w.u32(variable.at);
            w.0.push(variable.scalar as u8);
        });
        let located: Vec<_> = self.code.iter().zip(&self.locations).collect();
        w.list(&located, |w, (instruction, location)| {
            w.0.push(instruction.opcode as u8);
            for value in [
                instruction.a,
                instruction.b,
                instruction.c,
                location.line,
                location.column,
            ] {
                w.u32(value);
            }
        });
        for value in [self.globals, self.stack, self.calls, self.threads] {
            w.u32(value);
        }
        w.list(&self.robot_records, |w, at| w.u32(*at));
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        out.extend(crc32fast::hash(&w.0).to_le_bytes());
        out.extend(w.0);
        out
    }

    /// Reads the binary form, and checks that the interpreter can execute it.
    ///
    /// # Errors
    /// If it is foreign, of another version, damaged, or contradicts itself.
    pub fn decode(data: &[u8]) -> Result<Self, CodeError> {
        if data.get(..4) != Some(MAGIC) {
            return Err(CodeError::Foreign);
        }
        let mut r = Reader { data, at: 4 };
        let version = u16::from_le_bytes(r.array()?);
        if version != VERSION {
            return Err(CodeError::Version(version));
        }
        let expected = r.u32()?;
        let found = crc32fast::hash(data.get(HEADER..).unwrap_or_default());
        if expected != found {
            return Err(CodeError::Damaged { expected, found });
        }
        let program = Self::read(&mut r)?;
        if r.at != data.len() {
            return Err(r.invalid("bytes follow its end"));
        }
        program.verify().map_err(|why| r.invalid(why))?;
        Ok(program)
    }

    fn read(r: &mut Reader<'_>) -> Result<Self, CodeError> {
        let name = r.text()?;
        let (source_crc, system_crc) = (r.u32()?, r.u32()?);
        let robots = r.list(read_robot)?;
        let signals = r.list(|r| {
            Ok(Signal {
                name: r.text()?,
                direction: match r.u8()? {
                    0 => Direction::In,
                    1 => Direction::Out,
                    _ => return Err(r.invalid("a signal has no known direction")),
                },
                kind: match r.u8()? {
                    0 => SignalKind::Digital,
                    1 => SignalKind::Analog,
                    2 => SignalKind::Binary,
                    _ => return Err(r.invalid("a signal has no known kind")),
                },
                channel: u16::try_from(r.u32()?)
                    .map_err(|_| r.invalid("a channel is out of range"))?,
                bits: r.u8()?,
                io: match r.text()?.as_str() {
                    "" => None,
                    io => Some(
                        io.parse()
                            .map_err(|_| r.invalid("a signal has no device"))?,
                    ),
                },
            })
        })?;
        let texts = r.list(Reader::text)?;
        let variables = r.list(|r| {
            Ok(Variable {
                name: r.text()?,
                at: r.u32()?,
                scalar: match r.u8()? {
                    0 => Scalar::Int,
                    1 => Scalar::Real,
                    2 => Scalar::Bool,
                    _ => return Err(r.invalid("a variable has no known type")),
                },
            })
        })?;
        let located = r.list(|r| {
            let code = r.u8()?;
            let opcode = Opcode::ALL.iter().find(|known| **known as u8 == code);
            let opcode = *opcode.ok_or_else(|| r.invalid("an instruction is not known"))?;
            let (a, b, c) = (r.u32()?, r.u32()?, r.u32()?);
            let (line, column) = (r.u32()?, r.u32()?);
            Ok((Instruction { opcode, a, b, c }, Location { line, column }))
        })?;
        let (code, locations) = located.into_iter().unzip();
        Ok(Self {
            name,
            source_crc,
            system_crc,
            system: System { robots, signals },
            texts,
            variables,
            code,
            locations,
            globals: r.u32()?,
            stack: r.u32()?,
            calls: r.u32()?,
            threads: r.u32()?,
            robot_records: r.list(Reader::u32)?,
        })
    }

    /// What the interpreter relies on, beside what it checks in each step.
    fn verify(&self) -> Result<(), &'static str> {
        if self.system.check().is_err() {
            return Err("a robot or signal is invalid");
        }
        if self.code.is_empty() || self.code.len() > INSTRUCTIONS_MAX {
            return Err("the number of instructions is out of range");
        }
        if !(1..=THREADS_MAX).contains(&self.threads) || self.calls > 1024 {
            return Err("the number of threads or calls is out of range");
        }
        if self.globals > WORDS_MAX || self.stack > WORDS_MAX / THREADS_MAX {
            return Err("its memory is out of range");
        }
        if self.robot_records.len() != self.system.robots.len() {
            return Err("the records of its robots are missing");
        }
        let fits = |at: &u32| at.checked_add(crate::machine::RECORD_WORDS) <= Some(self.globals);
        if !self.robot_records.iter().all(fits) {
            return Err("the record of a robot is out of range");
        }
        if self.variables.iter().any(|v| v.at >= self.globals) {
            return Err("a variable is out of range");
        }
        let targets = |i: &&Instruction| {
            matches!(
                i.opcode,
                Opcode::Jump | Opcode::Unless | Opcode::Call | Opcode::Fork
            )
        };
        let mut jumps = self.code.iter().filter(targets);
        if jumps.any(|i| i.a as usize >= self.code.len()) {
            return Err("a jump leads out of the program");
        }
        let robots = u32::try_from(self.system.robots.len()).unwrap_or(0);
        let mut moves = self.code.iter().filter(|i| i.opcode == Opcode::Move);
        if moves.any(|i| i.b >= robots) {
            return Err("a motion has no robot");
        }
        Ok(())
    }
}
