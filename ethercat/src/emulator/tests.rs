//! The emulated segment from the master's side, datagram by datagram, in virtual time.

mod al;
mod coe;
mod commands;
mod drive;
mod events;
mod faults;
mod fuzz;
mod logical;
mod profiles;
mod serve;
mod sii;
mod sync_managers;
mod time;
mod topology;
mod watchdog;
mod youbot;

use super::{Coupler, Entry, Io, Segment, Slave};
use crate::register::{self, Register};
use crate::{Address, AlState, AlStatus, Command, Fmmu, Frame, FrameWriter, SyncManager};

/// A millisecond, ns.
const MS: u64 = 1_000_000;

/// The returned datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Answer {
    data: Vec<u8>,
    counter: u16,
    adp: u16,
    irq: u16,
}

/// A segment and its time.
struct Bench {
    segment: Segment,
    now: u64,
}

impl Bench {
    fn new(slaves: impl IntoIterator<Item = Slave>) -> Self {
        Self {
            segment: Segment::line(slaves),
            now: MS,
        }
    }

    /// Two couplers and a terminal of 8 outputs and 8 inputs, each with firmware.
    fn small() -> (Self, Io) {
        let (terminal, io) = Io::digital(8, 8);
        let slaves = [Coupler::slave(), Coupler::slave(), terminal].map(Slave::with_firmware);
        let mut bench = Self::new(slaves);
        bench.address();
        (bench, io)
    }

    /// Gives station addresses 1000h, 1001h and so on.
    fn address(&mut self) {
        for n in 0..u16::try_from(self.segment.len()).unwrap() {
            let address = (0x1000 + n).to_le_bytes();
            let adp = n.wrapping_neg();
            let answer = self.device(Command::Apwr, adp, register::STATION_ADDRESS, &address);
            assert_eq!(answer.counter, 1);
        }
    }

    /// A frame of one datagram; `None` if it does not return.
    fn try_send(&mut self, command: Command, address: Address, data: &[u8]) -> Option<Answer> {
        let mut buffer = [0; 1514];
        let mut writer = FrameWriter::new(&mut buffer).unwrap();
        writer.push(command, 7, address, data).unwrap();
        let len = writer.finish();
        let returned = self
            .segment
            .process(&mut buffer[..len], Entry::First, self.now);
        self.now += 10_000;
        returned?;
        let frame = Frame::decode(&buffer[..len]).unwrap();
        let datagram = frame.datagrams().next().unwrap().unwrap();
        let adp = match datagram.header.address {
            Address::Device { adp, .. } => adp,
            Address::Logical(_) => 0,
        };
        Some(Answer {
            data: datagram.data.to_vec(),
            counter: datagram.working_counter.raw(),
            adp,
            irq: datagram.header.irq,
        })
    }

    fn device(&mut self, command: Command, adp: u16, ado: u16, data: &[u8]) -> Answer {
        let address = Address::Device { adp, ado };
        self.try_send(command, address, data).unwrap()
    }

    fn logical(&mut self, command: Command, at: u32, data: &[u8]) -> Answer {
        self.try_send(command, Address::Logical(at), data).unwrap()
    }

    fn read<const N: usize>(&mut self, station: u16, at: Register) -> [u8; N] {
        let answer = self.device(Command::Fprd, station, at, &[0; N]);
        assert_eq!(answer.counter, 1, "reading {at:04X}h of {station:04X}h");
        answer.data.try_into().unwrap()
    }

    fn write(&mut self, station: u16, at: Register, data: &[u8]) {
        let answer = self.device(Command::Fpwr, station, at, data);
        assert_eq!(answer.counter, 1, "writing {at:04X}h of {station:04X}h");
    }

    /// State, error bit and code.
    fn al(&mut self, station: u16) -> (AlState, bool, u16) {
        let [low, high, _, _, a, b] = self.read(station, register::AL_STATUS);
        let status = AlStatus::from_raw(u16::from_le_bytes([low, high]));
        (status.state, status.error, u16::from_le_bytes([a, b]))
    }

    /// Requests a state and waits for the answer.
    fn request(&mut self, station: u16, state: AlState, acknowledge: bool) -> (AlState, bool, u16) {
        let control = u16::from(state.raw()) | u16::from(acknowledge) << 4;
        self.write(station, register::AL_CONTROL, &control.to_le_bytes());
        self.now += MS;
        self.al(station)
    }

    /// Sets a SyncManager up and switches it on.
    fn channel(&mut self, station: u16, number: u16, start: u16, len: u16, control: u8) {
        let sm = SyncManager {
            start,
            len,
            control,
            activate: 1,
            ..SyncManager::default()
        };
        self.write(station, register::SYNC_MANAGER + 8 * number, &sm.encode());
    }

    fn fmmu(&mut self, station: u16, number: u16, fmmu: &Fmmu) {
        self.write(station, register::FMMU + 16 * number, &fmmu.encode());
    }

    /// Maps the terminal at 1002h: outputs to logical byte 0, inputs to logical byte 1.
    fn map_terminal(&mut self) {
        self.channel(0x1002, 0, 0x1000, 1, SyncManager::OUTPUTS);
        self.channel(0x1002, 1, 0x1080, 1, SyncManager::INPUTS);
        for (number, physical) in [(0, 0x1000), (1, 0x1080)] {
            let fmmu = Fmmu {
                logical: number,
                len: 1,
                stop_bit: 7,
                physical,
                reads: number == 1,
                writes: number == 0,
                active: true,
                ..Fmmu::default()
            };
            self.fmmu(0x1002, u16::try_from(number).unwrap(), &fmmu);
        }
    }

    /// Brings the mapped terminal at 1002h into OP.
    fn operate(&mut self) {
        self.map_terminal();
        let well = |state| (state, false, 0);
        assert_eq!(
            self.request(0x1002, AlState::PreOp, false),
            well(AlState::PreOp)
        );
        assert_eq!(
            self.request(0x1002, AlState::SafeOp, false),
            well(AlState::SafeOp)
        );
        self.logical(Command::Lrw, 0, &[0, 0]);
        assert_eq!(self.request(0x1002, AlState::Op, false), well(AlState::Op));
    }
}
