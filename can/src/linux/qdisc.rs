//! Count of frames dropped by the send queues (qdiscs) of an interface, by rtnetlink. The statistics in sysfs count
//! only drops of the driver. It changes no queue.
//!
//! | bytes of a message | content |
//! |---|---|
//! | 0 to 3 | total length |
//! | 4, 5 | 38: request the queues; 36: a queue; 3: end; 2: error |
//! | 6, 7 | flags: 301h requests all |
//! | 20 to 23 | interface index |
//! | 28 to 31 | parent of the queue: FFFF_FFFFh is the interface itself |
//! | 36 ... | attributes, of which 7 holds 3, the third number of which is the count |

use super::netlink::{Kernel, NLMSG_ERROR, find_attribute, u16_at, u32_at};

const RTM_NEWQDISC: u16 = 36;
const RTM_GETQDISC: u16 = 38;
const REQUEST_DUMP: u16 = 0x301;
const NLMSG_DONE: u16 = 3;
const TC_H_ROOT: u32 = 0xFFFF_FFFF;
const TCA_STATS2: u16 = 7;
const TCA_STATS_QUEUE: u16 = 3;
/// Header length of a message, and of a message about a queue.
const HEAD: usize = 16;
const QUEUE_HEAD: usize = 36;
/// Maximum answers to read; a host has some dozens of queues.
const ANSWERS: usize = 256;

/// Frames dropped by the queue of an interface since its creation; `None` if the kernel does not report it.
pub(super) fn refused(index: u32) -> Option<u32> {
    dump(index).ok()?.refused
}

fn dump(index: u32) -> nix::Result<Read> {
    let kernel = Kernel::open()?;
    kernel.send(&request())?;
    let mut answer = [0; 16_384];
    let mut all = Read::default();
    for _ in 0..ANSWERS {
        let Ok(answer) = kernel.receive(&mut answer) else {
            break;
        };
        let read = read(answer, index);
        all.refused = all.refused.or(read.refused);
        all.ends = read.ends;
        if read.ends {
            break;
        }
    }
    Ok(all)
}

fn request() -> [u8; QUEUE_HEAD] {
    let mut bytes = [0; QUEUE_HEAD];
    bytes[..4].copy_from_slice(&36_u32.to_ne_bytes());
    bytes[4..6].copy_from_slice(&RTM_GETQDISC.to_ne_bytes());
    bytes[6..8].copy_from_slice(&REQUEST_DUMP.to_ne_bytes());
    bytes
}

/// Content of one answer.
#[derive(Debug, Default, PartialEq, Eq)]
struct Read {
    refused: Option<u32>,
    ends: bool,
}

fn read(mut bytes: &[u8], index: u32) -> Read {
    let mut read = Read::default();
    while let (Some(len), Some(kind)) = (u32_at(bytes, 0), u16_at(bytes, 4)) {
        let len = usize::try_from(len).unwrap_or(0);
        let Some(message) = bytes.get(..len).filter(|_| len >= HEAD) else {
            break;
        };
        match kind {
            NLMSG_DONE | NLMSG_ERROR => read.ends = true,
            RTM_NEWQDISC => read.refused = read.refused.or_else(|| of_queue(message, index)),
            _ => {}
        }
        bytes = bytes.get(len.next_multiple_of(4)..).unwrap_or_default();
    }
    read
}

/// The count in a message about the root queue of that interface.
fn of_queue(message: &[u8], index: u32) -> Option<u32> {
    if (u32_at(message, 20)?, u32_at(message, 28)?) != (index, TC_H_ROOT) {
        return None;
    }
    let statistics = find_attribute(message.get(QUEUE_HEAD..)?, TCA_STATS2)?;
    u32_at(find_attribute(statistics, TCA_STATS_QUEUE)?, 8)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::linux::netlink::attribute;

    /// A message about a queue that dropped this many frames.
    fn queue(index: u32, parent: u32, refused: u32) -> Vec<u8> {
        let numbers = [0, 0, refused, 0, 0].map(u32::to_ne_bytes).concat();
        let mut statistics = Vec::new();
        attribute(&mut statistics, 1, &[0; 16]);
        attribute(&mut statistics, TCA_STATS_QUEUE, &numbers);
        let mut message = vec![0; QUEUE_HEAD];
        attribute(&mut message, 1, b"tbf\0");
        attribute(&mut message, TCA_STATS2 | 0x8000, &statistics);
        let len = u32::try_from(message.len()).unwrap();
        message[..4].copy_from_slice(&len.to_ne_bytes());
        message[4..6].copy_from_slice(&RTM_NEWQDISC.to_ne_bytes());
        message[20..24].copy_from_slice(&index.to_ne_bytes());
        message[28..32].copy_from_slice(&parent.to_ne_bytes());
        message
    }

    #[test]
    fn qdisc_count_is_that_of_root_queue() {
        let done = [20_u32.to_ne_bytes(), [3, 0, 2, 0], [0; 4], [0; 4], [0; 4]].concat();
        let others = [queue(6, TC_H_ROOT, 1), queue(7, 0x0001_0001, 2)].concat();
        let all = [others.clone(), queue(7, TC_H_ROOT, 3), done].concat();
        let expected = Read {
            refused: Some(3),
            ends: true,
        };
        assert_eq!(read(&all, 7), expected);
        assert_eq!(read(&others, 7), Read::default());
        assert_eq!(RTM_GETQDISC, libc::RTM_GETQDISC);
        assert_eq!(RTM_NEWQDISC, libc::RTM_NEWQDISC);
    }

    #[test]
    fn qdisc_kernel_reports_loopback_queue() {
        let nowhere = dump(0x7FFF_FFF0).unwrap();
        assert_eq!((nowhere.refused, nowhere.ends), (None, true));
        // Every host has a loopback interface, whose queue drops nothing; the kernel lists it once it is up.
        let (index, state) = ("/sys/class/net/lo/ifindex", "/sys/class/net/lo/operstate");
        let of_loopback = |path| std::fs::read_to_string(path).unwrap_or_default();
        if let (Ok(index), "unknown") =
            (of_loopback(index).trim().parse(), of_loopback(state).trim())
        {
            assert_eq!(refused(index), Some(0));
        }
    }

    proptest! {
        #[test]
        fn qdisc_any_answer_does_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..100), at in 0..120_usize, byte: u8) {
            let _ = read(&bytes, 7);
            let mut damaged = queue(7, TC_H_ROOT, 3);
            let at = at % damaged.len();
            damaged[at] = byte;
            let _ = read(&damaged, 7);
        }
    }
}
