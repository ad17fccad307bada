//! The objects of a drive other than those of its axes: identity, PDOs, SyncManagers, synchronisation (ETG.1000.6,
//! ETG.1020). Their behaviour is elsewhere.

use takt_cia402::dictionary::{
    Access, Address, DataType, Entry, Mapped, Number, Object, ObjectCode,
};

use super::ServoConfig;
use super::pdo::{self, ASSIGNED, ENTRIES};
use crate::emulator::image::PdoImage;

/// Default of 1C32h:01: cycles run with new outputs.
pub(super) const SYNC_BY_OUTPUTS: u16 = 1;

/// All objects.
pub(super) fn objects(config: &ServoConfig) -> Vec<Object> {
    let axes = config.axes.len();
    let mut all = identity(config);
    let received = pdo::images(config.pdos, axes, true);
    let transmitted = pdo::images(config.pdos, axes, false);
    all.extend(received.iter().chain(&transmitted).map(mapping));
    all.extend([
        assignment(0x1C12, "RxPDO assign", &received),
        assignment(0x1C13, "TxPDO assign", &transmitted),
        synchronisation(0x1C32, "output sync manager parameter"),
        synchronisation(0x1C33, "input sync manager parameter"),
    ]);
    let axes = (0..).zip(&config.axes);
    all.extend(axes.flat_map(|(number, axis)| axis.objects(number)));
    all
}

fn identity(config: &ServoConfig) -> Vec<Object> {
    let own = config.identity();
    let number = |name, value: u32| Entry::number(name, Access::Const, value);
    let channel = |name, value: u8| Entry::number(name, Access::ReadOnly, value);
    vec![
        Object::var(0x1000, number("device type", 0x0002_0192)),
        Object::var(
            0x1001,
            Entry::number("error register", Access::ReadOnly, 0_u8),
        ),
        Object::var(0x1008, Entry::text("device name", &config.name)),
        Object::var(0x1009, Entry::text("hardware version", "emulated")),
        Object::var(
            0x100A,
            Entry::text("software version", env!("CARGO_PKG_VERSION")),
        ),
        Object::record(
            0x1018,
            "identity",
            vec![
                number("vendor", own.vendor),
                number("product code", own.product),
                number("revision", own.revision),
                number("serial number", own.serial),
            ],
        ),
        Object::record(
            0x10F1,
            "error settings",
            vec![
                Entry::number("local error reaction", Access::ReadWrite, 0_u32),
                Entry::number("sync error counter limit", Access::ReadWrite, 4_u16),
            ],
        ),
        Object::array(
            0x1C00,
            "sync manager type",
            vec![
                channel("SM0", 1),
                channel("SM1", 2),
                channel("SM2", 3),
                channel("SM3", 4),
            ],
        ),
    ]
}

/// An object whose sub-index 0 is the number of valid entries.
pub(in crate::emulator) fn counted<T: Number>(
    index: u16,
    name: &str,
    values: &[T],
    entries_max: u8,
    zero: T,
    access: Access,
) -> Object {
    let count = u8::try_from(values.len()).unwrap_or(u8::MAX);
    let count = Entry::number("number of entries", access, count).within(0, entries_max);
    let entries = (1..=entries_max).map(|sub| {
        let value = values.get(usize::from(sub) - 1).copied().unwrap_or(zero);
        (sub, Entry::number("entry", access, value))
    });
    Object {
        index,
        name: name.to_owned().into(),
        code: ObjectCode::Record,
        entries: std::iter::once((0, count)).chain(entries).collect(),
    }
}

fn mapping(image: &PdoImage) -> Object {
    let raw = |(index, sub, bits, _): &(u16, u8, u8, u8)| {
        let address = Address::new(*index, *sub);
        Mapped {
            address,
            bits: *bits,
        }
        .raw()
    };
    let values: Vec<u32> = image.entries.iter().map(raw).collect();
    let (index, name) = (image.index, &image.name);
    counted(index, name, &values, ENTRIES, 0, Access::ReadWrite)
}

fn assignment(index: u16, name: &str, images: &[PdoImage]) -> Object {
    let pdos: Vec<u16> = images.iter().map(|image| image.index).collect();
    counted(index, name, &pdos, ASSIGNED, 0, Access::ReadWrite)
}

/// 1C32h and 1C33h: their sub-indices have gaps.
fn synchronisation(index: u16, name: &'static str) -> Object {
    let ns = |name, access, value: u32| Entry::number(name, access, value);
    let count = |name| Entry::number(name, Access::ReadOnly, 0_u16);
    let flag = Entry::of("sync error", DataType::Boolean, Access::ReadOnly, vec![0]);
    let highest = Entry::number("highest sub-index", Access::Const, 0x20_u8);
    let sync_type = Entry::number("sync type", Access::ReadWrite, SYNC_BY_OUTPUTS).within(0, 2);
    // Free run, SM event, SYNC0.
    let supported = Entry::number("supported sync types", Access::ReadOnly, 0x0007_u16);
    let entries = vec![
        (0, highest),
        (1, sync_type),
        (2, ns("cycle time", Access::ReadWrite, 1_000_000)),
        (4, supported),
        (
            5,
            ns("minimum cycle time", Access::ReadOnly, super::CYCLE_STEP),
        ),
        (6, ns("calc and copy time", Access::ReadOnly, 20_000)),
        (9, ns("delay time", Access::ReadOnly, 0)),
        (0x0A, ns("SYNC0 cycle time", Access::ReadWrite, 0)),
        (0x0B, count("SM event missed counter")),
        (0x0C, count("cycle exceeded counter")),
        (0x20, flag),
    ];
    Object {
        index,
        name: name.into(),
        code: ObjectCode::Record,
        entries,
    }
}
