//! Deviations of real nodes from CiA 301 as switches; each was observed on a device. They act on frames only, not on
//! the objects and the state machine of the node.

use std::collections::VecDeque;
use std::time::Duration;

use takt_cia402::dictionary::AbortCode;

use crate::Frame;
use crate::canopen::pdo::Direction;
use crate::canopen::sdo::{Initiate, Message, Request, Response};
use crate::canopen::{Emergency, NodeId};

/// Maximum requests kept until boot-up.
const EARLY_MAX: usize = 8;
/// Maximum delayed responses; further ones are lost.
const LATE_MAX: usize = 64;

/// Deviations of a node from the standard; none by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NodeQuirks {
    /// Delay from power-on or reset to the boot-up message. Real nodes take 5 to 500 ms and ignore frames until then.
    pub boot_up: Duration,
    /// Emergencies after the boot-up message, with their delays. They are not cleared.
    pub emergencies: Vec<(Duration, Emergency)>,
    /// Minimum and maximum delay of SDO responses.
    pub sdo_delay: (Duration, Duration),
    /// Answers requests from before the boot-up message after it.
    pub stale_answers: bool,
    /// Unused bytes of SDO responses are not zero: noise after a short value, and the written data in the response to a
    /// write.
    pub noise: bool,
    /// Bits of PDO COB-IDs that always read as 1.
    pub cob_high: u32,
    /// Bits of PDO COB-IDs that always read as 0.
    pub cob_low: u32,
    /// Missing objects, by index.
    pub absent: Vec<u16>,
    /// Additional responses to each request, each shifted by one more byte: as from a microcontroller with a faulty
    /// driver.
    pub repeats: u8,
}

impl NodeQuirks {
    /// Quirks by name; see [`Self::NAMES`].
    pub fn named(name: &str) -> Option<Self> {
        let (ms, us) = (Duration::from_millis, Duration::from_micros);
        let emergency = |code| Emergency {
            code,
            register: 0x01,
            data: [0; 5],
        };
        let plain = Self::default();
        Some(match name {
            "none" => plain,
            // The manufacturer's codes for "stopped" and "reset communication".
            "late-boot-up" => Self {
                boot_up: us(14_400),
                emergencies: vec![
                    (us(2_500), emergency(0x81B0)),
                    (us(4_800), emergency(0x81A0)),
                ],
                ..plain
            },
            "slow-boot-up" => Self {
                boot_up: ms(500),
                ..plain
            },
            "slow-sdo" => Self {
                sdo_delay: (us(2_600), us(6_600)),
                ..plain
            },
            "stale-answers" => Self {
                boot_up: ms(500),
                stale_answers: true,
                ..plain
            },
            "noise" => Self {
                noise: true,
                ..plain
            },
            "cob-bits-set" => Self {
                cob_high: 0x7000_0000,
                ..plain
            },
            "cob-bits-clear" => Self {
                cob_low: 0x7000_0000,
                ..plain
            },
            "no-6502h" => Self {
                absent: vec![0x6502],
                ..plain
            },
            "repeated-answers" => Self {
                repeats: 9,
                ..plain
            },
            _ => return None,
        })
    }

    /// Names accepted by [`Self::named`].
    pub const NAMES: [&'static str; 10] = [
        "none",
        "late-boot-up",
        "slow-boot-up",
        "slow-sdo",
        "stale-answers",
        "noise",
        "cob-bits-set",
        "cob-bits-clear",
        "no-6502h",
        "repeated-answers",
    ];

    /// Combines the deviations of both.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.boot_up = self.boot_up.max(other.boot_up);
        self.emergencies.extend(other.emergencies);
        self.sdo_delay.0 = self.sdo_delay.0.max(other.sdo_delay.0);
        self.sdo_delay.1 = self.sdo_delay.1.max(other.sdo_delay.1);
        self.stale_answers |= other.stale_answers;
        self.noise |= other.noise;
        self.cob_high |= other.cob_high;
        self.cob_low |= other.cob_low;
        self.absent.extend(other.absent);
        self.repeats = self.repeats.max(other.repeats);
        self
    }
}

/// Run-time state of the quirks.
#[derive(Debug)]
pub(super) struct ActiveQuirks {
    pub(super) quirks: NodeQuirks,
    /// Time of the boot-up message.
    pub(super) boot_due: Option<Duration>,
    booted: Option<Duration>,
    /// Number of emergencies raised since boot-up.
    raised: usize,
    early: VecDeque<Message>,
    late: VecDeque<(Duration, Frame)>,
    dice: u64,
}

impl ActiveQuirks {
    pub(super) fn new(quirks: NodeQuirks, node: NodeId) -> Self {
        Self {
            quirks,
            boot_due: None,
            booted: None,
            raised: 0,
            early: VecDeque::new(),
            late: VecDeque::new(),
            dice: 0x5eed_0000 + u64::from(node.raw()),
        }
    }

    /// Starts; returns whether the boot-up message is due at once.
    pub(super) fn begin(&mut self, now: Duration) -> bool {
        (self.booted, self.raised) = (None, 0);
        self.late.clear();
        if self.quirks.boot_up.is_zero() {
            self.boot_due = None;
            self.booted = Some(now);
            return true;
        }
        self.boot_due = Some(now + self.quirks.boot_up);
        false
    }

    /// Whether the boot-up message is due; returned once.
    pub(super) fn take_boot_up(&mut self, now: Duration) -> bool {
        let due = self.boot_due.is_some_and(|due| now >= due);
        if due {
            self.boot_due = None;
            self.booted = Some(now);
        }
        due
    }

    /// The next due emergency.
    pub(super) fn take_emergency(&mut self, now: Duration) -> Option<Emergency> {
        let (after, emergency) = self.quirks.emergencies.get(self.raised)?;
        if now < self.booted? + *after {
            return None;
        }
        self.raised += 1;
        Some(*emergency)
    }

    /// Handles a request before boot-up; keeps it if the quirk is set.
    pub(super) fn keep(&mut self, request: &[u8]) {
        if self.quirks.stale_answers
            && self.early.len() < EARLY_MAX
            && let Some(message) = request.first_chunk()
        {
            self.early.push_back(*message);
        }
    }

    pub(super) fn take_early(&mut self) -> Option<Message> {
        self.early.pop_front()
    }

    /// The abort for a request to a missing object.
    pub(super) fn abort_absent(&self, request: &Message) -> Option<Message> {
        let address = match Request::decode(request)? {
            Request::Download { address, .. }
            | Request::Upload { address }
            | Request::BlockDownload { address, .. }
            | Request::BlockUpload { address, .. } => address,
            Request::DownloadSegment { .. }
            | Request::UploadSegment { .. }
            | Request::BlockDownloadEnd { .. }
            | Request::BlockUploadStart
            | Request::BlockUploadAck { .. }
            | Request::BlockUploadEnd
            | Request::Abort { .. } => return None,
        };
        let code = AbortCode::NoObject;
        let absent = self.quirks.absent.contains(&address.index);
        absent.then(|| Response::Abort { address, code }.encode())
    }

    /// Applies the quirks to a response.
    pub(super) fn shape(&mut self, request: &Message, mut answer: Message) -> Message {
        match Response::decode(&answer) {
            Some(Response::Upload { address, data }) => {
                let Initiate::Expedited(data) = data else {
                    return answer;
                };
                let pdo = Direction::of(address.index).is_some_and(|(.., mapping)| !mapping);
                if pdo && address.sub == 1 {
                    let [.., a, b, c, d] = answer;
                    let raw = u32::from_le_bytes([a, b, c, d]);
                    let raw = (raw | self.quirks.cob_high) & !self.quirks.cob_low;
                    answer[4..].copy_from_slice(&raw.to_le_bytes());
                }
                if self.quirks.noise {
                    let noise = self.roll().to_le_bytes();
                    let unused = answer.iter_mut().zip(noise).skip(4 + data.as_slice().len());
                    unused.for_each(|(byte, noise)| *byte = noise | 1);
                }
            }
            Some(Response::Download { .. }) if self.quirks.noise => {
                answer[4..].copy_from_slice(&request[4..]);
            }
            Some(_) | None => {}
        }
        answer
    }

    const fn roll(&mut self) -> u64 {
        self.dice ^= self.dice << 13;
        self.dice ^= self.dice >> 7;
        self.dice ^= self.dice << 17;
        self.dice
    }

    /// Whether responses are delayed or repeated.
    pub(super) const fn delays(&self) -> bool {
        !self.quirks.sdo_delay.1.is_zero() || self.quirks.repeats > 0
    }

    /// Queues a response and its repetitions until they are due.
    pub(super) fn delay(&mut self, frame: Frame, now: Duration) {
        let (least, most) = self.quirks.sdo_delay;
        let spread = u64::try_from(most.saturating_sub(least).as_micros()).unwrap_or(u64::MAX);
        let further = Duration::from_micros(self.roll() % spread.saturating_add(1));
        let due = now + least + further;
        let shifted = |by: usize| {
            let mut data = [0; 8];
            let from = frame.data().first_chunk::<8>().copied().unwrap_or_default();
            data.iter_mut()
                .skip(by)
                .zip(from)
                .for_each(|(to, from)| *to = from);
            Frame::new(frame.id(), &data).unwrap_or(frame)
        };
        for by in 0..=usize::from(self.quirks.repeats) {
            if self.late.len() < LATE_MAX {
                self.late.push_back((due, shifted(by % 8)));
            }
        }
    }

    /// The next due response.
    pub(super) fn take_late(&mut self, now: Duration) -> Option<Frame> {
        let (due, _) = self.late.front()?;
        if *due > now {
            return None;
        }
        self.late.pop_front().map(|(_, frame)| frame)
    }

    /// Whether responses are queued.
    pub(super) fn has_late(&self) -> bool {
        !self.late.is_empty()
    }

    /// Time of the next poll.
    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        let late = self.late.front().map(|(due, _)| *due);
        let emergency = self.quirks.emergencies.get(self.raised);
        let emergency = emergency.and_then(|(after, _)| Some(self.booted? + *after));
        [self.boot_due, late, emergency].into_iter().flatten().min()
    }
}
