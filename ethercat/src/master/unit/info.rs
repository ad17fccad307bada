//! Information about a slave: information registers, links, SII. Nothing is requested here.

use crate::sii::{Identity, MailboxAreas, Sii, word};

/// Information about a slave.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SlaveInfo {
    /// Vendor, product, revision, serial number.
    pub identity: Identity,
    /// Station alias.
    pub alias: u16,
    /// Name, from the SII.
    pub name: String,
    /// Order code, from the SII.
    pub order: String,
    /// Type of the slave controller, register 0000h.
    pub controller: u8,
    /// Number of FMMUs.
    pub fmmus: u8,
    /// Number of SyncManagers.
    pub sync_managers: u8,
    /// Features, register 0008h.
    pub features: u16,
    /// PDI type, register 0140h.
    pub pdi: u8,
    /// ESC configuration, register 0141h: bit 0 AL status is AL control.
    pub configuration: u8,
    /// Whether the system time (0910h) answers: chips announce a clock in 0008h even if the unit is disabled.
    pub system_time: bool,
    /// DL status, register 0110h.
    pub dl_status: u16,
    /// Mailboxes; lengths of zero if it has none.
    pub mailbox: MailboxAreas,
    /// Mailboxes in BOOT; lengths of zero if it has none.
    pub boot_mailbox: MailboxAreas,
    /// Protocols of the mailbox: bit 0 AoE, 1 EoE, 2 CoE, 3 FoE, 4 SoE, 5 VoE.
    pub protocols: u16,
    /// CoE details: bit 0 SDO, 1 information, 2 PDO assignment, 3 PDO configuration, 5 complete access.
    pub coe: u8,
    /// Flags of General in the SII.
    pub flags: u8,
    /// Current taken from the E-bus; negative is given, mA.
    pub ebus_ma: i16,
    /// Whether the checksum of the SII is right.
    pub sii_checked: bool,
}

/// One port of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Port {
    /// A link is detected.
    pub link: bool,
    /// Frames are forwarded and returned there.
    pub open: bool,
}

impl SlaveInfo {
    /// Its ports 0 to 3.
    pub fn ports(&self) -> [Port; 4] {
        std::array::from_fn(|port| Port {
            link: self.dl_status >> (4 + port) & 1 != 0,
            // Loop open and communication established: the link bit alone is not sufficient.
            open: self.dl_status >> (8 + 2 * port) & 3 == 2,
        })
    }

    /// Whether it announces a distributed clock (0008h bit 2). A disabled unit still latches receive times.
    pub const fn announces_clock(&self) -> bool {
        self.features & 0x0004 != 0
    }

    /// Whether it has a distributed clock: announced and answering.
    pub const fn has_clock(&self) -> bool {
        self.announces_clock() && self.system_time
    }

    /// Width of its clock: 64 or 32 bits (0008h bit 3).
    pub const fn clock_bits(&self) -> u8 {
        if self.features & 0x0008 == 0 { 32 } else { 64 }
    }

    /// Whether its controller copies AL control to AL status by itself (device emulation), including the
    /// acknowledgement.
    pub const fn mirrors(&self) -> bool {
        self.configuration & 0x01 != 0
    }

    /// Whether it does not support LRW.
    pub(crate) const fn no_lrw(&self) -> bool {
        self.features & 0x0200 != 0 || self.flags & 0x02 != 0
    }

    pub(super) fn take_links(&mut self, bytes: &[u8]) -> bool {
        let status = bytes.first_chunk().map(|two| u16::from_le_bytes(*two));
        self.dl_status = status.unwrap_or(self.dl_status);
        status.is_some()
    }

    pub(super) fn take_configuration(&mut self, bytes: &[u8]) -> bool {
        let Some([pdi, configuration]) = bytes.first_chunk() else {
            return false;
        };
        (self.pdi, self.configuration) = (*pdi, *configuration);
        true
    }

    pub(super) fn take_registers(&mut self, bytes: &[u8]) -> bool {
        let Some([controller, _, _, _, fmmus, sync_managers, _, _, low, high]) =
            bytes.first_chunk()
        else {
            return false;
        };
        (self.controller, self.fmmus, self.sync_managers) = (*controller, *fmmus, *sync_managers);
        self.features = u16::from_le_bytes([*low, *high]);
        true
    }

    pub(super) fn take_sii(&mut self, sii: &Sii<'_>) {
        self.identity = sii.identity().unwrap_or_default();
        self.alias = sii.word(word::ALIAS).unwrap_or(0);
        self.mailbox = sii.mailbox(word::MAILBOX).unwrap_or_default();
        self.boot_mailbox = sii.mailbox(word::BOOT_MAILBOX).unwrap_or_default();
        self.protocols = sii.protocols().unwrap_or(0);
        self.sii_checked = sii.is_checked();
        let general = sii.general().unwrap_or_default();
        let text = |number| sii.string(number).unwrap_or_default().to_owned();
        (self.name, self.order) = (text(general.name), text(general.order));
        (self.coe, self.flags, self.ebus_ma) = (general.coe, general.flags, general.ebus_ma);
    }
}

/// Number of SII words needed, judged by those already read: up to the end of the categories.
pub(super) fn words_needed(bytes: &[u8]) -> u16 {
    let mut at = 2 * usize::from(word::CATEGORIES);
    while let Some([a, b, c, d]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        if u16::from_le_bytes([*a, *b]) == 0xFFFF {
            break;
        }
        at += 4 + 2 * usize::from(u16::from_le_bytes([*c, *d]));
    }
    u16::try_from(at / 2 + 2).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_open_with_communication_only() {
        let info = SlaveInfo {
            dl_status: 0x5A31,
            ..SlaveInfo::default()
        };
        let ports = info.ports().map(|port| (port.link, port.open));
        assert_eq!(
            ports,
            [(true, true), (true, true), (false, false), (false, false)]
        );
        let info = SlaveInfo {
            dl_status: 0x5611,
            ..SlaveInfo::default()
        };
        assert_eq!(
            info.ports().map(|port| port.open),
            [true, false, false, false]
        );
    }

    #[test]
    fn categories_are_followed_to_their_end() {
        let mut bytes = vec![0; 0x80];
        assert_eq!(words_needed(&bytes), 0x42);
        bytes.extend([10, 0, 3, 0]);
        assert_eq!(words_needed(&bytes), 0x47);
        bytes.extend([0; 6]);
        bytes.extend([0xFF; 4]);
        assert_eq!(words_needed(&bytes), 0x47);
    }
}
