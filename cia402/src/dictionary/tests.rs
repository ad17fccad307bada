//! The dictionary's rules, one by one.

use super::*;

fn dictionary() -> Dictionary {
    let rw = Access::ReadWrite;
    Dictionary::new(vec![
        Object::var(
            0x6041,
            Entry::number("statusword", Access::ReadOnly, 0x0240_u16),
        )
        .mapped(PdoUse::Transmit),
        Object::var(0x6040, Entry::number("controlword", rw, 0_u16)).mapped(PdoUse::Receive),
        Object::var(0x6060, Entry::number("mode", rw, 0_i8).within(-1, 10)).mapped(PdoUse::Both),
        Object::var(0x607A, Entry::number("target", rw, 0_i32)).mapped(PdoUse::Receive),
        Object::var(0x1008, Entry::text("device name", "drive")),
        Object::var(0x2000, Entry::number("flag", rw, false)).mapped(PdoUse::Both),
        Object::var(0x2001, Entry::number("secret", Access::WriteOnly, 0_u32)),
        Object::record(
            0x1018,
            "identity",
            vec![
                Entry::number("vendor", Access::Const, 0x1234_u32),
                Entry::number("product", Access::Const, 7_u32),
            ],
        ),
    ])
    .unwrap()
}

impl Object {
    fn mapped(mut self, pdo: PdoUse) -> Self {
        self.entries[0].1.pdo = pdo;
        self
    }
}

fn at(text: &str) -> Address {
    text.parse().unwrap()
}

#[test]
fn uploads() {
    let mut d = dictionary();
    for (address, expected) in [
        ("6041", Ok(&[0x40, 0x02][..])),
        ("1018:0", Ok(&[2])),
        ("1018:2", Ok(&[7, 0, 0, 0])),
        ("1008", Ok(b"drive")),
        ("1018:3", Err(AbortCode::NoSubIndex)),
        ("6041:1", Err(AbortCode::NoSubIndex)),
        ("6042", Err(AbortCode::NoObject)),
        ("2001", Err(AbortCode::WriteOnly)),
    ] {
        assert_eq!(d.upload(at(address), &mut ()), expected, "{address}");
    }
}

#[test]
fn downloads() {
    let mut d = dictionary();
    for (address, data, expected) in [
        ("6040", &[6, 0][..], Ok(())),
        ("6041", &[6, 0], Err(AbortCode::ReadOnly)),
        ("1018:1", &[0; 4], Err(AbortCode::ReadOnly)),
        ("6040", &[6], Err(AbortCode::TooShort)),
        ("6040", &[6, 0, 0], Err(AbortCode::TooLong)),
        ("6060", &[10], Ok(())),
        ("6060", &[11], Err(AbortCode::TooHigh)),
        ("6060", &[0xFF], Ok(())),
        ("6060", &[0xFE], Err(AbortCode::TooLow)),
        ("2001", &[1, 0, 0, 0], Ok(())),
        ("6040:1", &[1, 0], Err(AbortCode::NoSubIndex)),
    ] {
        let before = d.bytes(at(address)).map(<[u8]>::to_vec);
        assert_eq!(
            d.download(at(address), data, &mut ()),
            expected,
            "{address}"
        );
        let now = d.bytes(at(address)).map(<[u8]>::to_vec);
        let wanted = if expected.is_ok() {
            Some(data.to_vec())
        } else {
            before
        };
        assert_eq!(now, wanted, "{address}");
    }
    d.restore_defaults();
    assert_eq!(d.bytes(at("6060")), Some(&[0][..]));
}

#[test]
fn keys_are_typed() {
    let mut d = dictionary();
    let status = d.key::<u16>(at("6041")).unwrap();
    assert_eq!(d.get(status), 0x0240);
    d.set(status, 0x0237);
    assert_eq!(d.upload(at("6041"), &mut ()), Ok(&[0x37, 0x02][..]));
    let wrong = d.key::<u32>(at("6041")).unwrap_err().to_string();
    assert_eq!(wrong, "6041h:00 is UNSIGNED16, not UNSIGNED32");
    let missing = d.key::<u32>(at("6042")).unwrap_err();
    assert_eq!(missing, DictionaryError::Missing(at("6042")));
}

struct Owner {
    seen: Vec<(Address, u8)>,
}

impl Hooks for Owner {
    fn before_upload(&mut self, d: &mut Dictionary, address: Address) -> Result<(), AbortCode> {
        match address.index {
            0x6041 => d.store(address, &[1, 2]),
            0x1008 => Err(AbortCode::NoData),
            _ => Ok(()),
        }
    }

    fn before_download(
        &mut self,
        _: &Dictionary,
        address: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        if address.index == 0x6060 && data[0] == 2 {
            return Err(AbortCode::Value);
        }
        Ok(())
    }

    fn after_download(&mut self, d: &mut Dictionary, address: Address) {
        self.seen.push((address, d.bytes(address).unwrap()[0]));
    }
}

#[test]
fn hooks_can_refuse_reads_and_writes() {
    let mut d = dictionary();
    let mut owner = Owner { seen: vec![] };
    assert_eq!(d.upload(at("6041"), &mut owner), Ok(&[1, 2][..]));
    assert_eq!(d.upload(at("1008"), &mut owner), Err(AbortCode::NoData));
    let refused = d.download(at("6060"), &[2], &mut owner);
    assert_eq!(refused, Err(AbortCode::Value));
    assert_eq!(d.bytes(at("6060")), Some(&[0][..]));
    d.download(at("6060"), &[8], &mut owner).unwrap();
    assert_eq!(owner.seen, [(at("6060"), 8)]);
}

#[test]
fn invalid_objects_make_no_dictionary() {
    let var = |index| Object::var(index, Entry::number("x", Access::ReadWrite, 0_u8));
    let twice = Dictionary::new(vec![var(1), var(2), var(1)]).unwrap_err();
    assert_eq!(twice, DictionaryError::Twice(Address::new(1, 0)));
    let mut object = var(1);
    object.entries.push(object.entries[0].clone());
    let twice = Dictionary::new(vec![object]).unwrap_err();
    assert_eq!(twice, DictionaryError::Twice(Address::new(1, 0)));
    let beyond = Entry::number("x", Access::ReadWrite, 5_u8).within(6, 7);
    let text = Dictionary::new(vec![Object::var(0x2000, beyond)])
        .unwrap_err()
        .to_string();
    assert_eq!(
        text,
        "2000h:00: the default value is refused (the value is too low (0609 0032h))"
    );
}

fn map(entries: &[u32], received: bool, bits_max: usize) -> Result<Mapping, AbortCode> {
    let entries: Vec<_> = entries.iter().map(|raw| Mapped::from_raw(*raw)).collect();
    Mapping::new(&dictionary(), &entries, received, bits_max)
}

#[test]
fn mappings_are_checked() {
    for (entries, received, expected) in [
        (&[0x6040_0010, 0x607A_0020][..], true, Ok(48)),
        (&[0x6041_0010], false, Ok(16)),
        (&[0x6041_0010], true, Err(AbortCode::NotMappable)),
        (&[0x6040_0010], false, Err(AbortCode::NotMappable)),
        (&[0x1018_0120], false, Err(AbortCode::NotMappable)),
        (&[0x6040_0008], true, Err(AbortCode::NotMappable)),
        (&[0x6042_0010], true, Err(AbortCode::NoObject)),
        (&[0x6040_0110], true, Err(AbortCode::NoSubIndex)),
        (&[0x0005_0008, 0x6060_0008], true, Ok(16)),
        (&[0x0005_0010], true, Err(AbortCode::NotMappable)),
        (&[0x0005_0008], false, Err(AbortCode::NotMappable)),
        (&[0x0000_0003, 0x2000_0001], false, Ok(4)),
        (&[0x2000_0008], true, Ok(8)),
        (
            &[0x607A_0020, 0x607A_0020, 0x6060_0008],
            true,
            Err(AbortCode::PdoTooLong),
        ),
    ] {
        let found = map(entries, received, 64).map(|m| m.bits());
        assert_eq!(found, expected, "{entries:08X?}");
    }
}

#[test]
fn mapping_copies_bits_to_their_entries() {
    let mut d = dictionary();
    let mapping = map(
        &[0x2000_0001, 0x0000_0003, 0x6060_0008, 0x2000_0001],
        true,
        64,
    )
    .unwrap();
    assert_eq!((mapping.bits(), mapping.len()), (13, 2));
    mapping.unpack(&mut d, &[0b1010_0001, 0b0001_0101]);
    assert_eq!(d.bytes(at("6060")), Some(&[0b0101_1010][..]));
    assert_eq!(d.bytes(at("2000")), Some(&[1][..]));
    let mut pdo = [0xFF; 3];
    mapping.pack(&d, &mut pdo);
    assert_eq!(pdo, [0b1010_0001, 0b1111_0101, 0xFF]);
    // A PDO that is too short leaves what it does not reach.
    mapping.unpack(&mut d, &[0]);
    assert_eq!(d.bytes(at("6060")), Some(&[0b0101_0000][..]));
}

#[test]
fn codes_survive() {
    for raw in (0..0x20_u32).chain([0x0504_0001, 0x0609_0011, 0x1234_5678]) {
        assert_eq!(AbortCode::from_raw(raw).raw(), raw);
        assert_eq!(Mapped::from_raw(raw).raw(), raw);
        let short = u16::try_from(raw & 0xFFFF).unwrap();
        assert_eq!(DataType::from_raw(short).raw(), short);
        let byte = raw.to_le_bytes()[0];
        assert_eq!(ObjectCode::from_raw(byte).raw(), byte);
    }
}

#[test]
fn integers_of_every_width() {
    for (data_type, bytes, expected) in [
        (DataType::Integer8, &[0x80][..], Some(-128)),
        (DataType::Unsigned8, &[0x80], Some(128)),
        (DataType::Integer24, &[0xFF, 0xFF, 0xFF], Some(-1)),
        (DataType::Unsigned24, &[0xFF, 0xFF, 0xFF], Some(0xFF_FFFF)),
        (DataType::Unsigned64, &[0xFF; 8], Some(i128::from(u64::MAX))),
        (DataType::Integer64, &[0xFF; 8], Some(-1)),
        (DataType::Real32, &[0; 4], None),
    ] {
        assert_eq!(data_type.integer(bytes), expected, "{data_type}");
    }
}

#[test]
fn addresses() {
    for (text, expected) in [
        ("6041", Some((0x6041, 0))),
        ("0x6041", Some((0x6041, 0))),
        ("6041h:0A", Some((0x6041, 10))),
        ("1018:2", Some((0x1018, 2))),
        ("", None),
        ("60411", None),
        ("+041", None),
        ("1018:100", None),
        ("1018:", None),
    ] {
        let parsed = text.parse::<Address>().ok().map(|a| (a.index, a.sub));
        assert_eq!(parsed, expected, "{text}");
    }
    assert_eq!(at("6041").to_string(), "6041h:00");
    assert_eq!(at("6041").on_axis(1), Some(at("6841")));
    assert_eq!(at("6041").on_axis(8), None);
    assert_eq!(at("1000").on_axis(1), None);
}

#[test]
fn defaults_are_restored_for_requested_indices() {
    let number = |name| Entry::number(name, Access::ReadWrite, 1_u8);
    let objects = [0x1FFF, 0x2000, 0x6000].map(|index| Object::var(index, number("value")));
    let mut d = Dictionary::new(objects.to_vec()).unwrap();
    for index in [0x1FFF, 0x2000, 0x6000] {
        d.store(Address::new(index, 0), &[7]).unwrap();
    }
    let values =
        |d: &Dictionary| [0x1FFF, 0x2000, 0x6000].map(|i| d.bytes(Address::new(i, 0)).unwrap()[0]);
    d.restore_defaults_of(0x1000..=0x1FFF);
    assert_eq!(values(&d), [1, 7, 7]);
    d.restore_defaults();
    assert_eq!(values(&d), [1, 1, 1]);
}
