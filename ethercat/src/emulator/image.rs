//! Builds SII images (ETG.2010) for emulated slaves. The decoder is in [`crate::sii`].

use crate::register::SyncManager;
use crate::sii::{self, Category, General, Identity, MailboxAreas, SiiClock, SiiSyncManager};

/// A PDO as the SII lists it: index, name, entries of index, sub-index, bits and data type.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PdoImage {
    /// 1600h or 1A00h and following.
    pub index: u16,
    /// SyncManager; FFh for none.
    pub sync_manager: u8,
    /// Its name.
    pub name: String,
    /// Index, sub-index, bits and data type (as CiA 301 numbers them) of each entry.
    pub entries: Vec<(u16, u8, u8, u8)>,
}

impl PdoImage {
    /// Length, bits.
    pub fn bits(&self) -> usize {
        self.entries
            .iter()
            .map(|(_, _, bits, _)| usize::from(*bits))
            .sum()
    }
}

/// Content of an SII.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SiiImage {
    /// Identity.
    pub identity: Identity,
    /// Station alias.
    pub alias: u16,
    /// Order code; also the first string, which some masters use as the name.
    pub order: String,
    /// Name.
    pub name: String,
    /// Length of each mailbox; 0 for no mailbox.
    pub mailbox_len: u16,
    /// CoE details; 0 for no CoE.
    pub coe: u8,
    /// Flags of General: bit 1 is "no LRW".
    pub flags: u8,
    /// Its outputs do not trigger the watchdog of the controller.
    pub unwatched: bool,
    /// Whether it has a distributed clock with SYNC outputs; their pulses are 1 µs long.
    pub clock: bool,
    /// Its controller answers AL control by itself (word 0, bit 8), without firmware.
    pub device_emulation: bool,
    /// Current taken from the E-bus; negative is given, mA.
    pub ebus_ma: i16,
    /// RxPDOs.
    pub rx_pdos: Vec<PdoImage>,
    /// TxPDOs.
    pub tx_pdos: Vec<PdoImage>,
    /// Spare bytes for outputs and inputs beyond the PDOs above.
    pub spare: u16,
    /// It has FoE and BOOT.
    pub files: bool,
    /// It has EoE.
    pub ethernet: bool,
    /// Explicit layout instead of the derived one.
    pub layout: Option<SiiLayout>,
}

/// Explicit layout of the SII of another vendor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SiiLayout {
    /// Word 0: PDI control, and in its high byte the ESC configuration.
    pub configuration: u16,
    /// Both mailboxes; zeros for none.
    pub mailbox: MailboxAreas,
    /// Protocols of the mailbox.
    pub protocols: u16,
    /// Usage of each FMMU.
    pub fmmus: Vec<u8>,
    /// The SyncManagers; a length of zero is the sum of the PDOs.
    pub sync_managers: Vec<SiiSyncManager>,
    /// Other categories, by number, with their data.
    pub others: Vec<(u16, Vec<u8>)>,
}

/// The bits of EoE and FoE in the mailbox protocols.
const EOE: u16 = 0x0002;
const FOE: u16 = 0x0008;
/// Start addresses of mailboxes and process data.
const MAILBOX: u16 = 0x1000;

impl SiiImage {
    /// The SyncManagers: optional mailboxes, outputs and inputs.
    pub fn sync_managers(&self) -> Vec<SiiSyncManager> {
        if let Some(layout) = &self.layout {
            return layout.sync_managers.clone();
        }
        let mut all = Vec::new();
        let mut at = MAILBOX;
        let mut add = |len: u16, reserved: u16, control, enable, kind| {
            all.push(SiiSyncManager {
                start: at,
                len,
                control,
                enable,
                kind,
            });
            at += reserved;
        };
        let mailbox = self.mailbox_len;
        if mailbox > 0 {
            add(mailbox, mailbox, SyncManager::MAILBOX_OUT, 1, 1);
            add(mailbox, mailbox, SyncManager::MAILBOX_IN, 1, 2);
        }
        // Three buffers each; rounded to addresses that masters expect.
        let reserve = |len: u16| (3 * (len + self.spare)).next_multiple_of(0x80).max(0x80);
        let (outputs, inputs) = (Self::bytes(&self.rx_pdos), Self::bytes(&self.tx_pdos));
        add(
            outputs,
            reserve(outputs),
            if self.unwatched {
                SyncManager::OUTPUTS & !0x40
            } else {
                SyncManager::OUTPUTS
            },
            u8::from(outputs > 0),
            3,
        );
        add(
            inputs,
            reserve(inputs),
            SyncManager::INPUTS,
            u8::from(inputs > 0),
            4,
        );
        all
    }

    fn bytes(pdos: &[PdoImage]) -> u16 {
        let assigned = pdos.iter().filter(|pdo| pdo.sync_manager != 0xFF);
        let bits: usize = assigned.map(PdoImage::bits).sum();
        u16::try_from(bits.div_ceil(8)).unwrap_or(u16::MAX)
    }

    /// The bytes of the EEPROM, 2 KiB or more.
    pub fn encode(&self) -> Vec<u8> {
        let mut image = vec![0_u8; 2 * usize::from(sii::word::CATEGORIES)];
        let mut put = |at: u16, value: u16| {
            let at = 2 * usize::from(at);
            image[at..at + 2].copy_from_slice(&value.to_le_bytes());
        };
        put(0, self.configuration());
        put(2, if self.clock { 100 } else { 0 });
        put(sii::word::ALIAS, self.alias);
        let Identity {
            vendor,
            product,
            revision,
            serial,
        } = self.identity;
        for (i, value) in (0..).zip([vendor, product, revision, serial]) {
            let [a, b, c, d] = value.to_le_bytes();
            put(sii::word::IDENTITY + 2 * i, u16::from_le_bytes([a, b]));
            put(sii::word::IDENTITY + 2 * i + 1, u16::from_le_bytes([c, d]));
        }
        if self.mailbox_len > 0 {
            let (areas, protocols) = self.mailboxes();
            for (i, value) in (0..).zip(areas) {
                put(sii::word::MAILBOX + i, value);
            }
            let boot = self.boot_mailbox();
            let boot = [boot.receive, boot.receive_len, boot.send, boot.send_len];
            for (i, value) in (0..).zip(boot) {
                put(sii::word::BOOT_MAILBOX + i, value);
            }
            put(sii::word::MAILBOX + 4, protocols);
        }
        put(sii::word::SIZE, 15);
        put(sii::word::SIZE + 1, 1);
        image[14] = sii::checksum(&image[..14]);
        let mut strings = Strings::default();
        let general = self.general(&mut strings);
        let pdos = |pdos: &[PdoImage], strings: &mut Strings| -> Vec<u8> {
            pdos.iter()
                .flat_map(|pdo| encode_pdo(pdo, strings))
                .collect()
        };
        let (tx, rx) = (
            pdos(&self.tx_pdos, &mut strings),
            pdos(&self.rx_pdos, &mut strings),
        );
        let clocks = self.clocks(&mut strings);
        category(&mut image, Category::Strings, &strings.encode());
        category(&mut image, Category::General, &general);
        let layout = self.layout.as_ref();
        for (number, data) in layout.map(|layout| &layout.others[..]).unwrap_or_default() {
            category(&mut image, Category::Other(*number), data);
        }
        let has_data = self.rx_pdos.len() + self.tx_pdos.len() > 0;
        if has_data || self.mailbox_len > 0 {
            let fmmus = layout.map_or(&[1, 2, 3, 0][..], |layout| &layout.fmmus);
            category(&mut image, Category::Fmmu, fmmus);
            let sms: Vec<u8> = self.sync_managers().iter().flat_map(encode_sm).collect();
            category(&mut image, Category::SyncManager, &sms);
        }
        category(&mut image, Category::TxPdo, &tx);
        category(&mut image, Category::RxPdo, &rx);
        category(&mut image, Category::Dc, &clocks);
        image.resize(image.len().max(2048), 0xFF);
        image
    }

    /// Word 0.
    fn configuration(&self) -> u16 {
        if let Some(layout) = &self.layout {
            let emulation = u16::from(self.device_emulation) << 8;
            return layout.configuration | emulation;
        }
        // A microcontroller with a mailbox, digital I/O without.
        let (pdi, clock) = if self.mailbox_len > 0 {
            (0x0008, 0x0C00)
        } else {
            (0x0004, 0)
        };
        pdi | u16::from(self.device_emulation) << 8 | if self.clock { clock } else { 0 }
    }

    /// The four words of both mailboxes, and their protocols.
    fn mailboxes(&self) -> ([u16; 4], u16) {
        match &self.layout {
            Some(SiiLayout {
                mailbox, protocols, ..
            }) => (
                [
                    mailbox.receive,
                    mailbox.receive_len,
                    mailbox.send,
                    mailbox.send_len,
                ],
                *protocols,
            ),
            None => {
                let len = self.mailbox_len;
                let protocols = if self.coe > 0 { 0x0004 } else { 0 };
                let protocols = protocols | if self.files { FOE } else { 0 };
                let protocols = protocols | if self.ethernet { EOE } else { 0 };
                ([MAILBOX, len, MAILBOX + len, len], protocols)
            }
        }
    }

    /// Whether it has FoE.
    pub(crate) fn speaks_foe(&self) -> bool {
        self.mailbox_len > 0 && self.mailboxes().1 & FOE != 0
    }

    /// Whether it has EoE.
    pub(crate) fn speaks_eoe(&self) -> bool {
        self.mailbox_len > 0 && self.mailboxes().1 & EOE != 0
    }

    /// The mailboxes in BOOT. Those with FoE are longer there, as no process data needs memory; except with a layout.
    pub(crate) fn boot_mailbox(&self) -> MailboxAreas {
        let ([receive, receive_len, send, send_len], _) = self.mailboxes();
        if self.files && self.layout.is_none() {
            let len = receive_len + 0x40;
            return MailboxAreas {
                receive,
                receive_len: len,
                send: receive + len,
                send_len: len,
            };
        }
        MailboxAreas {
            receive,
            receive_len,
            send,
            send_len,
        }
    }

    /// With a clock: synchronised by outputs or by SYNC0.
    fn clocks(&self, strings: &mut Strings) -> Vec<u8> {
        if !self.clock || self.mailbox_len == 0 {
            return Vec::new();
        }
        let modes = [("SM-Synchron", 0), ("DC-Synchron", 0x0300)];
        let encode = |(name, assign_activate): (&str, u16)| {
            let clock = SiiClock {
                assign_activate,
                name: strings.add(name),
                ..SiiClock::default()
            };
            clock.encode()
        };
        modes.into_iter().flat_map(encode).collect()
    }

    fn general(&self, strings: &mut Strings) -> [u8; 32] {
        let general = General {
            order: strings.add(&self.order),
            name: strings.add(&self.name),
            coe: self.coe,
            flags: self.flags,
            ebus_ma: self.ebus_ma,
            // Two MII ports.
            ports: 0x0011,
            ..General::default()
        };
        let mut bytes = [0; 32];
        (bytes[0], bytes[2], bytes[3]) = (general.group, general.order, general.name);
        (bytes[5], bytes[6], bytes[11]) = (general.coe, u8::from(self.files), general.flags);
        bytes[7] = u8::from(self.ethernet);
        bytes[12..14].copy_from_slice(&general.ebus_ma.to_le_bytes());
        bytes[16..18].copy_from_slice(&general.ports.to_le_bytes());
        bytes
    }
}

#[derive(Debug, Default)]
struct Strings(Vec<String>);

impl Strings {
    /// The number of a string, from 1; the same string has one number.
    fn add(&mut self, text: &str) -> u8 {
        if text.is_empty() {
            return 0;
        }
        let at = self.0.iter().position(|known| known == text);
        let at = at.unwrap_or_else(|| {
            self.0.push(text.to_owned());
            self.0.len() - 1
        });
        u8::try_from(at + 1).unwrap_or(0)
    }

    fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![u8::try_from(self.0.len()).unwrap_or(u8::MAX)];
        for text in &self.0 {
            let text = &text.as_bytes()[..text.len().min(255)];
            bytes.push(u8::try_from(text.len()).unwrap_or(u8::MAX));
            bytes.extend_from_slice(text);
        }
        bytes
    }
}

fn category(image: &mut Vec<u8>, kind: Category, data: &[u8]) {
    if data.is_empty() {
        return;
    }
    let words = u16::try_from(data.len().div_ceil(2)).unwrap_or(u16::MAX);
    image.extend(kind.raw().to_le_bytes());
    image.extend(words.to_le_bytes());
    image.extend_from_slice(data);
    if !data.len().is_multiple_of(2) {
        image.push(0);
    }
}

fn encode_sm(sm: &SiiSyncManager) -> [u8; 8] {
    let ([a, b], [c, d]) = (sm.start.to_le_bytes(), sm.len.to_le_bytes());
    [a, b, c, d, sm.control, 0, sm.enable, sm.kind]
}

fn encode_pdo(pdo: &PdoImage, strings: &mut Strings) -> Vec<u8> {
    let [low, high] = pdo.index.to_le_bytes();
    let count = u8::try_from(pdo.entries.len()).unwrap_or(u8::MAX);
    let name = strings.add(&pdo.name);
    let mut bytes = vec![low, high, count, pdo.sync_manager, 0, name, 0, 0];
    for (index, sub, bits, data_type) in &pdo.entries {
        let [low, high] = index.to_le_bytes();
        bytes.extend([low, high, *sub, 0, *data_type, *bits, 0, 0]);
    }
    bytes
}
