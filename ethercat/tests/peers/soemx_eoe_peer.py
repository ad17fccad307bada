"""SOEM 2, by soemx, as an independent master of an Ethernet port (EoE): addresses are set and read, ARP and ping answered,
in frames of one and of many fragments. The segment is a coupler and a drive with a station behind its mailbox.
Prints one line a step; ends with an error at the first that is not as it should be."""

import struct
import sys

import soemx

TIMEOUT_US = 2_000_000
HOST, SLAVE = bytes([2, 0, 0, 0, 0, 9]), bytes([2, 0, 0, 0, 0, 1])
# This binding returns addresses up to the first zero, as a C string: none here, and the first four bytes count.
OURS, ITS, MASK = bytes([10, 9, 8, 1]), bytes([10, 9, 8, 2]), bytes([255, 255, 255, 252])


def expect(what, found, wanted):
    if found != wanted:
        raise SystemExit(f"{what}: {found!r} instead of {wanted!r}")
    print(f"{what}: {found!r}" if len(repr(found)) < 60 else f"{what}: as expected")


def checksum(data):
    data += bytes(len(data) % 2)
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total > 0xFFFF:
        total = (total & 0xFFFF) + (total >> 16)
    return struct.pack(">H", total ^ 0xFFFF)


def ping(length):
    icmp = struct.pack(">BBHHH", 8, 0, 0, 7, 1) + bytes(n % 251 for n in range(length))
    icmp = icmp[:2] + checksum(icmp) + icmp[4:]
    ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(icmp), 1, 0, 64, 1, 0) + OURS + ITS
    ip = ip[:10] + checksum(ip) + ip[12:]
    return SLAVE + HOST + b"\x08\x00" + ip + icmp


def main(interface):
    master = soemx.Master()
    master.open(interface)
    expect("slaves", master.config_init(), 2)
    drive = master.slaves[1]
    drive.state_check(soemx.PREOP_STATE, TIMEOUT_US)
    channel = drive.eoe()
    channel.set_ip(ITS, MASK, OURS)
    address = channel.get_ip()
    found = [bytes(part)[:4] for part in (address.values() if isinstance(address, dict) else address)]
    expect("addresses", found[:3], [ITS, MASK, OURS])
    arp = struct.pack(">HHBBH", 1, 0x0800, 6, 4, 1) + HOST + OURS + bytes(6) + ITS
    channel.send((b"\xff" * 6 + HOST + b"\x08\x06" + arp).ljust(60, b"\0"))
    reply = bytes(channel.receive())
    expect("ARP reply", reply[:22], HOST + SLAVE + b"\x08\x06" + arp[:7] + b"\x02")
    expect("its address", reply[22:32], SLAVE + ITS)
    for length in 40 * (18, 54, 55, 700, 1472):
        channel.send(ping(length))
        reply = bytes(channel.receive())
        expect("echo reply", (reply[:12], reply[34]), (HOST + SLAVE, 0))
        expect(f"{length} bytes", reply[42 : 42 + length], ping(length)[42:])
    master.close()
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
