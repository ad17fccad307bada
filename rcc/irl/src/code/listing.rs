//! The listings of object code as text and XML, for review. They are not read back.

use std::fmt::Write as _;

use quick_xml::escape::escape;

use super::{
    ATTRIBUTES, Instruction, LOCAL, MOVE_INC, MOVE_JOINTS, MOVE_PATH, Opcode, Program, RELATIONS,
};
use crate::builtin;

impl Program {
    /// Head, tables and instructions with their locations in the source, one line each.
    #[must_use]
    pub fn listing(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(
            out,
            "program {}: {} instructions, {} threads, {} bytes of memory\nsource crc {:08x}, specification crc {:08x}",
            self.name,
            self.code.len(),
            self.threads,
            self.memory_bytes(),
            self.source_crc,
            self.system_crc
        );
        for robot in &self.system.robots {
            let joints = robot.joints.len();
            let model = if robot.model.is_empty() {
                "joints only"
            } else {
                robot.model.name()
            };
            let _ = writeln!(out, "robot {}: {joints} joints, {model}", robot.name);
        }
        for signal in &self.system.signals {
            let _ = write!(
                out,
                "signal {}: {:?} {:?} {}",
                signal.name, signal.direction, signal.kind, signal.channel
            );
            if signal.bits > 0 {
                let _ = write!(out, ", {} bits", signal.bits);
            }
            if let Some(io) = &signal.io {
                let _ = write!(out, " at {io}");
            }
            out.push('\n');
        }
        for (number, (instruction, location)) in self.code.iter().zip(&self.locations).enumerate() {
            let place = format!("{}:{}", location.line, location.column);
            let text = self.instruction(instruction);
            let _ = writeln!(out, "{number:5}  {place:>7}  {text}");
        }
        out
    }

    /// The same as XML: `<program>` with `<robot>`, `<signal>`, `<variable>` and `<i>`, an instruction with operands and location.
    #[must_use]
    pub fn listing_xml(&self) -> String {
        let mut out = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        let _ = writeln!(
            out,
            "<program name=\"{}\" version=\"{}\" source_crc=\"{:08x}\" specification_crc=\"{:08x}\" threads=\"{}\" \
             memory_bytes=\"{}\">",
            escape(&self.name),
            super::VERSION,
            self.source_crc,
            self.system_crc,
            self.threads,
            self.memory_bytes()
        );
        for robot in &self.system.robots {
            let (name, model) = (escape(&robot.name), escape(robot.model.name()));
            let joints = robot.joints.len();
            let _ = writeln!(
                out,
                "  <robot name=\"{name}\" model=\"{model}\" joints=\"{joints}\"/>"
            );
        }
        for signal in &self.system.signals {
            let (direction, kind) = (
                format!("{:?}", signal.direction).to_lowercase(),
                format!("{:?}", signal.kind).to_lowercase(),
            );
            let _ = write!(
                out,
                "  <signal name=\"{}\" direction=\"{direction}\" kind=\"{kind}\" channel=\"{}\"",
                escape(&signal.name),
                signal.channel
            );
            if signal.bits > 0 {
                let _ = write!(out, " bits=\"{}\"", signal.bits);
            }
            if let Some(io) = &signal.io {
                let _ = write!(out, " io=\"{}\"", escape(io.to_string()));
            }
            out.push_str("/>\n");
        }
        for variable in &self.variables {
            let (name, at) = (escape(&variable.name), variable.at);
            let _ = writeln!(out, "  <variable name=\"{name}\" word=\"{at}\"/>");
        }
        for (number, (i, location)) in self.code.iter().zip(&self.locations).enumerate() {
            let _ = writeln!(
                out,
                "  <i n=\"{number}\" line=\"{}\" column=\"{}\" op=\"{}\" a=\"{}\" b=\"{}\" c=\"{}\">{}</i>",
                location.line,
                location.column,
                i.opcode.text(),
                i.a,
                i.b,
                i.c,
                escape(self.instruction(i))
            );
        }
        out.push_str("</program>\n");
        out
    }

    fn instruction(&self, i: &Instruction) -> String {
        let name = i.opcode.text();
        let scope = if i.a == LOCAL { "local" } else { "global" };
        match i.opcode {
            Opcode::Const => {
                let bits = u64::from(i.a) | u64::from(i.b) << 32;
                let real = f64::from_bits(bits);
                if i.c == 1 {
                    format!("{name} {real:?}")
                } else {
                    format!("{name} {}", bits.cast_signed())
                }
            }
            Opcode::Load | Opcode::Store => format!("{name} {scope} {} words {}", i.b, i.c),
            Opcode::Addr => format!("{name} {scope} {}", i.b),
            Opcode::Index => format!("{name} from {} count {} of {}", i.a.cast_signed(), i.b, i.c),
            Opcode::Call => format!("{name} {} arguments {}", i.a, i.b),
            Opcode::CompareInt | Opcode::CompareReal => {
                format!("{name} {}", RELATIONS.get(i.a as usize).unwrap_or(&"?"))
            }
            Opcode::Builtin => format!("{name} {}", builtin::name(i.a)),
            Opcode::In | Opcode::Out => {
                let signal = self.system.signals.get(i.a as usize);
                format!("{name} {}", signal.map_or("?", |signal| &signal.name))
            }
            Opcode::Move => self.motion(i),
            Opcode::Fetch
            | Opcode::Put
            | Opcode::Drop
            | Opcode::Enter
            | Opcode::Return
            | Opcode::Jump
            | Opcode::Unless
            | Opcode::SetTimedOut
            | Opcode::Fork => format!("{name} {}", i.a),
            _ => name.to_owned(),
        }
    }

    fn motion(&self, i: &Instruction) -> String {
        let path = ["ptp", "lin", "circle"]
            .get((i.a & MOVE_PATH) as usize)
            .unwrap_or(&"?");
        let increment = if i.a & MOVE_INC != 0 { "_inc" } else { "" };
        let to = if i.a & MOVE_JOINTS != 0 {
            "joints"
        } else {
            "frame"
        };
        let robot = self.system.robots.get(i.b as usize);
        let robot = robot.map_or("?", |robot| &robot.name);
        let mut text = format!("move{increment} {path} {to} of {robot}");
        for (bit, name) in ATTRIBUTES.iter().enumerate() {
            if i.c & (1 << bit) != 0 {
                let _ = write!(text, " {name}");
            }
        }
        text
    }
}
