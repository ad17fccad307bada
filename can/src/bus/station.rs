//! A station of the bus: queues and error counters. [`super::Bus`] decides what is on the wire.

use std::collections::VecDeque;
use std::time::Duration;

use super::Config;
use crate::bits::Rates;
use crate::fault::{class, controller};
use crate::link::{LinkError, Origin, Received};
use crate::{AnyFrame, BusState, ErrorFrame};

/// Error counters of ISO 11898-1, clause 12.1.4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Transmit error counter (TEC); above 255 the port is bus-off.
    pub transmit: u16,
    /// Receive error counter (REC).
    pub receive: u16,
}

impl Counters {
    /// The bus state that follows from the counters.
    pub const fn state(self) -> BusState {
        BusState::of_counters(self.transmit, self.receive)
    }
}

/// Bus-off recovery: 128 occurrences of 11 recessive bits.
const RECOVERY_BITS: u32 = 128 * 11;

#[derive(Debug)]
pub(super) struct Station {
    pub(super) rates: Rates,
    pub(super) outbox: VecDeque<AnyFrame>,
    outbox_len: usize,
    pub(super) inbox: VecDeque<Received>,
    inbox_len: usize,
    dropped: u32,
    pub(super) counters: Counters,
    pub(super) restart_at: Option<Duration>,
    pub(super) listen_only: bool,
    pub(super) echo: bool,
}

impl Station {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            rates: config.rates,
            outbox: VecDeque::with_capacity(config.send_queue),
            outbox_len: config.send_queue,
            inbox: VecDeque::with_capacity(config.receive_queue),
            inbox_len: config.receive_queue,
            dropped: 0,
            counters: Counters::default(),
            restart_at: None,
            listen_only: false,
            echo: false,
        }
    }

    pub(super) fn queue(&mut self, frame: AnyFrame) -> Result<(), LinkError> {
        if self.outbox.len() >= self.outbox_len {
            return Err(LinkError::QueueFull);
        }
        self.outbox.push_back(frame);
        Ok(())
    }

    /// Whether it can destroy a frame by an active error flag.
    pub(super) fn may_destroy(&self) -> bool {
        !self.listen_only && self.counters.state() < BusState::ErrorPassive
    }

    pub(super) fn acknowledges(&self) -> bool {
        !self.listen_only && self.counters.state() != BusState::BusOff
    }

    fn push(&mut self, frame: AnyFrame, at: Duration, origin: Origin) {
        if self.inbox.len() >= self.inbox_len {
            self.dropped = self.dropped.saturating_add(1);
            return;
        }
        self.inbox.push_back(Received {
            frame,
            at,
            hardware: None,
            origin,
            dropped: self.dropped,
        });
    }

    /// Its own frame was transmitted.
    pub(super) fn sent(&mut self, at: Duration) {
        let before = self.counters.state();
        self.counters.transmit = self.counters.transmit.saturating_sub(1);
        let frame = self.outbox.pop_front();
        if let Some(frame) = frame.filter(|_| self.echo) {
            self.push(frame, at, Origin::Own);
        }
        self.report_state(before, at);
    }

    /// Receives a frame of another station.
    pub(super) fn receive(&mut self, frame: &AnyFrame, at: Duration) {
        let before = self.counters.state();
        if before == BusState::BusOff {
            return;
        }
        self.counters.receive = match self.counters.receive {
            // From error-passive, one good frame is enough to become error-active.
            128.. => 127,
            count => count.saturating_sub(1),
        };
        self.push(*frame, at, Origin::Bus);
        self.report_state(before, at);
    }

    /// A frame was destroyed: raises the counters and reports the error.
    pub(super) fn fail(
        &mut self,
        transmit: u16,
        receive: u16,
        report: ErrorFrame,
        at: Duration,
        restart: Option<Duration>,
    ) {
        let before = self.counters.state();
        if before == BusState::BusOff {
            return;
        }
        self.counters.transmit += transmit;
        self.counters.receive = (self.counters.receive + receive).min(255);
        self.push(self.with_counters(report).into(), at, Origin::Bus);
        self.schedule_restart(before, at, restart);
        self.report_state(before, at);
    }

    pub(super) fn set_counters(
        &mut self,
        counters: Counters,
        at: Duration,
        restart: Option<Duration>,
    ) {
        let before = self.counters.state();
        self.counters = counters;
        self.schedule_restart(before, at, restart);
        self.report_state(before, at);
    }

    /// Schedules the restart of a port that has just gone bus-off.
    fn schedule_restart(&mut self, before: BusState, at: Duration, restart: Option<Duration>) {
        if self.counters.state() == BusState::BusOff && before != BusState::BusOff {
            let recovery = crate::bits::Bits {
                nominal: RECOVERY_BITS,
                data: 0,
            };
            self.restart_at = restart.map(|wait| at + wait + recovery.time(self.rates));
        }
    }

    pub(super) fn restart(&mut self, at: Duration) {
        if self.counters.state() == BusState::BusOff {
            self.counters = Counters::default();
            let report = ErrorFrame::new(class::RESTARTED, [0; 8]);
            self.push(report.into(), at, Origin::Bus);
        }
        self.restart_at = None;
    }

    /// Reports a change of state by an error frame.
    fn report_state(&mut self, before: BusState, at: Duration) {
        let state = self.counters.state();
        if state == before {
            return;
        }
        let by_transmit = self.counters.transmit >= self.counters.receive;
        let side = |transmit, receive| if by_transmit { transmit } else { receive };
        let (class, flags) = match state {
            BusState::BusOff => (class::BUS_OFF, 0),
            BusState::ErrorPassive => (
                class::CONTROLLER,
                side(controller::TX_PASSIVE, controller::RX_PASSIVE),
            ),
            BusState::ErrorWarning => (
                class::CONTROLLER,
                side(controller::TX_WARNING, controller::RX_WARNING),
            ),
            BusState::ErrorActive | BusState::Stopped => (class::CONTROLLER, controller::ACTIVE),
        };
        let report = ErrorFrame::new(class, [0, flags, 0, 0, 0, 0, 0, 0]);
        self.push(self.with_counters(report).into(), at, Origin::Bus);
    }

    fn with_counters(&self, report: ErrorFrame) -> ErrorFrame {
        let byte = |count: u16| u8::try_from(count).unwrap_or(u8::MAX);
        let mut data = report.data;
        [data[6], data[7]] = [byte(self.counters.transmit), byte(self.counters.receive)];
        ErrorFrame::new(report.class() | class::COUNTERS, data)
    }
}
