//! The watchdog of the process data.

use super::*;

#[test]
fn output_loss_ends_op_after_watchdog_time() {
    for (divider, time, limit) in [
        (0x09C2, 1000, 100 * MS),
        (0x09C2, 50, 5 * MS),
        (998, 100, 4 * MS),
    ] {
        let (mut bench, io) = Bench::small();
        bench.write(
            0x1002,
            register::WATCHDOG_DIVIDER,
            &u16::to_le_bytes(divider),
        );
        bench.write(
            0x1002,
            register::WATCHDOG_PROCESS_DATA,
            &u16::to_le_bytes(time),
        );
        bench.operate();
        bench.logical(Command::Lrw, 0, &[0xFF, 0]);
        bench.now += limit - 50_000;
        assert_eq!(bench.al(0x1002), (AlState::Op, false, 0), "{limit}");
        assert_eq!(bench.read::<1>(0x1002, register::WATCHDOG_STATUS), [1]);
        bench.now += 100_000;
        assert_eq!(bench.al(0x1002), (AlState::SafeOp, true, 0x1B), "{limit}");
        assert_eq!(bench.read::<1>(0x1002, 0x0442), [1]);
        bench.segment.poll(bench.now + 2 * MS);
        assert_eq!(io.outputs(), [0]);
        bench.write(0x1002, 0x0442, &[0]);
        assert_eq!(bench.read::<1>(0x1002, 0x0442), [0]);
    }
}

#[test]
fn watchdog_of_zero_is_off_and_needs_outputs() {
    let (mut bench, _) = Bench::small();
    bench.write(0x1002, register::WATCHDOG_PROCESS_DATA, &[0, 0]);
    bench.operate();
    bench.now += 10_000 * MS;
    assert_eq!(bench.al(0x1002).0, AlState::Op);
    let (mut bench, _) = Bench::small();
    bench.operate();
    for _ in 0..30 {
        bench.now += 5 * MS;
        bench.logical(Command::Lrd, 0, &[0, 0]);
    }
    assert_eq!(bench.al(0x1002), (AlState::SafeOp, true, 0x1B));
}
