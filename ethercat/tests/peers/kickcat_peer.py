"""KickCAT as an independent master against the emulated segment of the peer tests (see
pysoem_peer.py). Its Python side knows no distributed clocks and does not write SDOs: so the drives
run by outputs. Prints one line a step; ends with an error at the first that is not as it should
be."""

import os
import struct
import sys
import time
from datetime import timedelta

import kickcat

CYCLE = 0.004
SLAVES = 5


def ms(n):
    return timedelta(milliseconds=n)


def expect(what, found, wanted):
    if found != wanted:
        raise SystemExit(f"{what}: {found!r} instead of {wanted!r}")
    print(f"{what}: {found!r}")


def feedback(drive):
    word, _mode, position, _velocity, _torque, _error = struct.unpack("<HbxiihH", drive.input_data)
    return word, position


def follow(word):
    state = word & 0x6F
    if state == 0x21:
        return 0x07
    if state in (0x23, 0x27):
        return 0x0F
    return 0x80 if state & 0x4F == 0x08 else 0x06


def command(drive, word, target):
    drive.set_output_bytes(struct.pack("<HbxiiH", word, 8, target, 0, 0))


def connect(interface):
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
    except PermissionError:
        print("not real-time: a busy host may make this lose frames")
    link = kickcat.create_link(interface, "")
    # Without a second interface it waits this long behind each broadcast, good answer or not: for the answer on the
    # second one (Link::writeThenRead). So longer is slow. Shorter than a stall of this very process loses frames whose
    # answers lie in its socket: it looks at the clock before it looks there again (Socket::read).
    link.set_timeout(ms(20))
    bus = kickcat.Bus(link)
    bus.init(ms(100))
    return bus


def enter(bus, state, timeout, cycle=None):
    bus.request_state(state)
    bus.wait_for_state(state, ms(timeout), *([cycle] if cycle else []))


def main(interface):
    bus = connect(interface)
    slaves = bus.slaves()
    expect("slaves", len(slaves), SLAVES)
    drives = slaves[3:]

    def read(drive, index, sub, access):
        return bus.read_sdo(drive, index, sub, access, 200, ms(1000))

    for drive in drives:
        found = read(drive, 0x1000, 0, kickcat.Access.PARTIAL)
        expect("device type", found[:4], struct.pack("<I", 0x00020192))
        found = read(drive, 0x1008, 0, kickcat.Access.PARTIAL)
        expect("device name", found.rstrip(b"\0"), b"TK4021 servo")
        found = read(drive, 0x1018, 0, kickcat.Access.COMPLETE)
        expect("complete access", found[:10], struct.pack("<HII", 4, 0x7A87, 0x4021))
        # An abort is not asked for here: this version fetches it and then waits its time out.
        print("object:", bus.read_object_description(drive, 0x6040))
        print("entry:", bus.read_entry_description(drive, 0x6040, 0))
    bus.create_mapping()
    expect("inputs", [s.input_size for s in slaves], [0, 1, 2, 16, 16])
    expect("outputs", [s.output_size for s in slaves], [0, 1, 2, 14, 14])
    enter(bus, kickcat.State.SAFE_OP, 2000)
    slaves[1].set_output_bytes(bytes(1))
    slaves[2].set_output_bytes(bytes(2))
    for drive in drives:
        command(drive, 0, 0)
    enter(bus, kickcat.State.OPERATIONAL, 3000, bus.process_data_no_check)
    for _ in range(400):
        states = [feedback(drive) for drive in drives]
        for drive, (word, position) in zip(drives, states):
            command(drive, follow(word), position)
        bus.process_data_no_check()
        time.sleep(CYCLE)
        if all(word & 0x6F == 0x27 for word, _ in states):
            break
    starts = [position for _, position in map(feedback, drives)]
    for n in range(1, 251):
        slaves[1].set_output_bytes(bytes([n & 0xFF]))
        slaves[2].set_output_bytes(struct.pack("<H", 1000 + n))
        for drive, start in zip(drives, starts):
            command(drive, 0x0F, start + 20 * n)
        # Raises if a working counter is not as it expects.
        bus.process_data()
        time.sleep(CYCLE)
    for _ in range(10):
        bus.process_data()
        time.sleep(CYCLE)
    moved = [feedback(drive)[1] - start for drive, start in zip(drives, starts)]
    expect("moved", all(4500 < way <= 5010 for way in moved), True)
    expect("digital", slaves[1].input_data, bytes([250]))
    expect("analogue", slaves[2].input_data, struct.pack("<H", 1250))
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
