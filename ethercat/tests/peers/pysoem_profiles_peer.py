"""SOEM, by pysoem, against a line of slaves that answer as real devices do: EK1100, EL1004, EL2004, EL2889, EL3004,
AKD. The drive refuses the PDOs that it has by default, so that two are assigned. Prints one line a step; ends with
an error at the first that is not as it should be."""

import struct
import sys
import time

import pysoem

NAMES = ["EK1100", "EL1004", "EL2004", "EL2889", "EL3004", "AKD"]
CYCLE = 0.004
# Inputs 1, outputs 2, both 3: EL1004, EL2004, EL2889, EL3004, AKD.
COUNTER = 1 + 2 + 2 + 1 + 3


def expect(what, found, wanted):
    if found != wanted:
        raise SystemExit(f"{what}: {found!r} instead of {wanted!r}")
    print(f"{what}: {found!r}")


def assign(drive, index, pdos):
    drive.sdo_write(index, 0, bytes(1))
    for sub, pdo in enumerate(pdos, 1):
        drive.sdo_write(index, sub, struct.pack("<H", pdo))
    drive.sdo_write(index, 0, bytes([len(pdos)]))


def cycle(master):
    master.send_processdata()
    counter = master.receive_processdata(20_000)
    time.sleep(CYCLE)
    return counter


def main(interface):
    master = pysoem.Master()
    master.open(interface)
    expect("slaves", master.config_init(), len(NAMES))
    expect("names", [slave.name.split(" ")[0] for slave in master.slaves], NAMES)
    drive = master.slaves[5]
    expect("vendor", drive.sdo_read(0x1018, 1), struct.pack("<I", 0x6A))
    expect("by default", drive.sdo_read(0x1C12, 0), bytes([4]))
    drive.sdo_write(0x10F1, 2, struct.pack("<H", 1000))
    assign(drive, 0x1C12, [0x1600, 0x1601])
    assign(drive, 0x1C13, [0x1A00, 0x1A01])
    master.config_map()
    expect("clocks", bool(master.config_dc()), True)
    drive.dc_sync(act=True, sync0_cycle_time=int(CYCLE * 1e9))
    lens = [(len(slave.output), len(slave.input)) for slave in master.slaves]
    expect("bytes", lens, [(0, 0), (0, 1), (1, 0), (2, 0), (0, 16), (8, 8)])
    expect("SAFE-OP", master.state_check(pysoem.SAFEOP_STATE, 2_000_000), pysoem.SAFEOP_STATE)
    for _ in range(60):
        cycle(master)
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(200):
        cycle(master)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    master.read_state()
    expect("OP", [hex(s.state) for s in master.slaves], ["0x8"] * len(NAMES))
    master.slaves[2].output = bytes([0x05])
    master.slaves[3].output = bytes([0x22, 0x33])
    # From its first SYNC0 on the drive has inputs.
    for _ in range(50):
        cycle(master)
    expect("missed", sum(cycle(master) != COUNTER for _ in range(50)), 0)
    word = struct.unpack_from("<H", drive.input)[0]
    expect("statusword", word & 0x4F, 0x40)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
