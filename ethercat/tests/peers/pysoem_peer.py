"""SOEM, by pysoem, as an independent master against the emulated segment of the peer tests: a
coupler, 8+8 digital, 1+1 analogue channels whose outputs come back as inputs, two servo drives.
Prints one line a step; ends with an error at the first that is not as it should be."""

import struct
import sys
import time

import pysoem

NAMES = ["TK1100", "TK0808", "TK0101", "TK4021", "TK4021"]
CYCLE = 0.004


def expect(what, found, wanted):
    if found != wanted:
        raise SystemExit(f"{what}: {found!r} instead of {wanted!r}")
    print(f"{what}: {found!r}")


def abort_of(read):
    try:
        read()
    except pysoem.SdoError as error:
        return error.abort_code
    return None


def sdos(drive):
    expect("device type", drive.sdo_read(0x1000, 0), struct.pack("<I", 0x00020192))
    expect("device name", drive.sdo_read(0x1008, 0), b"TK4021 servo")
    drive.sdo_write(0x6083, 0, struct.pack("<I", 54321))
    expect("written", drive.sdo_read(0x6083, 0), struct.pack("<I", 54321))
    expect("abort", abort_of(lambda: drive.sdo_read(0x3000, 0)), 0x06020000)
    expect("abort", abort_of(lambda: drive.sdo_write(0x1000, 0, bytes(4))), 0x06010002)
    assigned = drive.sdo_read(0x1C12, 0, ca=True)
    expect("complete access", assigned, struct.pack("<HH", 1, 0x1600))
    drive.sdo_write(0x1C12, 0, struct.pack("<HH", 1, 0x1600), ca=True)
    objects = [o.index for o in drive.od]
    expect("objects listed", 0x6040 in objects and 0x1C32 in objects, True)


def cycle(master, drives, words, targets):
    for drive, word, target in zip(drives, words, targets):
        drive.output = struct.pack("<HbxiiH", word, 8, target, 0, 0)
    master.send_processdata()
    counter = master.receive_processdata(20_000)
    time.sleep(CYCLE)
    return counter


def feedback(drive):
    word, _mode, position, _velocity, _torque, _error = struct.unpack("<HbxiihH", drive.input)
    return word, position


def follow(word):
    state = word & 0x6F
    if state == 0x21:
        return 0x07
    if state in (0x23, 0x27):
        return 0x0F
    return 0x80 if state & 0x4F == 0x08 else 0x06


def main(interface):
    master = pysoem.Master()
    master.open(interface)
    expect("slaves", master.config_init(), len(NAMES))
    expect("names", [slave.name.split(" ")[0] for slave in master.slaves], NAMES)
    drives = master.slaves[3:]
    for drive in drives:
        sdos(drive)
        # This master is not real-time: it may miss SYNC0 for long.
        drive.sdo_write(0x10F1, 2, struct.pack("<H", 1000))
    for slave in master.slaves[1:]:
        slave.set_watchdog("processdata", 2000)
    master.config_map()
    expect("clocks", bool(master.config_dc()), True)
    for drive in drives:
        drive.dc_sync(act=True, sync0_cycle_time=int(CYCLE * 1e9))
    expect("SAFE-OP", master.state_check(pysoem.SAFEOP_STATE, 2_000_000), pysoem.SAFEOP_STATE)
    words, targets = [0, 0], [0, 0]
    for _ in range(60):
        cycle(master, drives, words, targets)
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(200):
        cycle(master, drives, words, targets)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    master.read_state()
    expect("OP", [hex(s.state) for s in master.slaves], ["0x8"] * len(NAMES))
    expect("expected working counter", master.expected_wkc, 12)
    for _ in range(400):
        states = [feedback(drive) for drive in drives]
        words = [follow(word) for word, _ in states]
        targets = [position for _, position in states]
        cycle(master, drives, words, targets)
        if all(word & 0x6F == 0x27 for word, _ in states):
            break
    starts = targets
    missed = 0
    for n in range(1, 251):
        master.slaves[1].output = bytes([n & 0xFF])
        master.slaves[2].output = struct.pack("<H", 1000 + n)
        counter = cycle(master, drives, [15, 15], [start + 20 * n for start in starts])
        missed += counter != 12
    moved = [feedback(drive)[1] - start for drive, start in zip(drives, starts)]
    expect("missed", missed, 0)
    expect("moved", all(4500 < way <= 5000 for way in moved), True)
    for _ in range(10):
        cycle(master, drives, [15, 15], [start + 5000 for start in starts])
    expect("digital", master.slaves[1].input, bytes([250]))
    expect("analogue", master.slaves[2].input, struct.pack("<H", 1250))
    for drive in drives:
        # Register 092Ch: bit 31 is the sign.
        difference = struct.unpack("<I", drive._fprd(0x092C, 4))[0] & 0x7FFFFFFF
        expect("clock within 2 us", difference < 2000, True)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
