//! Devices are added to and removed from an executor's image: which joints and words are in use, and the device
//! states on which the life of nets depends. Other modules read and write the values.

use std::cell::Cell;
use std::ops::Range;

use takt_net::device::{JointCommand, Trail};

use super::{DEVICES_MAX, DeviceView, Executor};
use crate::device::Place;

impl Executor {
    /// Puts the first `joints` joints of the image into use.
    pub fn use_joints(&mut self, joints: usize) {
        self.joints = self.joints.max(joints).min(self.image.joints.len());
    }

    /// Puts the slots of a device into use and clears values of another device there.
    pub fn use_place(&mut self, number: usize, place: &Place) {
        self.set_place(number, place);
        self.use_joints(place.first_joint + place.joints);
        let joints = self.image.joints.iter().skip(place.first_joint);
        for joint in joints.take(place.joints) {
            joint.command.set(JointCommand::default());
            joint.trail.set(Trail::default());
        }
        self.use_words(place.signals.end, place.commands.end);
        let signals = self.image.signals.get(place.signals.clone());
        signals.into_iter().flatten().for_each(|word| word.set(0));
        self.use_commands(place.commands.clone());
    }

    /// Sets where the slots of a device are.
    pub(crate) fn set_place(&mut self, number: usize, place: &Place) {
        // Its capacity is that of all devices.
        while self.places.len() <= number && self.places.len() < DEVICES_MAX {
            self.places.push(Place::default());
        }
        if let Some(known) = self.places.get_mut(number) {
            known.clone_from(place);
        }
    }

    /// Puts the first words of the image into use.
    pub(crate) fn use_words(&mut self, signals: usize, commands: usize) {
        self.used.signals = self.used.signals.max(signals);
        self.used.commands = self.used.commands.max(commands);
    }

    /// Clears the commands in these words.
    pub(crate) fn use_commands(&mut self, commands: Range<usize>) {
        let words = self.image.commands.get(commands.clone());
        words.into_iter().flatten().for_each(|word| word.set(0));
        self.image.forget_owners(commands.clone());
        // There are never more than devices in one cycle; a push would allocate beyond that.
        if self.fresh.len() < self.fresh.capacity() {
            self.fresh.push(commands);
        }
    }

    /// Sets the state of a device.
    pub fn set_device(&mut self, number: usize, view: DeviceView) {
        while self.devices.len() <= number && self.devices.len() < DEVICES_MAX {
            self.devices.push(DeviceView::default());
        }
        let device = self.devices.get_mut(number);
        if let Some((device, epoch)) = device.zip(self.epochs.get_mut(number)) {
            let begins = view.is_ready() && !device.is_ready();
            let changed = view.faults != device.faults || view.jumps != device.jumps;
            if begins || changed {
                *epoch += 1;
                self.epochs_changed = true;
            }
            *device = view;
        }
    }

    /// The epoch of a device: it advances with each fault, each position jump and each enable, after which the device
    /// may be at another position.
    pub(super) fn epoch(&self, number: usize) -> u64 {
        self.epochs.get(number).copied().unwrap_or(0)
    }

    /// The joints in use.
    #[must_use]
    pub fn joints(&self) -> &[takt_net::device::Joint] {
        &self.image.joints[..self.joints]
    }

    /// The words in use of driver values beside joints.
    pub(crate) fn signals(&self) -> &[Cell<u64>] {
        let signals = &self.image.signals;
        &signals[..self.used.signals.min(signals.len())]
    }

    /// The words in use of net commands beside joints.
    pub(crate) fn commands(&self) -> &[Cell<u64>] {
        let commands = &self.image.commands;
        &commands[..self.used.commands.min(commands.len())]
    }

    /// Commands of devices that came into use since the last cycle.
    pub(crate) fn fresh(&self) -> &[Range<usize>] {
        &self.fresh
    }
}
