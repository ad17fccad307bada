//! Slaves without a mailbox: a coupler, and digital or analogue terminals, whose outputs and inputs a test can read and
//! set.

use std::sync::{Arc, Mutex, PoisonError};

use crate::AlState;
use crate::sii::Identity;

use super::application::{Application, Cycle, Plain};
use super::image::{PdoImage, SiiImage};
use super::slave::{Slave, SlaveConfig};

/// Vendor number of the emulated slaves: an unassigned one.
pub(super) const VENDOR: u32 = 0x0000_7A87;

/// A coupler: no process data.
#[derive(Clone, Copy, Debug, Default)]
pub struct Coupler;

impl Coupler {
    /// A slave with this application.
    pub fn slave() -> Slave {
        let sii = SiiImage {
            identity: Identity {
                vendor: VENDOR,
                product: 0x1100,
                revision: 0x0001_0000,
                serial: 0,
            },
            order: "TK1100".to_owned(),
            name: "TK1100 coupler".to_owned(),
            ebus_ma: -2000,
            clock: true,
            device_emulation: true,
            ..SiiImage::default()
        };
        Slave::new(SlaveConfig::new(sii), Box::new(Plain))
    }
}

/// The terminals of an [`Io`] slave; shared with the test.
#[derive(Clone, Debug, Default)]
pub struct Io {
    /// Outputs as last set by the master, bytes; zero outside of OP.
    outputs: Arc<Mutex<Vec<u8>>>,
    /// Inputs to send, bytes.
    inputs: Arc<Mutex<Vec<u8>>>,
}

impl Io {
    /// A terminal of `outputs` and `inputs` digital channels of one bit, and this handle to them.
    pub fn digital(outputs: u8, inputs: u8) -> (Slave, Self) {
        let pdos = |first: u16, sm: u8, count: u8, name: &str| {
            (0..u16::from(count))
                .map(|n| PdoImage {
                    index: first + n,
                    sync_manager: sm,
                    name: format!("{name} {}", n + 1),
                    entries: vec![(if sm == 0 { 0x7000 } else { 0x6000 } + 0x10 * n, 1, 1, 1)],
                })
                .collect()
        };
        let name = format!("TK{outputs:02}{inputs:02} digital");
        let (rx, tx) = (
            pdos(0x1600, 0, outputs, "output"),
            pdos(0x1A00, 1, inputs, "input"),
        );
        let product = 0x2000 + (u32::from(outputs) << 8) + u32::from(inputs);
        Self::terminal(name, product, rx, tx)
    }

    /// A terminal of `outputs` and `inputs` analogue channels of 16 bits, and this handle to them.
    pub fn analogue(outputs: u8, inputs: u8) -> (Slave, Self) {
        let pdos = |first: u16, sm: u8, count: u8, name: &str| {
            (0..u16::from(count))
                .map(|n| PdoImage {
                    index: first + n,
                    sync_manager: sm,
                    name: format!("{name} {}", n + 1),
                    entries: vec![(
                        if sm == 0 { 0x7000 } else { 0x6000 } + 0x10 * n,
                        0x11,
                        16,
                        3,
                    )],
                })
                .collect()
        };
        let name = format!("TK{outputs:02}{inputs:02} analogue");
        let (rx, tx) = (
            pdos(0x1600, 0, outputs, "output"),
            pdos(0x1A00, 1, inputs, "input"),
        );
        let product = 0x4000 + (u32::from(outputs) << 8) + u32::from(inputs);
        Self::terminal(name, product, rx, tx)
    }

    /// A terminal with these PDOs, and this handle to it. The first word of its name is its order code.
    pub fn terminal(
        name: String,
        product: u32,
        rx: Vec<PdoImage>,
        tx: Vec<PdoImage>,
    ) -> (Slave, Self) {
        let sii = SiiImage {
            identity: Identity {
                vendor: VENDOR,
                product,
                revision: 0x0001_0000,
                serial: 0,
            },
            order: name.split(' ').next().unwrap_or_default().to_owned(),
            name,
            ebus_ma: 100,
            rx_pdos: rx,
            tx_pdos: tx,
            device_emulation: true,
            ..SiiImage::default()
        };
        let io = Self::default();
        (Slave::new(SlaveConfig::new(sii), Box::new(io.clone())), io)
    }

    /// Outputs as the master last set them; all zero outside of OP.
    pub fn outputs(&self) -> Vec<u8> {
        self.outputs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Sets the inputs.
    pub fn set_inputs(&self, inputs: &[u8]) {
        *self.inputs.lock().unwrap_or_else(PoisonError::into_inner) = inputs.to_vec();
    }
}

impl Application for Io {
    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        let mut outputs = self.outputs.lock().unwrap_or_else(PoisonError::into_inner);
        match cycle.outputs {
            Some(new) if cycle.state == AlState::Op => {
                outputs.clear();
                outputs.extend_from_slice(new);
            }
            _ => outputs.fill(0),
        }
        drop(outputs);
        let wanted = self.inputs.lock().unwrap_or_else(PoisonError::into_inner);
        for (to, from) in inputs.iter_mut().zip(wanted.iter()) {
            *to = *from;
        }
    }
}
