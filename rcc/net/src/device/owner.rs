//! Whose a command is. Each command in the image carries the net that gave it, so that all a net commanded is
//! withdrawn in one place when it ends, whatever primitive gave it. Which net has ended is not decided here.

use std::ops::Range;

use super::signal::EVERY;
use super::{Image, JointCommand};

/// Something that nets command, by its place in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    /// The joint of that number.
    Joint(usize),
    /// The command whose first word has that number.
    Words(usize),
}

impl Image {
    /// The net that a command is of.
    fn owner(&self, target: Target) -> Option<u32> {
        match target {
            Target::Joint(at) => self.joints.get(at)?.command.get().net,
            Target::Words(at) => self.owners.get(at)?.get(),
        }
    }

    /// The cycle in which it was given.
    fn given(&self, target: Target) -> u64 {
        match target {
            Target::Joint(at) => self.joints.get(at).map(|joint| joint.command.get().cycle),
            Target::Words(at) => self.commands.get(at + 1).map(|word| word.get()),
        }
        .unwrap_or(0)
    }

    /// Withdraws a command: it no longer stands, in this very cycle. When it was given, and what, remains.
    fn withdraw_one(&self, target: Target) {
        match target {
            Target::Joint(at) => {
                if let Some(joint) = self.joints.get(at) {
                    joint.command.set(JointCommand {
                        every: 0,
                        net: None,
                        ..joint.command.get()
                    });
                }
            }
            Target::Words(at) => {
                if let (Some(owner), Some(every)) =
                    (self.owners.get(at), self.commands.get(at + EVERY))
                {
                    owner.set(None);
                    every.set(0);
                }
            }
        }
    }

    /// Withdraws what is of nets of which `ended` says so, among the first `joints` and `commands`. Returns whether
    /// there was anything.
    pub fn withdraw(&self, joints: usize, commands: usize, ended: impl Fn(u32) -> bool) -> bool {
        let joints = (0..joints.min(self.joints.len())).map(Target::Joint);
        let words = (0..commands.min(self.owners.len())).map(Target::Words);
        let mut any = false;
        for target in joints.chain(words) {
            if self.owner(target).is_some_and(&ended) {
                self.withdraw_one(target);
                any = true;
            }
        }
        any
    }

    /// Passes a command of a net of which `ended` says so on to the net `heir`: it stands as long as it would have.
    pub fn pass_on(&self, target: Target, heir: u32, ended: impl Fn(u32) -> bool) {
        if !self.owner(target).is_some_and(ended) {
            return;
        }
        match target {
            Target::Joint(at) => {
                let joint = &self.joints[at];
                joint.command.set(JointCommand {
                    net: Some(heir),
                    ..joint.command.get()
                });
            }
            Target::Words(at) => self.owners[at].set(Some(heir)),
        }
    }

    /// Withdraws a command that was passed on to a net which does not give it in `cycle`, its first.
    pub fn withdraw_unused(&self, target: Target, heir: u32, cycle: u64) {
        if self.owner(target) == Some(heir) && self.given(target) != cycle {
            self.withdraw_one(target);
        }
    }

    /// Forgets whose the commands in these words are.
    pub fn forget_owners(&self, commands: Range<usize>) {
        let owners = self.owners.get(commands);
        owners
            .into_iter()
            .flatten()
            .for_each(|owner| owner.set(None));
    }

    /// Whether a command of a net that runs begins at that word.
    #[must_use]
    pub fn is_owned(&self, at: usize) -> bool {
        self.owners
            .get(at)
            .is_some_and(|owner| owner.get().is_some())
    }
}
