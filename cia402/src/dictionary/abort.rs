//! Why a read or write was refused, as SDO carries it (CiA 301, table of abort codes; ETG.1000.6
//! adds those of complete access). It does not decide which one applies.

use std::fmt;

/// An SDO abort code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum AbortCode {
    /// 0503 0000h
    Toggle,
    /// 0504 0000h
    TimedOut,
    /// 0504 0001h
    CommandSpecifier,
    /// 0504 0002h
    BlockSize,
    /// 0504 0003h
    SequenceNumber,
    /// 0504 0004h
    Crc,
    /// 0504 0005h
    OutOfMemory,
    /// 0601 0000h
    UnsupportedAccess,
    /// 0601 0001h
    WriteOnly,
    /// 0601 0002h
    ReadOnly,
    /// 0601 0003h
    SubIndexZeroFirst,
    /// 0601 0004h
    NoCompleteAccess,
    /// 0601 0005h
    ExceedsMailbox,
    /// 0601 0006h
    MappedToRxPdo,
    /// 0602 0000h
    NoObject,
    /// 0604 0041h
    NotMappable,
    /// 0604 0042h
    PdoTooLong,
    /// 0604 0043h
    ParameterIncompatible,
    /// 0604 0047h
    InternalIncompatible,
    /// 0606 0000h
    Hardware,
    /// 0607 0010h
    Length,
    /// 0607 0012h
    TooLong,
    /// 0607 0013h
    TooShort,
    /// 0609 0011h
    NoSubIndex,
    /// 0609 0030h
    Value,
    /// 0609 0031h
    TooHigh,
    /// 0609 0032h
    TooLow,
    /// 0609 0036h
    MaximumBelowMinimum,
    /// 060A 0023h
    NoResource,
    /// 0800 0000h
    General,
    /// 0800 0020h
    CannotStore,
    /// 0800 0021h
    LocalControl,
    /// 0800 0022h
    DeviceState,
    /// 0800 0023h
    NoDictionary,
    /// 0800 0024h
    NoData,
    /// Any other code, as received.
    Other(u32),
}

use AbortCode as A;

/// Code, number and text.
const TABLE: [(AbortCode, u32, &str); 35] = [
    (A::Toggle, 0x0503_0000, "the toggle bit did not change"),
    (A::TimedOut, 0x0504_0000, "the transfer timed out"),
    (
        A::CommandSpecifier,
        0x0504_0001,
        "unknown command specifier",
    ),
    (A::BlockSize, 0x0504_0002, "the block size is not valid"),
    (
        A::SequenceNumber,
        0x0504_0003,
        "the sequence number is not valid",
    ),
    (A::Crc, 0x0504_0004, "the checksum is wrong"),
    (A::OutOfMemory, 0x0504_0005, "out of memory"),
    (
        A::UnsupportedAccess,
        0x0601_0000,
        "this access is not supported",
    ),
    (A::WriteOnly, 0x0601_0001, "the object can only be written"),
    (A::ReadOnly, 0x0601_0002, "the object can only be read"),
    (
        A::SubIndexZeroFirst,
        0x0601_0003,
        "write 0 to sub-index 0 first",
    ),
    (
        A::NoCompleteAccess,
        0x0601_0004,
        "complete access is not supported for this object",
    ),
    (
        A::ExceedsMailbox,
        0x0601_0005,
        "the object is longer than the mailbox",
    ),
    (
        A::MappedToRxPdo,
        0x0601_0006,
        "the object is written by a PDO",
    ),
    (A::NoObject, 0x0602_0000, "there is no such object"),
    (
        A::NotMappable,
        0x0604_0041,
        "the object cannot be mapped to the PDO",
    ),
    (
        A::PdoTooLong,
        0x0604_0042,
        "the mapped objects exceed the length of the PDO",
    ),
    (
        A::ParameterIncompatible,
        0x0604_0043,
        "the parameters are incompatible",
    ),
    (
        A::InternalIncompatible,
        0x0604_0047,
        "incompatible with the internals of the device",
    ),
    (A::Hardware, 0x0606_0000, "the device's hardware failed"),
    (A::Length, 0x0607_0010, "the length does not match the type"),
    (A::TooLong, 0x0607_0012, "more bytes than the type has"),
    (A::TooShort, 0x0607_0013, "fewer bytes than the type has"),
    (A::NoSubIndex, 0x0609_0011, "there is no such sub-index"),
    (A::Value, 0x0609_0030, "the value is not allowed"),
    (A::TooHigh, 0x0609_0031, "the value is too high"),
    (A::TooLow, 0x0609_0032, "the value is too low"),
    (
        A::MaximumBelowMinimum,
        0x0609_0036,
        "the maximum is below the minimum",
    ),
    (A::NoResource, 0x060A_0023, "no SDO connection is free"),
    (A::General, 0x0800_0000, "the device gives no reason"),
    (
        A::CannotStore,
        0x0800_0020,
        "the value cannot be transferred or stored",
    ),
    (
        A::LocalControl,
        0x0800_0021,
        "the device is under local control",
    ),
    (
        A::DeviceState,
        0x0800_0022,
        "not in the present state of the device",
    ),
    (
        A::NoDictionary,
        0x0800_0023,
        "the device has no object dictionary",
    ),
    (A::NoData, 0x0800_0024, "there is no data"),
];

impl AbortCode {
    /// The number on the wire.
    pub fn raw(self) -> u32 {
        if let Self::Other(raw) = self {
            return raw;
        }
        let found = TABLE.iter().find(|(code, ..)| *code == self);
        found.map_or(0, |(_, raw, _)| *raw)
    }

    /// From the number on the wire.
    pub fn from_raw(raw: u32) -> Self {
        let found = TABLE.iter().find(|(_, known, _)| *known == raw);
        found.map_or(Self::Other(raw), |(code, ..)| *code)
    }

    /// The text, without the number.
    pub fn text(self) -> &'static str {
        let found = TABLE.iter().find(|(code, ..)| *code == self);
        found.map_or("manufacturer-specific reason", |(.., text)| text)
    }
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let raw = self.raw();
        write!(
            f,
            "{} ({:04X} {:04X}h)",
            self.text(),
            raw >> 16,
            raw & 0xFFFF
        )
    }
}

impl std::error::Error for AbortCode {}
