"""SOEM, by pysoem, as an independent FoE client: a file is read in PRE-OP, firmware of several lengths is written in
BOOT and read back. The segment is a coupler and two drives that serve files; the first is busy twice at each packet.
Prints one line a step; ends with an error at the first that is not as it should be."""

import struct
import sys

import pysoem

# SII words of the mailboxes: in BOOT, in other states.
BOOT_RECEIVE, BOOT_SEND, RECEIVE, SEND = 0x14, 0x16, 0x18, 0x1A
TIMEOUT_US = 2_000_000
# What SOEM returns for a file that is refused.
FOE_ERROR = -5


def expect(what, found, wanted):
    if found != wanted:
        raise SystemExit(f"{what}: {found!r} instead of {wanted!r}")
    print(f"{what}: {found!r}" if len(repr(found)) < 60 else f"{what}: as expected")


def to(slave, state):
    slave.state = state
    slave.write_state()
    return slave.state_check(state, TIMEOUT_US)


def mailboxes(slave, receive, send):
    lens = []
    for which, word in (("out", receive), ("in", send)):
        start, size = struct.unpack("<HH", slave.eeprom_read(word))
        slave.amend_mbx(mailbox=which, start_address=start, size=size)
        lens.append(size)
    return lens


def read(drive, name, size):
    return bytes(drive.foe_read(name, 0, size, TIMEOUT_US))


def write(drive, data):
    return drive.foe_write("fw", 0, data, TIMEOUT_US)


def update(drive, fills):
    """Passes BOOT; with `fills`, also files that fill their last packet, which an empty one follows."""
    expect("PRE-OP", drive.state_check(pysoem.PREOP_STATE, TIMEOUT_US), pysoem.PREOP_STATE)
    expect("log", read(drive, "log", 4096), bytes(range(256)) * 3)
    # SOEM returns what it read before the refusal: nothing.
    expect("no such file", read(drive, "none", 4096), b"")
    expect("refused in PRE-OP", write(drive, b"abc"), FOE_ERROR)
    expect("INIT", to(drive, pysoem.INIT_STATE), pysoem.INIT_STATE)
    packet = mailboxes(drive, BOOT_RECEIVE, BOOT_SEND)[0] - 12
    expect("BOOT", to(drive, pysoem.BOOT_STATE), pysoem.BOOT_STATE)
    for length in [1, packet - 1, packet + 1] + fills * [packet, 2 * packet] + [5000]:
        data = bytes(n % 251 for n in range(length))
        expect("written", write(drive, data), 1)
        expect(f"{length} bytes", read(drive, "fw", 8192), data)
    expect("INIT", to(drive, pysoem.INIT_STATE), pysoem.INIT_STATE)
    mailboxes(drive, RECEIVE, SEND)
    expect("PRE-OP", to(drive, pysoem.PREOP_STATE), pysoem.PREOP_STATE)
    expect("firmware", read(drive, "fw", 8192), data)


def main(interface):
    master = pysoem.Master()
    master.open(interface)
    expect("slaves", master.config_init(), 3)
    # SOEM ends a write, as if it were done, when its empty last packet is answered by busy.
    for drive, fills in zip(master.slaves[1:], (False, True)):
        update(drive, fills)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
