//! No input causes a panic, and the segment keeps working.

use super::*;
use proptest::prelude::*;

/// Bytes of an almost valid frame: existing commands and addresses.
fn datagram() -> impl Strategy<Value = Vec<u8>> {
    let place = prop_oneof![0_u16..0x0A00, 0x1000_u16..0x1200, any::<u16>()];
    let adp = prop_oneof![Just(0_u16), 0x1000_u16..0x1004, any::<u16>()];
    let data = proptest::collection::vec(any::<u8>(), 0..40);
    (0_u8..16, adp, place, data).prop_map(|(command, adp, ado, data)| {
        let mut bytes = vec![command, 0];
        bytes.extend(adp.to_le_bytes());
        bytes.extend(ado.to_le_bytes());
        bytes.extend((u16::try_from(data.len()).unwrap() | 0x8000).to_le_bytes());
        bytes.extend([0, 0]);
        bytes.extend(data);
        bytes.extend([0, 0]);
        bytes
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_bytes_pass(frames in proptest::collection::vec(
        proptest::collection::vec(any::<u8>(), 0..200), 1..20)) {
        let (mut bench, _) = Bench::small();
        for (n, mut frame) in (1..).zip(frames) {
            bench.segment.process(&mut frame, Entry::First, n * MS);
            bench.segment.process_ethernet(&mut frame, Entry::Last, n * MS);
        }
    }

    #[test]
    fn any_datagrams_pass_and_the_segment_can_be_used_afterwards(
        frames in proptest::collection::vec(
            proptest::collection::vec(datagram(), 1..8), 1..40)) {
        let (mut bench, io) = Bench::small();
        for (n, datagrams) in (1..).zip(frames) {
            let mut frame = vec![0, 0];
            datagrams.iter().for_each(|bytes| frame.extend(bytes));
            let len = u16::try_from(frame.len() - 2).unwrap();
            frame[..2].copy_from_slice(&(len & 0x07FF | 0x1000).to_le_bytes());
            bench.segment.process(&mut frame, Entry::First, n * MS);
        }
        for slave in 0..3 {
            bench.segment.set_power(slave, false);
            bench.segment.set_power(slave, true);
        }
        bench.now = 100 * MS;
        bench.address();
        bench.operate();
        bench.logical(Command::Lrw, 0, &[0x77, 0]);
        bench.segment.poll(bench.now + MS);
        prop_assert_eq!(io.outputs(), [0x77]);
    }
}
