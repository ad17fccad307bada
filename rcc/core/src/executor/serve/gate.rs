//! During a stop, no command that moves a device reaches its driver, whichever net still commands it; and
//! a command from then passes again only after it was withdrawn in between. A stop ends nets that claim a device;
//! those that only hold a part of it, such as an impedance, continue.

use takt_net::Image;
use takt_net::device::{self, is_in_force};

use crate::device::{DeviceCommand, Place};

/// Commands that a stop withholds from one device's driver.
#[derive(Debug)]
pub(super) struct Gate {
    /// By the first word of each command.
    shut: Box<[bool]>,
    any: bool,
}

impl Gate {
    /// One for so many words of commands.
    pub(super) fn new(words: usize) -> Self {
        Self {
            shut: vec![false; words].into(),
            any: false,
        }
    }

    /// Withholds the commands that must not pass in the cycle of `command`.
    pub(super) fn pass(
        &mut self,
        command: &mut DeviceCommand,
        place: &Place,
        image: &Image,
        is_stopped: bool,
    ) {
        if is_stopped {
            command.joints.iter_mut().for_each(|set_points| {
                set_points.advance(None);
            });
        } else if !self.any {
            return;
        }
        self.any = false;
        for (at, shut) in self.shut.iter_mut().enumerate() {
            let is_given = image.is_owned(place.commands.start + at);
            *shut = is_given
                && (is_stopped || (*shut && is_in_force(&command.words, at, command.cycle)));
            self.any |= *shut;
            if *shut {
                device::withhold(&mut command.words, at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use takt_net::Twist;
    use takt_net::device::Layout;

    use super::*;

    #[test]
    fn additions_under_a_stop_pass_only_after_a_pause() {
        let mut layout = Layout::default();
        let torque = layout.command::<Twist>();
        let place = Place {
            commands: 0..layout.commands,
            ..Place::default()
        };
        let image = Image::default();
        let mut gate = Gate::new(layout.commands);
        let mut cycle = 10;
        // Whether it is given in this cycle, whether the stop is active, whether it reaches the driver.
        for (is_given, is_stopped, passes) in [
            (true, false, true),
            (true, true, false),
            (true, true, false),
            (true, false, false),
            (true, false, false),
            (false, false, false),
            (true, false, true),
            (true, true, false),
            (false, true, false),
            (true, true, false),
            (true, false, false),
        ] {
            cycle += 1;
            let mut command = DeviceCommand::new(layout.commands);
            command.cycle = cycle;
            if is_given {
                image.owners[0].set(Some(3));
                for (word, stamp) in image.commands.iter().zip([cycle, cycle, 1]) {
                    word.set(stamp);
                }
            }
            for (word, cell) in command.words.iter_mut().zip(&image.commands) {
                *word = cell.get();
            }
            gate.pass(&mut command, &place, &image, is_stopped);
            let stands = torque.read(&command.words).unwrap().is_in_force(cycle);
            assert_eq!(stands, passes, "cycle {cycle}");
        }
    }
}
