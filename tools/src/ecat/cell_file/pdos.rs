//! PDOs that the cell gives a slave. Without an ESI file the slave keeps its assignment and nothing is written.

use std::fmt::Write as _;

use takt_ethercat::master::SlaveView;

use super::{AXIS, axes, comment};
use crate::ecat::esi::{self, Choice, Device, Pdo};

/// Most alternatives that are listed for a slave.
const ALTERNATIVES_MAX: usize = 16;

/// What to assign; `None` leaves it to the slave, or to the axes.
#[derive(Debug, Default)]
pub(super) struct Assigned {
    outputs: Option<Vec<u16>>,
    inputs: Option<Vec<u16>>,
    excluded: Vec<u16>,
    /// What is wrong with the assignment, with its remedy.
    pub(super) notes: Vec<String>,
}

/// The assignment of a slave by its scan and its ESI description.
pub(super) fn assigned(slave: SlaveView<'_>, device: Option<&Device>) -> Assigned {
    let mut all = Assigned::default();
    let Some(device) = device else {
        return all;
    };
    let axes = axes(slave, Some(device));
    for (pdos, outputs, objects) in [
        (&device.rx_pdos, true, [0x6040, 0x607A]),
        (&device.tx_pdos, false, [0x6041, 0x6064]),
    ] {
        let needed = (0..axes).flat_map(|axis| {
            let by = AXIS * u16::try_from(axis).unwrap_or_default();
            objects.map(|index| (index + by, 0))
        });
        let needed: Vec<_> = needed.collect();
        let found = scanned(slave, outputs);
        let default = |pdo: &Pdo| pdo.sync_manager.is_some();
        let choice = if axes > 0 || found.is_empty() {
            esi::choose(pdos, &needed, default)
        } else {
            esi::choose(pdos, &[], |pdo| found.contains(&pdo.index))
        };
        let fixed = |index: &u16| pdos.iter().any(|it| it.index == *index && it.is_fixed);
        // The driver maps the objects of axes itself, unless the PDOs are fixed. Other slaves keep the assignment of the scan
        // after a power cycle only if the cell has it.
        let is_given = if axes > 0 {
            choice.pdos.iter().any(fixed)
        } else {
            let usual = esi::choose(pdos, &[], default);
            device.has_assignment && !found.is_empty() && found != usual.pdos
        };
        all.note(&choice, outputs, is_given);
        let given = is_given.then_some(choice.pdos);
        *(if outputs {
            &mut all.outputs
        } else {
            &mut all.inputs
        }) = given;
    }
    all
}

/// The PDOs of a slave as it is, in order.
fn scanned(slave: SlaveView<'_>, outputs: bool) -> Vec<u16> {
    let channels = slave.process().channels.iter();
    let channels = channels.filter(|channel| channel.outputs == outputs);
    channels
        .flat_map(|it| it.pdos.iter().map(|pdo| pdo.index))
        .collect()
}

impl Assigned {
    fn note(&mut self, choice: &Choice, outputs: bool, is_given: bool) {
        let key = if outputs { "outputs" } else { "inputs" };
        for (pdo, by) in &choice.excluded {
            self.excluded.push(*pdo);
            self.notes.push(format!(
                "PDO {pdo:04X}h is not used: {by:04X}h and it exclude each other\nhint: to use {pdo:04X}h, give the slave \
                 `{key}` without {by:04X}h"
            ));
        }
        let lacking = choice.lacking.iter().filter(|_| is_given);
        self.notes.extend(lacking.map(|(index, sub)| {
            format!(
                "no PDO that can be assigned carries {index:04X}h:{sub:02X}, which its axis needs\nhint: map it in a PDO that \
                 is not fixed, by `{key}`, or see the manual of the drive for another profile"
            )
        }));
    }

    pub(super) fn is_excluded(&self, pdo: u16) -> bool {
        self.excluded.contains(&pdo)
    }

    /// Writes `outputs` and `inputs`, and what could be assigned instead.
    pub(super) fn write(&self, out: &mut String, device: Option<&Device>) {
        for (key, pdos) in [("outputs", &self.outputs), ("inputs", &self.inputs)] {
            if let Some(pdos) = pdos {
                let all = pdos.iter().map(|it| format!("{{ pdo = 0x{it:04X} }}"));
                let _ = writeln!(out, "{key} = [{}]", all.collect::<Vec<_>>().join(", "));
            }
        }
        for note in &self.notes {
            let _ = writeln!(
                out,
                "# {}",
                comment(&note.replace("\nhint:", "; to change it:"))
            );
        }
        let device = device.filter(|device| device.has_assignment);
        let all = device.map(|it| it.rx_pdos.iter().chain(&it.tx_pdos));
        let others = all.into_iter().flatten();
        let others = others.filter(|it| it.sync_manager.is_none() && !it.excludes.is_empty());
        for pdo in others.take(ALTERNATIVES_MAX) {
            let excluded = pdo.excludes.iter().map(|it| format!("{it:04X}h"));
            let _ = writeln!(
                out,
                "# Alternative: PDO {:04X}h \"{}\" instead of {}",
                pdo.index,
                comment(&pdo.name),
                excluded.collect::<Vec<_>>().join(" ")
            );
        }
    }
}
