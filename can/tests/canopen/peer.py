"""python-canopen as peer: `lead` starts, homes and moves our emulated drive; `follow` is a drive
based on LocalNode. The speed of the host is not checked."""

import sys
import threading
import time

import canopen
from canopen.profiles.p402 import BaseNode402

ROLE, CHANNEL, NUMBER, SHEET = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
TIMEOUT = 30.0

# The library's default timeouts are too short for an emulated host.
BaseNode402.TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT
BaseNode402.TIMEOUT_SWITCH_STATE_SINGLE = TIMEOUT / 2
BaseNode402.TIMEOUT_SWITCH_OP_MODE = TIMEOUT
BaseNode402.TIMEOUT_CHECK_TPDO = TIMEOUT


def until(goal, holds):
    end = time.time() + TIMEOUT
    while time.time() < end:
        if holds():
            print("ok", goal, flush=True)
            return
        time.sleep(0.01)
    sys.exit(f"timeout: {goal}")


def lead(network):
    node = BaseNode402(NUMBER, SHEET)
    node.sdo.RESPONSE_TIMEOUT = TIMEOUT
    network.add_node(node)
    node.nmt.send_command(0x82)
    node.nmt.wait_for_bootup(TIMEOUT)
    print("ok boot-up", flush=True)
    assert node.sdo[0x1000].raw & 0xFFFF == 0x192
    assert node.sdo["manufacturer device name"].raw == "Takt emulated drive"

    value = bytes(n * 7 % 251 for n in range(3000))
    for block in (False, True):
        with node.sdo[0x2000].open("wb", size=len(value), block_transfer=block) as file:
            file.write(value)
        with node.sdo[0x2000].open("rb", block_transfer=block) as file:
            assert file.read() == value
    print("ok segmented and block transfers", flush=True)
    try:
        node.sdo[0x6060].raw = 5
        sys.exit("a mode that the drive has not was taken")
    except canopen.SdoAbortedError as error:
        assert error.code == 0x06090030, error

    node.tpdo.read()
    node.rpdo.read()
    status = node.tpdo[1]
    status.clear()
    for index in (0x6041, 0x6061, 0x6064):
        status.add_variable(index)
    status.trans_type, status.event_timer, status.enabled = 255, 50, True
    word = node.rpdo[1]
    word.clear()
    word.add_variable(0x6040)
    word.trans_type, word.enabled = 255, True
    status.save()
    word.save()
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    until("a TPDO", lambda: status.timestamp is not None)

    node.sdo[0x6098].raw = 35
    node.sdo[0x607C].raw = 0
    assert node.homing(timeout=TIMEOUT, restore_op_mode=False)
    print("ok homing", flush=True)
    node.controlword = 0x0F

    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    node.sdo[0x607A].raw = 12000
    node.controlword = 0x3F
    until("motion", lambda: abs(node.sdo[0x6064].raw - 12000) < 20)
    node.controlword = 0x0F
    node.state = "SWITCHED ON"
    node.state = "READY TO SWITCH ON"
    node.state = "SWITCH ON DISABLED"
    print("ok down", flush=True)


class Follower:
    """The minimum that a master accepts as a drive."""

    STATES = {"disabled": 0x0250, "ready": 0x0231, "on": 0x0233, "enabled": 0x1237}

    def __init__(self, network):
        self.network = network
        self.node = network.create_node(NUMBER, SHEET)
        self.state, self.mode, self.position = "disabled", 0, 1000
        # Remaining SYNCs of a homing run; None before the first run; 0 after it.
        self.homing = None
        self.running = False
        network.subscribe(0x000, self.nmt)
        network.subscribe(0x080, self.sync)
        network.subscribe(0x200 + NUMBER, self.command)

    def boot(self):
        self.running = False
        # A LocalNode sends neither by itself, and until then its heartbeats are boot-up messages.
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def nmt(self, _id, data, _time):
        command, node = data[0], data[1]
        if node in (0, NUMBER):
            self.running = command == 1
            if command in (129, 130):
                # From another thread: otherwise the response would be sent from within a callback.
                threading.Timer(0.05, self.boot).start()

    def mirror(self, **objects):
        """SDO reads return the PDO values, as in a drive."""
        for index, value in objects.items():
            self.node.data_store.setdefault(int(index[1:], 16), {})[0] = bytes(value)

    def command(self, _id, data, _time):
        self.mirror(x6040=data[0:2], x6060=data[2:3], x607A=data[3:7])
        word = int.from_bytes(data[0:2], "little")
        self.mode = int.from_bytes(data[2:3], "little", signed=True)
        target = int.from_bytes(data[3:7], "little", signed=True)
        if word & 0x82 == 0:
            self.state = "disabled"
        elif word & 0x87 == 6:
            self.state = "ready"
        elif word & 0x8F == 7 and self.state in ("ready", "on", "enabled"):
            self.state = "on"
        elif word & 0x8F == 15 and self.state in ("on", "enabled"):
            self.state = "enabled"
        if self.state == "enabled" and self.mode == 8:
            self.position = target
        if self.state != "enabled" or self.mode != 6 or not word & 0x10:
            self.homing = None
        elif self.homing is None:
            self.homing = 5

    def status(self):
        if self.state != "enabled" or self.mode != 6:
            return self.STATES[self.state]
        # Bits 12 and 10: homing attained and target reached after a run, neither during it.
        if self.homing is None:
            return 0x0637
        if self.homing > 0:
            self.homing -= 1
            if self.homing == 0:
                self.position = 0
        return 0x0237 if self.homing else 0x1637

    def sync(self, _id, _data, _time):
        if self.running:
            status = self.status().to_bytes(2, "little")
            mode = self.mode.to_bytes(1, "little", signed=True)
            position = self.position.to_bytes(4, "little", signed=True)
            self.mirror(x6041=status, x6061=mode, x6064=position)
            self.network.send_message(0x180 + NUMBER, status + mode + position)


def follow(network):
    follower = Follower(network)
    follower.boot()
    print("ok follows", flush=True)
    sys.stdin.read()
    print(f"position {follower.position}", flush=True)


def main():
    network = canopen.Network()
    network.connect(interface="socketcan", channel=CHANNEL)
    try:
        {"lead": lead, "follow": follow}[ROLE](network)
    finally:
        network.disconnect()


main()
