//! Remedies of the findings, for the person at the bus.

use super::Finding;

impl Finding {
    /// The remedy.
    #[expect(clippy::too_many_lines, reason = "a table of texts")]
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::BusOff { still: true, .. } => {
                "find the cause (bit rates, wires, two nodes with the same number), then ip link set IFACE type can \
                 restart; with restart-ms 100 it restarts automatically"
            }
            Self::BusOff { still: false, .. } => {
                "it has recovered; compare bit rates and sample points of all nodes, and check for two nodes with the same \
                 number"
            }
            Self::Alone { .. } => {
                "no other node is on the wire or none has this bit rate: check power, plug, bit rate, and \
                 whether the others only listen"
            }
            Self::NothingButErrors { .. } => {
                "the bit rates differ: set this interface to that of the nodes (takt can up IFACE --bitrate \
                 RATE); if they agree, CAN_H and CAN_L are swapped or a terminating resistor is missing"
            }
            Self::Nothing { .. } => {
                "are the nodes powered, and is this the right interface? Nodes configured for heartbeats send \
                 themselves by a boot-up message when switched on"
            }
            Self::Disturbed { .. } => {
                "measure 60 ohms between CAN_H and CAN_L with all switched off (two resistors of 120), then \
                 check stubs, shield and sample points"
            }
            Self::Wires { .. } => "check for a cut or short of CAN_H and CAN_L at this host's plug",
            Self::Weak { .. } => {
                "many frames were destroyed: see the errors in takt can dump; a controller that stays passive is \
                 the next to go off the bus"
            }
            Self::Load { .. } => {
                "send less often what takes most (longer SYNC period, inhibit times, event-driven PDOs), or \
                 raise the bit rate"
            }
            Self::HeartbeatMissing { own: true, .. } => {
                "the program on this host that sent it has ended or hangs; nodes that monitor it react by 1029h and 6007h"
            }
            Self::HeartbeatLate { own: true, .. } => {
                "this host stalled, not the bus: check the priority and the CPU of the program that sends it (takt doctor, \
                 takt jitter)"
            }
            Self::BootLoop { .. } => {
                "the node does not stay up: check its supply under load, its watchdog, and whether its firmware is complete; \
                 its emergencies before each restart name the cause"
            }
            Self::Duplicate { .. } => {
                "unplug all but one of them and give it another number by its switch or by LSS (takt can scan shows serial \
                 numbers); until then a command to one moves both"
            }
            Self::StrayPdos { .. } => {
                "its PDOs must stop outside of Operational: another node may use its identifiers (compare 1800h:01 of all), \
                 it may have left Operational by an error (1029h), or its firmware is at fault"
            }
            Self::EmergencyStorm { .. } => {
                "its cause comes and goes, or its firmware repeats what it should send once: find the cause by 1003h; the \
                 inhibit time 1015h limits the load until then"
            }
            Self::TwoSyncs { .. } => {
                "switch one of them off (1005h bit 30 of the nodes, the period of the masters): drives interpolate between \
                 both and run rough or fault"
            }
            Self::HeartbeatMissing { .. } => {
                "the node is off, reset, or unplugged; if others are silent from the same moment on, check \
                 the wire between them"
            }
            Self::HeartbeatLate { .. } => {
                "the bus was blocked by lower identifiers, or the node is overloaded: compare with the load"
            }
            Self::Rebooted { .. } => {
                "no NMT reset was observed before it: check the node's supply and its watchdog"
            }
            Self::Emergency { .. } | Self::EmergencyEnded { .. } => {
                "read the node's error history, object 1003h, and its manual"
            }
            Self::SdoUnanswered { .. } => {
                "is the node powered, its number right, and its state not Stopped, in which no SDO runs? See takt \
                 can scan; if it answers now and then, a client's timeout is shorter than its answers take"
            }
            Self::SdoAbsent { .. } => {
                "a bus scan requests all node numbers; if these nodes should exist, check power, bit rate and node numbers"
            }
            Self::SdoRefused { .. } => {
                "a client requests objects that the node lacks, or writes values that it rejects: compare with its data \
                 sheet (takt can sdo compare); of optional objects it is harmless"
            }
            Self::SdoGivenUp { .. } => {
                "the client did not understand the answers: two nodes with the same number, two clients at once, or a \
                 fault in the node's SDO server; see takt can dump --filter sdo"
            }
            Self::SdoRepeated { .. } => {
                "give the client a longer timeout, or keep a second client away: a node answers one at a time"
            }
            Self::SdoUnsolicited { .. } => {
                "two nodes with the same number, answers to what was requested before the node started, a faulty SDO \
                 server, or a recording that lacks the requests"
            }
            Self::SyncJitter { .. } => {
                "drives that interpolate need SYNC within a few percent: send it from a real-time thread, not \
                 by the kernel's broadcast manager; see takt jitter; two producers of different periods look so too"
            }
            Self::Dropped { .. } => {
                "what reads the socket is too slow: give it a larger buffer (sysctl net.core.rmem_max), \
                 filters, or a higher priority"
            }
            Self::ControllerOverflow { .. } => {
                "the interrupt comes too late: raise the priority of the adapter's interrupt thread; see takt \
                 doctor"
            }
            Self::Refused { .. } => {
                "make the queue longer if bursts are longer than it (ip link set IFACE txqueuelen 1000); a \
                 queue that never empties means that the bus is overloaded or no node acknowledges"
            }
        }
    }
}
