//! What the EEPROMs of the profiles say. Vendor and product numbers are those by which the devices are known
//! everywhere; names, revisions and objects are Takt's own words for them.

use crate::SyncManager;
use crate::emulator::drive::four_pdos;
use crate::emulator::image::{PdoImage, SiiImage, SiiLayout};
use crate::sii::{Identity, MailboxAreas, SiiSyncManager};

const BECKHOFF: u32 = 0x0000_0002;
const MICROCHIP: u32 = 0xE000_04D8;
const KOLLMORGEN: u32 = 0x0000_006A;

/// Kinds of SyncManagers.
const MAILBOX_OUT: u8 = 1;
const MAILBOX_IN: u8 = 2;
const OUTPUTS: u8 = 3;
const INPUTS: u8 = 4;
/// On, and on in OP only.
const ON: u8 = 0x01;
const OP_ONLY: u8 = 0x09;
/// Outputs of digital terminals: three buffers by name, watchdog; they lie in registers from here on.
const REGISTER_OUTPUTS: u8 = 0x44;
const REGISTERS: u16 = 0x0F00;

fn sm(start: u16, len: u16, control: u8, enable: u8, kind: u8) -> SiiSyncManager {
    SiiSyncManager {
        start,
        len,
        control,
        enable,
        kind,
    }
}

const fn areas(receive: u16, send: u16, len: u16) -> MailboxAreas {
    MailboxAreas {
        receive,
        receive_len: len,
        send,
        send_len: len,
    }
}

fn mailboxes(areas: MailboxAreas) -> [SiiSyncManager; 2] {
    let MailboxAreas {
        receive,
        receive_len,
        send,
        send_len,
    } = areas;
    [
        sm(
            receive,
            receive_len,
            SyncManager::MAILBOX_OUT,
            ON,
            MAILBOX_OUT,
        ),
        sm(send, send_len, SyncManager::MAILBOX_IN, ON, MAILBOX_IN),
    ]
}

const fn identity(vendor: u32, product: u32, serial: u32) -> Identity {
    Identity {
        vendor,
        product,
        revision: 0x0011_0000,
        serial,
    }
}

/// A terminal or coupler: its number is the upper half of its product code.
fn terminal(name: &str, product: u32) -> SiiImage {
    SiiImage {
        identity: identity(BECKHOFF, product, 0),
        order: name.split(' ').next().unwrap_or_default().to_owned(),
        name: name.to_owned(),
        ebus_ma: 100,
        ..SiiImage::default()
    }
}

/// So many PDOs of one bit.
fn bits(first: u16, sync_manager: u8, from: u16, count: u16, outputs: bool) -> Vec<PdoImage> {
    let (object, word) = if outputs {
        (0x7000, "output")
    } else {
        (0x6000, "input")
    };
    (from..from + count)
        .map(|n| PdoImage {
            index: first + n,
            sync_manager,
            name: format!("{word} {}", n + 1),
            entries: vec![(object + 0x10 * n, 1, 1, 1)],
        })
        .collect()
}

/// A category that masters have no use for, and skip.
fn foreign(number: u16) -> (u16, Vec<u8>) {
    (number, vec![0x5A; 12])
}

pub(super) fn ek1100() -> SiiImage {
    SiiImage {
        ebus_ma: -2000,
        layout: Some(SiiLayout {
            configuration: 0x0D00,
            ..SiiLayout::default()
        }),
        ..terminal("EK1100 EtherCAT coupler", 0x044C_2C52)
    }
}

pub(super) fn el1004() -> SiiImage {
    SiiImage {
        tx_pdos: bits(0x1A00, 0, 0, 4, false),
        layout: Some(SiiLayout {
            configuration: 0x0104,
            fmmus: vec![2],
            sync_managers: vec![sm(0x1000, 1, 0x00, ON, INPUTS)],
            others: vec![foreign(43)],
            ..SiiLayout::default()
        }),
        ..terminal("EL1004 4 digital inputs", 0x03EC_3052)
    }
}

pub(super) fn el2004() -> SiiImage {
    SiiImage {
        rx_pdos: bits(0x1600, 0, 0, 4, true),
        layout: Some(SiiLayout {
            configuration: 0x0104,
            fmmus: vec![1],
            sync_managers: vec![sm(REGISTERS, 0, REGISTER_OUTPUTS, OP_ONLY, OUTPUTS)],
            others: vec![foreign(43)],
            ..SiiLayout::default()
        }),
        ..terminal("EL2004 4 digital outputs", 0x07D4_3052)
    }
}

pub(super) fn el2828() -> SiiImage {
    SiiImage {
        rx_pdos: bits(0x1600, 0, 0, 8, true),
        layout: Some(SiiLayout {
            configuration: 0x0104,
            fmmus: vec![1],
            sync_managers: vec![sm(REGISTERS, 1, REGISTER_OUTPUTS, OP_ONLY, OUTPUTS)],
            others: vec![foreign(3), foreign(43)],
            ..SiiLayout::default()
        }),
        ..terminal("EL2828 8 digital outputs", 0x0B0C_3052)
    }
}

pub(super) fn el2889() -> SiiImage {
    let mut rx_pdos = bits(0x1600, 0, 0, 8, true);
    rx_pdos.extend(bits(0x1600, 1, 8, 8, true));
    let output = |at| sm(at, 1, REGISTER_OUTPUTS, OP_ONLY, OUTPUTS);
    SiiImage {
        rx_pdos,
        layout: Some(SiiLayout {
            configuration: 0x0D04,
            fmmus: vec![1, 1],
            sync_managers: vec![output(REGISTERS), output(REGISTERS + 1)],
            others: vec![foreign(43)],
            ..SiiLayout::default()
        }),
        ..terminal("EL2889 16 digital outputs", 0x0B49_3052)
    }
}

/// Analogue channels: eight bits of status, a gap, two bits of status, and the value.
fn analogue(channel: u16) -> [PdoImage; 2] {
    let (object, index) = (0x6000 + 0x10 * channel, 0x1A00 + 2 * channel);
    let status = [(1, 1), (2, 1), (3, 2), (5, 2), (7, 1)];
    let flags = status.map(|(sub, bits)| (object, sub, bits, if bits == 1 { 1 } else { 5 }));
    let value = (object, 0x11, 16, 3);
    let mut standard: Vec<_> = flags.to_vec();
    standard.extend([
        (0, 0, 7, 0),
        (object, 0x0F, 1, 1),
        (object, 0x10, 1, 1),
        value,
    ]);
    let pdo = |index, sync_manager, word: &str, entries| PdoImage {
        index,
        sync_manager,
        name: format!("channel {} {word}", channel + 1),
        entries,
    };
    [
        pdo(index, 3, "standard", standard),
        pdo(index + 1, 0xFF, "compact", vec![value]),
    ]
}

pub(super) fn el3004() -> SiiImage {
    let mailbox = areas(0x1000, 0x1080, 128);
    let [receive, send] = mailboxes(mailbox);
    SiiImage {
        mailbox_len: 128,
        coe: 0x07,
        tx_pdos: (0..4).flat_map(analogue).collect(),
        layout: Some(SiiLayout {
            configuration: 0x0005,
            mailbox,
            protocols: 0x000C,
            fmmus: vec![2, 3],
            sync_managers: vec![
                receive,
                send,
                sm(0x1100, 0, 0x04, 0x00, OUTPUTS),
                sm(0x1180, 16, 0x20, ON, INPUTS),
            ],
            others: vec![foreign(43)],
        }),
        ..terminal("EL3004 4 analogue inputs", 0x0BBC_3052)
    }
}

pub(super) fn ek1914() -> SiiImage {
    let mailbox = areas(0x1000, 0x1100, 256);
    let [receive, send] = mailboxes(mailbox);
    let pdo = |index, sync_manager, object: u16, word: &str| PdoImage {
        index,
        sync_manager,
        name: word.to_owned(),
        entries: vec![
            (object, 1, 8, 5),
            (object + 1, 1, 1, 1),
            (object + 1, 2, 1, 1),
            (0, 0, 6, 0),
            (object, 3, 16, 6),
            (object, 2, 16, 6),
        ],
    };
    // Eight bytes a way: six of these, and two of a second PDO.
    let tail = |index, sync_manager, object: u16| PdoImage {
        index,
        sync_manager,
        name: "word".to_owned(),
        entries: vec![(object, 1, 16, 6)],
    };
    SiiImage {
        mailbox_len: 256,
        coe: 0x03,
        ebus_ma: -500,
        rx_pdos: vec![pdo(0x1600, 2, 0x7000, "outputs"), tail(0x1601, 2, 0x7010)],
        tx_pdos: vec![pdo(0x1A00, 3, 0x6000, "inputs"), tail(0x1A01, 3, 0x6010)],
        layout: Some(SiiLayout {
            configuration: 0x0005,
            mailbox,
            protocols: 0x000C,
            fmmus: vec![1, 2, 3],
            sync_managers: vec![
                receive,
                send,
                sm(0x1200, 8, 0x24, ON, OUTPUTS),
                sm(0x1900, 8, 0x20, ON, INPUTS),
            ],
            ..SiiLayout::default()
        }),
        ..terminal("EK1914 coupler with channels", 0x077A_2C52)
    }
}

pub(super) fn lan9252() -> SiiImage {
    let mailbox = areas(0x1000, 0x1080, 128);
    let [receive, send] = mailboxes(mailbox);
    let pdo = |index, sync_manager, object: u16, entries: &[(u8, u8, u8)]| PdoImage {
        index,
        sync_manager,
        name: "channels".to_owned(),
        entries: entries
            .iter()
            .map(|(sub, bits, data_type)| (object, *sub, *bits, *data_type))
            .collect(),
    };
    SiiImage {
        identity: identity(MICROCHIP, 0x0000_9252, 0),
        order: "LAN9252".to_owned(),
        name: "LAN9252 board".to_owned(),
        mailbox_len: 128,
        coe: 0x23,
        rx_pdos: vec![pdo(0x1600, 2, 0x7000, &[(1, 16, 6)])],
        tx_pdos: vec![pdo(0x1A00, 3, 0x6000, &[(1, 16, 6), (2, 32, 7)])],
        layout: Some(SiiLayout {
            configuration: 0x0E89,
            mailbox,
            protocols: 0x0004,
            fmmus: vec![1, 2, 3],
            sync_managers: vec![
                receive,
                send,
                sm(0x1100, 2, 0x64, ON, OUTPUTS),
                sm(0x1400, 6, 0x20, ON, INPUTS),
            ],
            ..SiiLayout::default()
        }),
        ..SiiImage::default()
    }
}

pub(super) fn akd() -> SiiImage {
    let mailbox = areas(0x1800, 0x1C00, 1024);
    let [receive, send] = mailboxes(mailbox);
    SiiImage {
        identity: identity(KOLLMORGEN, 0x0041_4B44, 0x0001_2345),
        order: "AKD".to_owned(),
        name: "AKD servo drive".to_owned(),
        mailbox_len: 1024,
        coe: 0x0D,
        clock: true,
        rx_pdos: four_pdos(true),
        tx_pdos: four_pdos(false),
        layout: Some(SiiLayout {
            configuration: 0x0C08,
            mailbox,
            protocols: 0x000E,
            fmmus: vec![1, 2, 3],
            sync_managers: vec![
                receive,
                send,
                sm(0x1100, 0, 0x24, ON, OUTPUTS),
                sm(0x1140, 0, 0x20, ON, INPUTS),
            ],
            others: vec![foreign(2048), foreign(2049)],
        }),
        ..SiiImage::default()
    }
}
