"""KickCAT against a line of slaves that answer as real devices do: EK1100, EL1004, EL2004, EL3004, LAN9252 board. Its
Python side writes no objects, so that a drive whose default PDOs are refused is not among them. Prints one line a step;
ends with an error at the first that is not as it should be."""

import sys
import time

import kickcat
from kickcat_peer import CYCLE, SLAVES, connect, enter, expect, ms


def main(interface):
    bus = connect(interface)
    slaves = bus.slaves()
    expect("slaves", len(slaves), SLAVES)
    found = bus.read_sdo(slaves[3], 0x1008, 0, kickcat.Access.PARTIAL, 200, ms(1000))
    expect("device name", found[:6], b"EL3004")
    bus.create_mapping()
    expect("inputs", [s.input_size for s in slaves], [0, 1, 0, 16, 6])
    expect("outputs", [s.output_size for s in slaves], [0, 0, 1, 0, 2])
    enter(bus, kickcat.State.SAFE_OP, 2000)
    slaves[2].set_output_bytes(bytes([0x05]))
    slaves[4].set_output_bytes(bytes([0x11, 0x22]))
    enter(bus, kickcat.State.OPERATIONAL, 3000, bus.process_data_no_check)
    for _ in range(100):
        # Raises if a working counter is not as it expects.
        bus.process_data()
        time.sleep(CYCLE)
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
