"""SOEM, by pysoem, for the comparison of `ethercat/examples/roundtrip.rs`: brings a segment to OP, then runs as many
cycles as each line of its input says and prints how long each took, ns, from before send_processdata to after
receive_processdata, by Python's clock."""

import sys
import time

import pysoem


def main(interface):
    master = pysoem.Master()
    master.open(interface)
    if master.config_init() <= 0:
        raise SystemExit("no slaves")
    master.config_map()
    if master.state_check(pysoem.SAFEOP_STATE, 5_000_000) != pysoem.SAFEOP_STATE:
        raise SystemExit("no SAFE-OP")
    master.state = pysoem.OP_STATE
    master.send_processdata()
    master.receive_processdata(20_000)
    master.write_state()
    for _ in range(1000):
        master.send_processdata()
        master.receive_processdata(20_000)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    else:
        raise SystemExit("no OP")
    print("ready", flush=True)
    clock, send, receive = time.perf_counter_ns, master.send_processdata, master.receive_processdata
    for line in sys.stdin:
        times = []
        for _ in range(int(line)):
            begin = clock()
            send()
            counter = receive(20_000)
            end = clock()
            if counter > 0:
                times.append(end - begin)
        print(*times, flush=True)
    master.close()


if __name__ == "__main__":
    main(sys.argv[1])
