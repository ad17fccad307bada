# Creates buses for tests in a network namespace or a virtual machine; its root shell reads this file.
# Variables name the buses; tests skip themselves without them. Nothing is created on a host.
#
#   TAKT_VCAN, TAKT_VCAN_SECOND   two virtual CAN interfaces, of one bus each
#   TAKT_CAN_PAIR=can0,can1       two CAN controllers on one bus, 500 kbit/s (virtual machine only)
#   TAKT_VETH, TAKT_VETH_SECOND   the two ends of an Ethernet cable without IP

exists() { ip link show "$1" >/dev/null 2>&1; }
ip link set lo up
# Fails if modules are built in, or without the right to load them.
modprobe --all --quiet can-raw can-bcm vcan veth kvaser_pci 2>/dev/null

for name in vcan0 vcan1; do
    ip link add "$name" type vcan 2>/dev/null && ip link set "$name" up
done
if exists vcan0 && exists vcan1; then
    export TAKT_VCAN=vcan0 TAKT_VCAN_SECOND=vcan1
fi

for name in can0 can1; do
    exists "$name" && ip link set "$name" up type can bitrate 500000
done
if exists can0 && exists can1; then
    export TAKT_CAN_PAIR=can0,can1
fi

if ip link add takt0 type veth peer name takt1 2>/dev/null; then
    # Only the tests' frames may be on the cable.
    for name in takt0 takt1; do
        echo 1 2>/dev/null >"/proc/sys/net/ipv6/conf/$name/disable_ipv6"
        ip link set "$name" up
    done
    export TAKT_VETH=takt0 TAKT_VETH_SECOND=takt1
fi
