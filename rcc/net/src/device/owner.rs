//! Ownership of commands. Each command in the image carries the net that gave it, so that all
//! commands of a net are withdrawn in one place when it ends, whichever primitive gave them. Which
//! net has ended is decided elsewhere.

use std::ops::Range;

use super::signal::EVERY;
use super::{Image, JointCommand};

/// A command of nets, by its index in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    /// The joint with that number.
    Joint(usize),
    /// The command whose first word has that number.
    Words(usize),
}

impl Image {
    /// The net that owns a command.
    fn owner(&self, target: Target) -> Option<u32> {
        match target {
            Target::Joint(at) => self.joints.get(at)?.command.get().net,
            Target::Words(at) => self.owners.get(at)?.get(),
        }
    }

    /// The cycle in which a command was given.
    fn given(&self, target: Target) -> u64 {
        match target {
            Target::Joint(at) => self.joints.get(at).map(|joint| joint.command.get().cycle),
            Target::Words(at) => self.commands.get(at + 1).map(|word| word.get()),
        }
        .unwrap_or(0)
    }

    /// Withdraws a command: it is no longer in force, in this very cycle. Its value and its cycle
    /// remain.
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

    /// Withdraws the commands of all nets for which `ended` is true, among the first `joints` and
    /// `commands`. Returns whether there were any.
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

    /// Withdraws the commands that a net gave to a device, by its joints and command words.
    pub fn withdraw_from(&self, joints: Range<usize>, commands: Range<usize>, net: u32) {
        let targets = joints.map(Target::Joint).chain(commands.map(Target::Words));
        for target in targets {
            if self.owner(target) == Some(net) {
                self.withdraw_one(target);
            }
        }
    }

    /// Transfers a command of a net for which `ended` is true to the net `successor`: it is in force as
    /// long as it would have been.
    pub fn transfer(&self, target: Target, successor: u32, ended: impl Fn(u32) -> bool) {
        if !self.owner(target).is_some_and(ended) {
            return;
        }
        match target {
            Target::Joint(at) => {
                let joint = &self.joints[at];
                joint.command.set(JointCommand {
                    net: Some(successor),
                    ..joint.command.get()
                });
            }
            Target::Words(at) => self.owners[at].set(Some(successor)),
        }
    }

    /// Withdraws a command that was transferred to a net which does not give it in `cycle`, its
    /// first.
    pub fn withdraw_unused(&self, target: Target, successor: u32, cycle: u64) {
        if self.owner(target) == Some(successor) && self.given(target) != cycle {
            self.withdraw_one(target);
        }
    }

    /// Clears the owners of the commands in these words.
    pub fn forget_owners(&self, commands: Range<usize>) {
        let owners = self.owners.get(commands);
        owners
            .into_iter()
            .flatten()
            .for_each(|owner| owner.set(None));
    }

    /// Whether a running net owns a command that begins at that word.
    pub fn is_owned(&self, at: usize) -> bool {
        self.owners
            .get(at)
            .is_some_and(|owner| owner.get().is_some())
    }
}
