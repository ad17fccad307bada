//! The master handles any received frame, and recovers when the wire is good again.

use takt_tests::Random;

use super::*;
use crate::emulator::{ServoConfig, ServoDrive};

fn segment() -> Segment {
    let (terminal, _) = Io::digital(8, 8);
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    Segment::line([Coupler::slave(), terminal, drive])
}

impl Rig {
    /// A cycle with a modified answer: one to four bytes behind the frame header.
    fn broken_cycle(&mut self, random: &mut Random) {
        let mut frame = [0; 1500];
        if let Some(len) = self.master.poll_transmit(self.now, &mut frame) {
            let ns = u64::try_from(self.now.as_nanos()).unwrap();
            if let Some(returned) = self.segment.process(&mut frame[..len], Entry::First, ns) {
                for _ in 0..=random.below(4) {
                    let at = 2 + random.below(len - 2);
                    frame[at] = random.byte();
                }
                let at = self.now + Duration::from_nanos(returned.after);
                self.master.handle_frame(0, &frame[..len], at);
            }
        }
        while self.master.poll_event().is_some() {}
        while self.master.poll_emergency().is_some() {}
        self.now += Duration::from_millis(1);
    }
}

#[test]
fn random_frames_are_answered() {
    let mut rig = Rig::new(MasterConfig::default(), segment());
    let mut random = Random::new(1);
    for n in 0..20_000 {
        let mut bytes = [0; 200];
        let len = random.below(bytes.len());
        bytes.iter_mut().for_each(|byte| *byte = random.byte());
        rig.master
            .handle_frame(random.below(3), &bytes[..len], rig.now);
        if n % 4 == 0 {
            rig.cycle();
        }
    }
    assert!(rig.master.is_operational(), "nothing of it was an answer");
}

/// Modified datagrams are accepted, as their check sequence is valid: sizes, states, SII, objects and working counters
/// are sometimes wrong, during start-up and later.
#[test]
fn changed_answers_are_survived_and_left_behind() {
    for seed in 0..3 {
        let mut rig = Rig::new(MasterConfig::default(), segment());
        let mut random = Random::new(seed);
        for n in 0..1500 {
            if n % 8 == 0 {
                rig.broken_cycle(&mut random);
            } else {
                rig.cycle();
            }
        }
        rig.master.restart();
        rig.until(8000, Master::is_operational);
        for _ in 0..2000 {
            rig.broken_cycle(&mut random);
        }
        rig.until(60_000, Master::is_operational);
    }
}
