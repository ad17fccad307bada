//! The SDO server: every kind of transfer, every refusal, the information service.

use takt_cia402::dictionary::{
    AbortCode, Access, Address as Object_, DataType, Dictionary, Entry, Hooks, Object, PdoUse,
};

use crate::coe::{Sdo, Whole};
use crate::emulator::CoeServer;
use crate::{CoeService, Emergency};

/// Refuses to write 2002h, as a device does in the wrong state.
struct Refusing;

impl Hooks for Refusing {
    fn before_download(&mut self, _: &Dictionary, at: Object_, _: &[u8]) -> Result<(), AbortCode> {
        if at.index == 0x2002 {
            return Err(AbortCode::DeviceState);
        }
        Ok(())
    }
}

struct Server {
    coe: CoeServer,
    d: Dictionary,
}

fn server(mailbox: u16, complete_access: bool) -> Server {
    let number = |name, value: u32| Entry::number(name, Access::ReadWrite, value);
    let long = Entry {
        max_len: 200,
        ..Entry::of(
            "blob",
            DataType::OctetString,
            Access::ReadWrite,
            vec![1; 100],
        )
    };
    let count = Entry::number("count", Access::ReadWrite, 2_u8).within(0, 3);
    let list = vec![
        (0, count),
        (1, Entry::number("a", Access::ReadWrite, 0x1111_u16)),
        (2, Entry::number("b", Access::ReadWrite, 0x2222_u16)),
        (3, Entry::number("c", Access::ReadWrite, 0x3333_u16)),
    ];
    let objects = vec![
        Object::var(0x2000, number("number", 0x1234_5678).within(0, 0x7FFF_FFFF)),
        Object::var(0x2001, Entry::number("constant", Access::Const, 7_u8)),
        Object::var(0x2002, number("refused", 0)),
        Object::var(
            0x2003,
            Entry::number("write only", Access::WriteOnly, 0_u16),
        ),
        Object::var(0x2004, long),
        Object {
            entries: list,
            ..Object::array(0x2005, "list", vec![])
        },
        Object::var(
            0x6040,
            Entry::number("in", Access::ReadWrite, 0_u16).mappable(PdoUse::Receive),
        ),
        Object::var(
            0x6041,
            Entry::number("out", Access::ReadOnly, 0_u16).mappable(PdoUse::Transmit),
        ),
    ];
    Server {
        coe: CoeServer::new(mailbox, complete_access),
        d: Dictionary::new(objects).unwrap(),
    }
}

impl Server {
    /// Sends bytes after the CoE header; returns the service and the bytes of the answer.
    fn raw(&mut self, service: u8, bytes: &[u8]) -> Option<(u8, Vec<u8>)> {
        let mut request = vec![0, service << 4];
        request.extend_from_slice(bytes);
        let mut reply = Vec::new();
        let some = self
            .coe
            .answer(&request, &mut reply, &mut self.d, &mut Refusing);
        some.then(|| (reply[1] >> 4, reply[2..].to_vec()))
    }

    fn sdo(&mut self, sdo: &Sdo<'_>) -> (u8, Vec<u8>) {
        let mut bytes = [0; 300];
        let len = sdo.encode(&mut bytes).unwrap();
        self.raw(2, &bytes[..len]).unwrap()
    }

    /// Reads to the end, in all segments.
    fn upload(&mut self, address: Object_, whole: Whole) -> Result<(Vec<u8>, usize), AbortCode> {
        let (service, bytes) = self.sdo(&Sdo::Upload { address, whole });
        let Some(Sdo::Uploaded { size, data, .. }) = Sdo::decode_response(&bytes) else {
            assert_eq!(
                (service, bytes[0]),
                (2, 0x80),
                "an abort has service 2 and no other bits"
            );
            return Err(AbortCode::from_raw(u32::from_le_bytes(
                bytes[4..8].try_into().unwrap(),
            )));
        };
        let size = usize::try_from(size).unwrap();
        let mut all = data.to_vec();
        let (mut toggle, mut segments) = (false, 0);
        while all.len() < size {
            let (_, bytes) = self.sdo(&Sdo::UploadSegment { toggle });
            let Some(Sdo::UploadedSegment {
                toggle: t,
                last,
                data,
            }) = Sdo::decode_response(&bytes)
            else {
                panic!("{bytes:?}");
            };
            all.extend_from_slice(data);
            assert_eq!((t, last), (toggle, all.len() == size));
            toggle = !toggle;
            segments += 1;
        }
        Ok((all, segments))
    }

    fn download(&mut self, address: Object_, whole: Whole, data: &[u8]) -> Result<(), AbortCode> {
        let size = u32::try_from(data.len()).unwrap();
        let first = Sdo::Download {
            address,
            whole,
            size,
            data: &data[..data.len().min(8)],
        };
        let (mut service, mut bytes) = self.sdo(&first);
        let mut toggle = false;
        let parts: Vec<_> = data.get(8..).unwrap_or_default().chunks(7).collect();
        for (n, part) in parts.iter().enumerate() {
            if bytes[0] == 0x80 {
                break;
            }
            let last = n + 1 == parts.len();
            (service, bytes) = self.sdo(&Sdo::DownloadSegment {
                toggle,
                last,
                data: part,
            });
            toggle = !toggle;
        }
        if bytes[0] == 0x80 {
            assert_eq!(service, 2);
            return Err(AbortCode::from_raw(u32::from_le_bytes(
                bytes[4..8].try_into().unwrap(),
            )));
        }
        assert_eq!(service, 3);
        Ok(())
    }
}

const fn at(index: u16, sub: u8) -> Object_ {
    Object_::new(index, sub)
}

#[test]
fn expedited_normal_and_segmented_uploads() {
    for (mailbox, segments) in [(256, 0), (64, 1), (24, 7)] {
        let mut server = server(mailbox, false);
        let number = server.upload(at(0x2000, 0), Whole::Entry).unwrap();
        assert_eq!(number, (vec![0x78, 0x56, 0x34, 0x12], 0));
        let blob = server.upload(at(0x2004, 0), Whole::Entry).unwrap();
        assert_eq!(blob, (vec![1; 100], segments), "mailbox of {mailbox}");
    }
}

#[test]
fn golden_bytes_of_short_transfers() {
    let mut server = server(128, false);
    let query = |server: &mut Server, bytes: &[u8]| server.raw(2, bytes).unwrap();
    let expedited = [0x43, 0, 0x20, 0, 0x78, 0x56, 0x34, 0x12];
    assert_eq!(
        query(&mut server, &[0x40, 0, 0x20, 0, 0, 0, 0, 0]),
        (3, expedited.to_vec())
    );
    let one = [0x4F, 1, 0x20, 0, 7, 0, 0, 0];
    assert_eq!(
        query(&mut server, &[0x40, 1, 0x20, 0, 0, 0, 0, 0]),
        (3, one.to_vec())
    );
    let written = [0x60, 0, 0x20, 0, 0, 0, 0, 0];
    assert_eq!(
        query(&mut server, &[0x23, 0, 0x20, 0, 1, 0, 0, 0]),
        (3, written.to_vec())
    );
    let refused = [0x80, 1, 0x20, 0, 0x02, 0, 0x01, 0x06];
    assert_eq!(
        query(&mut server, &[0x2F, 1, 0x20, 0, 1, 0, 0, 0]),
        (2, refused.to_vec())
    );
}

#[test]
fn expedited_normal_and_segmented_downloads() {
    let mut server = server(24, false);
    server
        .download(at(0x2000, 0), Whole::Entry, &[1, 2, 3, 4])
        .unwrap();
    assert_eq!(server.d.bytes(at(0x2000, 0)), Some(&[1, 2, 3, 4][..]));
    for len in [5, 8, 9, 15, 100, 200] {
        let data: Vec<u8> = (0..len).collect();
        server.download(at(0x2004, 0), Whole::Entry, &data).unwrap();
        assert_eq!(server.upload(at(0x2004, 0), Whole::Entry).unwrap().0, data);
    }
}

#[test]
fn sdo_refusals_have_their_abort_codes() {
    use AbortCode as A;
    let mut server = server(64, true);
    let w = Whole::Entry;
    for (address, whole, data, code) in [
        (at(0x3000, 0), w, vec![1], A::NoObject),
        (at(0x2000, 1), w, vec![1], A::NoSubIndex),
        (at(0x2001, 0), w, vec![1], A::ReadOnly),
        (at(0x2000, 0), w, vec![1], A::TooShort),
        (at(0x2000, 0), w, vec![1; 5], A::TooLong),
        (at(0x2000, 0), w, vec![0xFF; 4], A::TooHigh),
        (at(0x2002, 0), w, vec![0; 4], A::DeviceState),
        (at(0x2004, 0), w, vec![0; 201], A::TooLong),
        (
            at(0x2005, 2),
            Whole::Object,
            vec![0; 4],
            A::NoCompleteAccess,
        ),
        (at(0x2005, 0), Whole::Object, vec![3], A::TooShort),
        (
            at(0x2005, 0),
            Whole::Object,
            vec![4, 0, 1, 0, 2, 0, 3, 0],
            A::TooHigh,
        ),
    ] {
        assert_eq!(
            server.download(address, whole, &data),
            Err(code),
            "{address} {data:?}"
        );
    }
    for (address, whole, code) in [
        (at(0x3000, 0), w, A::NoObject),
        (at(0x2000, 1), w, A::NoSubIndex),
        (at(0x2003, 0), w, A::WriteOnly),
        (at(0x3000, 0), Whole::Object, A::NoObject),
    ] {
        assert_eq!(server.upload(address, whole), Err(code), "{address}");
    }
}

#[test]
fn segments_out_of_order_abort_the_transfer() {
    let abort = |bytes: &[u8]| u32::from_le_bytes(bytes[4..8].try_into().unwrap());
    let mut server = server(64, false);
    let (_, none) = server.sdo(&Sdo::UploadSegment { toggle: false });
    assert_eq!(abort(&none), AbortCode::CommandSpecifier.raw());
    let address = at(0x2004, 0);
    let whole = Whole::Entry;
    server.sdo(&Sdo::Upload { address, whole });
    let (_, wrong) = server.sdo(&Sdo::UploadSegment { toggle: true });
    assert_eq!(abort(&wrong), AbortCode::Toggle.raw());
    let (_, ended) = server.sdo(&Sdo::UploadSegment { toggle: false });
    assert_eq!(abort(&ended), AbortCode::CommandSpecifier.raw());
    // The master aborts: there is no answer.
    server.sdo(&Sdo::Upload { address, whole });
    let code = AbortCode::General;
    let mut bytes = [0; 8];
    Sdo::Abort { address, code }.encode(&mut bytes).unwrap();
    assert_eq!(server.raw(2, &bytes), None);
    assert_eq!(
        server.raw(2, &[0xE0; 8]).unwrap().1[0],
        0x80,
        "an unknown command"
    );
    assert_eq!(server.raw(2, &[]).unwrap().1[0], 0x80);
    assert_eq!(server.raw(7, &[0; 8]), None, "an unknown service");
}

#[test]
fn complete_access_takes_sub_index_0_as_two_bytes() {
    let mut server = server(64, true);
    let all = server.upload(at(0x2005, 0), Whole::Object).unwrap().0;
    assert_eq!(
        all,
        [2, 0, 0x11, 0x11, 0x22, 0x22],
        "as many as sub-index 0 says"
    );
    let behind = server.upload(at(0x2005, 1), Whole::Object).unwrap().0;
    assert_eq!(behind, [0x11, 0x11, 0x22, 0x22]);
    server
        .download(at(0x2005, 0), Whole::Object, &[3, 0, 1, 0, 2, 0, 3, 0])
        .unwrap();
    let all = server.upload(at(0x2005, 0), Whole::Object).unwrap().0;
    assert_eq!(all, [3, 0, 1, 0, 2, 0, 3, 0]);
    server
        .download(at(0x2005, 0), Whole::Object, &[0, 0])
        .unwrap();
    assert_eq!(
        server.upload(at(0x2005, 0), Whole::Object).unwrap().0,
        [0, 0]
    );
    let mut without = super::coe::server(64, false);
    let refused = without.upload(at(0x2005, 0), Whole::Object);
    assert_eq!(refused, Err(AbortCode::NoCompleteAccess));
}

#[test]
fn sdo_information_lists_and_describes() {
    let mut server = server(32, false);
    let lengths = server.raw(8, &[1, 0, 0, 0, 0, 0]).unwrap().1;
    assert_eq!(lengths, [2, 0, 0, 0, 0, 0, 8, 0, 1, 0, 1, 0, 6, 0, 6, 0]);
    // All indices, in fragments that count down.
    let mut fragments = vec![server.raw(8, &[1, 0, 0, 0, 1, 0]).unwrap().1];
    let mut message = Vec::new();
    while server.coe.unasked(&mut message) {
        fragments.push(message[2..].to_vec());
    }
    assert_eq!(fragments.len(), 1);
    assert_eq!(fragments[0][..6], [2, 0, 0, 0, 1, 0]);
    assert_eq!(fragments[0][6..10], [0x00, 0x20, 0x01, 0x20]);
    let object = server.raw(8, &[3, 0, 0, 0, 5, 0x20]).unwrap().1;
    assert_eq!(object[..10], [4, 0, 0, 0, 5, 0x20, 6, 0, 3, 8]);
    assert_eq!(&object[10..], b"list");
    let entry = server.raw(8, &[5, 0, 0, 0, 0x40, 0x60, 0, 0]).unwrap().1;
    assert_eq!(
        entry[..14],
        [6, 0, 0, 0, 0x40, 0x60, 0, 0, 6, 0, 16, 0, 0x7F, 0]
    );
    let none = server.raw(8, &[3, 0, 0, 0, 0, 0x30]).unwrap().1;
    assert_eq!(none, [7, 0, 0, 0, 0, 0, 2, 6]);
}

#[test]
fn long_lists_are_fragmented() {
    let objects = (0..40).map(|n| Object::var(0x2000 + n, Entry::number("n", Access::Const, 0_u8)));
    let mut server = server(64, false);
    server.d = Dictionary::new(objects.collect()).unwrap();
    let first = server.raw(8, &[1, 0, 0, 0, 1, 0]).unwrap().1;
    let mut found = first[6..].to_vec();
    assert_eq!(first[..4], [0x82, 0, 1, 0], "incomplete, one to come");
    let mut message = Vec::new();
    assert!(server.coe.unasked(&mut message));
    assert_eq!(message[2..6], [0x02, 0, 0, 0]);
    found.extend_from_slice(&message[6..]);
    let indices: Vec<_> = (0x2000..0x2028_u16).flat_map(u16::to_le_bytes).collect();
    assert_eq!(found, indices);
    assert!(!server.coe.unasked(&mut message));
}

#[test]
fn emergency_waits_until_it_can_be_sent() {
    let mut server = server(64, false);
    let emergency = Emergency {
        code: 0x7320,
        register: 0x21,
        data: [1, 2, 3, 4, 5],
    };
    server.coe.emergency(&emergency);
    let mut message = Vec::new();
    assert!(server.coe.unasked(&mut message));
    assert_eq!(message, [0, 0x10, 0x20, 0x73, 0x21, 1, 2, 3, 4, 5]);
    assert!(!server.coe.unasked(&mut message));
    assert_eq!(CoeService::decode(&message), None);
}
