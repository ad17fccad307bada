//! Commands at both ends of a ring, in virtual time: a closed ring, and a ring with a cut cable.

use std::cell::RefCell;
use std::rc::Rc;

use super::*;

/// A ring, and the frames that return to each of its ends.
#[derive(Debug)]
struct Ring {
    segment: Segment,
    now: Duration,
    returned: [VecDeque<(Duration, Vec<u8>)>; 2],
}

/// An interface at one end of the ring.
#[derive(Clone, Debug)]
struct RingPort(Rc<RefCell<Ring>>, Entry);

impl Link for RingPort {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut ring = self.0.borrow_mut();
        let mut frame = bytes.to_vec();
        let now = ring.now;
        let ns = u64::try_from(now.as_nanos()).unwrap();
        if let Some(back) = ring.segment.process_ethernet(&mut frame, self.1, ns) {
            let due = now + Duration::from_nanos(back.after);
            ring.returned[usize::from(back.by == Entry::Last)].push_back((due, frame));
        }
        Ok(bytes.len())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let mut ring = self.0.borrow_mut();
        let until = ring.now + timeout;
        let returned = &mut ring.returned[usize::from(self.1 == Entry::Last)];
        let Some((due, frame)) = returned.pop_front_if(|(due, _)| *due <= until) else {
            ring.now = until;
            return Ok(None);
        };
        ring.now = ring.now.max(due);
        buf[..frame.len()].copy_from_slice(&frame);
        Ok(Some((frame.len(), ring.now)))
    }
}

impl Wire for RingPort {
    fn now(&mut self) -> io::Result<Duration> {
        Ok(self.0.borrow().now)
    }

    fn wait_until(&mut self, at: Duration) -> io::Result<()> {
        let mut ring = self.0.borrow_mut();
        ring.now = ring.now.max(at);
        let ns = u64::try_from(ring.now.as_nanos()).unwrap();
        ring.segment.poll(ns);
        Ok(())
    }
}

/// Three terminals in a ring, brought up from both ends; the cable `cut` is cut before.
fn ring(cut: Option<usize>, goal: AlState) -> (Session<RingPort>, RingPort) {
    let (mut session, end) = unstarted(cut, goal);
    session.bring_up(Duration::from_secs(10)).unwrap();
    (session, end)
}

fn unstarted(cut: Option<usize>, goal: AlState) -> (Session<RingPort>, RingPort) {
    unstarted_at(Entry::First, cut, goal)
}

/// With this end named first.
fn unstarted_at(first: Entry, cut: Option<usize>, goal: AlState) -> (Session<RingPort>, RingPort) {
    let terminals = (0..3).map(|_| Io::digital(8, 8).0);
    let mut segment = Segment::line(terminals.collect::<Vec<_>>());
    segment.set_redundant(true);
    if let Some(cut) = cut {
        segment.set_link(cut, false);
    }
    let end = RingPort(
        Rc::new(RefCell::new(Ring {
            segment,
            now: Duration::from_secs(1),
            returned: Default::default(),
        })),
        first,
    );
    let config = MasterConfig {
        goal,
        cycle: CYCLE,
        redundant: true,
        ..MasterConfig::default()
    };
    let last = match first {
        Entry::First => Entry::Last,
        Entry::Last => Entry::First,
    };
    let other = RingPort(end.0.clone(), last);
    let session = Session::new("near", end.clone(), [2, 0, 0, 0, 0, 1], config).unwrap();
    let mut session = session.with_second(other, [2, 0, 0, 0, 0, 2]);
    session.listen().unwrap();
    (session, end)
}

const GAP: &str = "the cable from slave 1 port 1 to slave 2 port 0: the ring is open there";

#[test]
fn ring_is_scanned_from_both_ends() {
    let (session, _) = ring(None, AlState::PreOp);
    let text = scan::text(&session);
    assert!(text.contains("near: 3 slaves"), "{text}");
    assert!(text.ends_with("the ring is whole\n"), "{text}");
    assert_eq!(scan::verdict(session.master()), Verdict::Good);
}

#[test]
fn ring_with_ends_reversed_is_not_an_open_one() {
    let timeout = Duration::from_secs(10);
    for (first, cut, reversed) in [
        (Entry::First, None, false),
        (Entry::Last, None, true),
        // Nothing comes through the ring: the cable is cut indeed.
        (Entry::First, Some(0), false),
        (Entry::Last, Some(0), false),
    ] {
        let (mut session, _) = unstarted_at(first, cut, AlState::PreOp);
        session.bring_up(timeout).unwrap();
        assert_eq!(session.is_reversed(), reversed, "{first:?} {cut:?}");
        let is_open = session.master().ring_gap().is_some();
        assert_eq!(is_open, cut.is_some() || reversed, "{first:?} {cut:?}");
    }
    let text = crate::ecat::ring::reversed("back", "near").to_string();
    assert!(text.ends_with("`near --second back`"), "{text}");
}

#[test]
fn ring_with_cut_cable_names_it_and_continues() {
    let (mut session, end) = ring(None, AlState::SafeOp);
    end.0.borrow_mut().segment.set_link(2, false);
    let measured = stat::Measured::take(&mut session, Duration::from_millis(200)).unwrap();
    let text = stat::table(&session, &measured);
    assert_eq!(text.matches("SAFE-OP ").count(), 3, "{text}");
    let findings = finding::verdict("near", &measured.findings(session.master()));
    assert!(findings.contains(GAP), "{findings}");
    assert_eq!(
        findings.matches("the ring is open").count(),
        1,
        "{findings}"
    );
}

#[test]
fn ring_cut_before_start_is_reported() {
    let (mut session, _) = unstarted(Some(2), AlState::SafeOp);
    for _ in 0..20 {
        session.cycle().unwrap();
    }
    let error = session.silence().unwrap_err().to_string();
    assert!(
        error.contains("near: the ring is open before the slave at position 2"),
        "{error}"
    );
    // A ring that is open at its start is a line.
    let (session, _) = ring(Some(0), AlState::PreOp);
    let text = scan::text(&session);
    assert!(text.contains("near: 3 slaves"), "{text}");
    assert!(
        text.contains("from the master to slave 0 port 0: the ring is open there"),
        "{text}"
    );
    assert_eq!(scan::verdict(session.master()), Verdict::Failed);
}
