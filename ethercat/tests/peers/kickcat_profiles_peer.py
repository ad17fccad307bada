"""KickCAT against a line of slaves that answer as real devices do: EK1100, EL1004, EL2004, EL3004, LAN9252 board. Its
Python side writes no objects, so that a drive whose default PDOs are refused is not among them. Prints one line a step;
ends with an error at the first that is not as it should be."""

import os
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


def main(interface):
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
    except PermissionError:
        print("not real-time: a busy host may make this lose frames")
    link = kickcat.create_link(interface, "")
    # See kickcat_peer.py for this time.
    link.set_timeout(ms(20))
    bus = kickcat.Bus(link)
    bus.init(ms(100))
    slaves = bus.slaves()
    expect("slaves", len(slaves), SLAVES)
    found = bus.read_sdo(slaves[3], 0x1008, 0, kickcat.Access.PARTIAL, 200, ms(1000))
    expect("device name", found[:6], b"EL3004")
    bus.create_mapping()
    expect("inputs", [s.input_size for s in slaves], [0, 1, 0, 16, 6])
    expect("outputs", [s.output_size for s in slaves], [0, 0, 1, 0, 2])
    bus.request_state(kickcat.State.SAFE_OP)
    bus.wait_for_state(kickcat.State.SAFE_OP, ms(2000))
    slaves[2].set_output_bytes(bytes([0x05]))
    slaves[4].set_output_bytes(bytes([0x11, 0x22]))
    bus.request_state(kickcat.State.OPERATIONAL)
    bus.wait_for_state(kickcat.State.OPERATIONAL, ms(3000), bus.process_data_no_check)
    for _ in range(100):
        # Raises if a working counter is not as it expects.
        bus.process_data()
        time.sleep(CYCLE)
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
