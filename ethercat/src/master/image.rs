//! The process image: outputs and inputs of all slaves, their regions, and the datagrams that carry them. Outputs and
//! inputs of a group are adjacent in logical memory and never overlap, so that the halves of a cut ring can be merged.
//! Which slaves are present is not known here.

use std::ops::Range;

use super::exchange::{Batch, Owner};
use super::process::ProcessData;
use crate::config::IMAGE_MAX;
use crate::wire::FrameWriter;
use crate::{Address, Command, DatagramHeader, FrameHeader};

/// Number of slave groups, each with its own working counter.
pub(super) const GROUPS: usize = 8;

/// What a slave requires in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Need {
    pub(super) group: u8,
    pub(super) outputs: usize,
    pub(super) inputs: usize,
    pub(super) lrw: bool,
}

impl Need {
    pub(super) fn new(group: u8, process: &ProcessData, lrw: bool) -> Self {
        let (outputs, inputs) = (process.outputs_len(), process.inputs_len());
        Self {
            group,
            outputs,
            inputs,
            lrw,
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Region {
    outputs: Range<usize>,
    inputs: Range<usize>,
    group: usize,
    /// Cycles since its inputs were last read.
    age: u32,
}

/// A group's part of the image, and the status of its datagrams.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Group {
    outputs: Range<usize>,
    inputs: Range<usize>,
    /// One LRW datagram for both directions.
    lrw: bool,
    /// Working counter of the last cycle, summed over its datagrams.
    pub counter: u16,
    /// Expected minimum and maximum, by the states of its slaves.
    pub expected: (u16, u16),
    /// Cycles with an unexpected working counter.
    pub misses: u64,
    /// Datagrams of the cycle that have returned.
    parts: u8,
}

impl Group {
    /// Lengths of its datagrams.
    fn datagrams(&self) -> impl Iterator<Item = usize> + use<> {
        let (out, back) = (self.outputs.len(), self.inputs.len());
        let two = if self.lrw && out > 0 && back > 0 {
            [out + back, 0]
        } else {
            [out, back]
        };
        two.into_iter().filter(|len| *len > 0)
    }
}

/// The image does not fit a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooLarge {
    pub(super) bytes: usize,
}

/// The process image.
#[derive(Debug, Default)]
pub(super) struct Image {
    outputs: Vec<u8>,
    inputs: Vec<u8>,
    /// Inputs of the current cycle, until its working counter is known.
    incoming: Vec<u8>,
    regions: Vec<Region>,
    groups: [Group; GROUPS],
    /// Buffer for the data of a datagram.
    data: Vec<u8>,
}

impl Image {
    /// Lays out the image: group by group, in each the slaves in their order.
    pub(super) fn new(needs: &[Option<Need>]) -> Result<Self, TooLarge> {
        let mut image = Self {
            regions: vec![
                Region {
                    age: u32::MAX,
                    ..Region::default()
                };
                needs.len()
            ],
            ..Self::default()
        };
        let (mut outputs, mut inputs) = (0, 0);
        for (number, group) in image.groups.iter_mut().enumerate() {
            let begin = (outputs, inputs);
            group.lrw = true;
            for (region, need) in image.regions.iter_mut().zip(needs) {
                let Some(need) = need.filter(|need| usize::from(need.group) == number) else {
                    continue;
                };
                region.group = number;
                region.outputs = outputs..outputs + need.outputs;
                region.inputs = inputs..inputs + need.inputs;
                (outputs, inputs) = (outputs + need.outputs, inputs + need.inputs);
                group.lrw &= need.lrw;
            }
            group.outputs = begin.0..outputs;
            group.inputs = begin.1..inputs;
        }
        let bytes = outputs + inputs;
        if bytes > IMAGE_MAX {
            return Err(TooLarge { bytes });
        }
        image.outputs = vec![0; outputs];
        image.inputs = vec![0; inputs];
        image.incoming = vec![0; inputs];
        image.data = vec![0; bytes];
        Ok(image)
    }

    /// Logical address of a slave's outputs or inputs; `None` if it has no region.
    pub(super) fn logical(&self, slave: usize, outputs: bool) -> Option<u32> {
        let region = self.regions.get(slave)?;
        let group = self.groups.get(region.group)?;
        let (range, base, before) = if outputs {
            (&region.outputs, &group.outputs, 0)
        } else {
            (&region.inputs, &group.inputs, group.outputs.len())
        };
        if range.is_empty() {
            return None;
        }
        let at = u32::try_from(range.start - base.start + before).ok()?;
        Some(Self::base(region.group) + at)
    }

    /// Whether a slave's region has the required size.
    pub(super) fn fits(&self, slave: usize, (outputs, inputs): (usize, usize)) -> bool {
        let region = self.regions.get(slave);
        region
            .is_some_and(|region| region.outputs.len() == outputs && region.inputs.len() == inputs)
    }

    /// Capacity of a mailbox datagram in a frame with the clock's datagram, the census and this image, bytes; before
    /// there is an image its frame contains nothing else.
    pub(super) fn mailbox_capacity(&self) -> usize {
        const CYCLIC: [usize; 2] = [8, 2];
        let overhead = DatagramHeader::LEN + 2;
        let whole = FrameWriter::LEN_MAX - FrameHeader::LEN - overhead;
        if self.regions.is_empty() {
            return whole;
        }
        let lens = self.groups.iter().flat_map(Group::datagrams);
        let used = lens.chain(CYCLIC).map(|len| len + overhead).sum();
        whole.saturating_sub(used)
    }

    const fn base(group: usize) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "one of eight")]
        let group = group as u32;
        (group + 1) << 16
    }

    pub(super) fn groups(&self) -> &[Group; GROUPS] {
        &self.groups
    }

    pub(super) fn outputs_mut(&mut self, slave: usize) -> &mut [u8] {
        let range = self
            .regions
            .get(slave)
            .map(|region| region.outputs.clone())
            .unwrap_or_default();
        self.outputs.get_mut(range).unwrap_or_default()
    }

    /// Inputs of a slave as last read, and how many cycles ago that was.
    pub(super) fn inputs(&self, slave: usize) -> (&[u8], u32) {
        let Some(region) = self.regions.get(slave) else {
            return (&[], u32::MAX);
        };
        (
            self.inputs.get(region.inputs.clone()).unwrap_or_default(),
            region.age,
        )
    }

    /// Adds the datagrams of all groups to a frame.
    pub(super) fn send(&mut self, batch: &mut Batch<'_>) {
        for region in &mut self.regions {
            region.age = region.age.saturating_add(1);
        }
        for (number, group) in self.groups.iter_mut().enumerate() {
            group.parts = 0;
            group.counter = 0;
            let owner = Owner::Process(u8::try_from(number).unwrap_or(0));
            let base = Self::base(number);
            let (out, back) = (group.outputs.len(), group.inputs.len());
            let Some(outputs) = self.outputs.get(group.outputs.clone()) else {
                continue;
            };
            let zeros = Address::Logical(base + u32::try_from(out).unwrap_or(0));
            if group.lrw && out > 0 && back > 0 {
                let Some(data) = self.data.get_mut(..out + back) else {
                    continue;
                };
                let (to, rest) = data.split_at_mut(out);
                to.copy_from_slice(outputs);
                rest.fill(0);
                batch.push(owner, Command::Lrw, Address::Logical(base), data);
                continue;
            }
            if out > 0 {
                batch.push(owner, Command::Lwr, Address::Logical(base), outputs);
            }
            if back > 0 {
                self.data.fill(0);
                batch.push(
                    owner,
                    Command::Lrd,
                    zeros,
                    self.data.get(..back).unwrap_or_default(),
                );
            }
        }
    }

    /// Handles the answer to a datagram of a group; returns whether it was the last of this cycle.
    pub(super) fn receive(
        &mut self,
        group: u8,
        command: Command,
        data: &[u8],
        counter: u16,
    ) -> bool {
        let Some(group) = self.groups.get_mut(usize::from(group)) else {
            return false;
        };
        group.counter = group.counter.wrapping_add(counter);
        group.parts += 1;
        let before = if command == Command::Lrw {
            group.outputs.len()
        } else {
            0
        };
        let inputs = data.get(before..).filter(|_| command != Command::Lwr);
        if let (Some(inputs), Some(to)) = (inputs, self.incoming.get_mut(group.inputs.clone()))
            && inputs.len() == to.len()
        {
            to.copy_from_slice(inputs);
        }
        let lrw = group.lrw && !group.outputs.is_empty() && !group.inputs.is_empty();
        let parts = u8::from(!group.outputs.is_empty()) + u8::from(!group.inputs.is_empty());
        group.parts == if lrw { 1 } else { parts }
    }

    /// Completes a group: if the working counter matches that of its slaves (minimum and maximum per slave), their
    /// inputs are accepted; else the previous ones are kept. Returns whether all of its slaves took part.
    pub(super) fn settle(
        &mut self,
        number: u8,
        contributions: impl Fn(usize, bool) -> (u16, u16),
    ) -> bool {
        let number = usize::from(number);
        let Some(group) = self.groups.get_mut(number) else {
            return false;
        };
        let lrw = group.lrw && !group.outputs.is_empty() && !group.inputs.is_empty();
        let mut expected = (0, 0);
        for (slave, region) in self.regions.iter().enumerate() {
            if region.group == number {
                let (least, most) = contributions(slave, lrw);
                expected = (expected.0 + least, expected.1 + most);
            }
        }
        group.expected = expected;
        let good = (expected.0..=expected.1).contains(&group.counter);
        if !good {
            group.misses += 1;
            return false;
        }
        let all = group.counter == expected.1;
        for (slave, region) in self.regions.iter_mut().enumerate() {
            let (least, most) = contributions(slave, lrw);
            // Inputs of a slave that may not have answered are accepted only if all answered.
            if region.group != number || most == 0 || !(least == most || all) {
                continue;
            }
            let range = region.inputs.clone();
            if let (Some(to), Some(from)) =
                (self.inputs.get_mut(range.clone()), self.incoming.get(range))
            {
                to.copy_from_slice(from);
                region.age = 0;
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn need(group: u8, outputs: usize, inputs: usize, lrw: bool) -> Option<Need> {
        Some(Need {
            group,
            outputs,
            inputs,
            lrw,
        })
    }

    #[test]
    fn groups_lie_apart_and_outputs_before_inputs() {
        let needs = [
            need(1, 2, 3, true),
            need(0, 4, 1, true),
            None,
            need(1, 1, 1, true),
        ];
        let image = Image::new(&needs).unwrap();
        assert_eq!(image.logical(0, true), Some(0x2_0000));
        assert_eq!(image.logical(0, false), Some(0x2_0003));
        assert_eq!(image.logical(3, true), Some(0x2_0002));
        assert_eq!(image.logical(3, false), Some(0x2_0006));
        assert_eq!(image.logical(1, false), Some(0x1_0004));
        assert_eq!(
            (image.logical(2, true), image.logical(9, true)),
            (None, None)
        );
        let large = [need(0, 1300, 1, true)];
        assert_eq!(Image::new(&large).unwrap_err(), TooLarge { bytes: 1301 });
    }

    #[test]
    fn mailbox_fits_beside_clock_and_census_without_image() {
        let whole = FrameWriter::LEN_MAX - FrameHeader::LEN - 12;
        assert_eq!(Image::default().mailbox_capacity(), whole);
        let without = Image::new(&[need(0, 0, 0, true)]).unwrap();
        assert_eq!(without.mailbox_capacity(), whole - 20 - 14);
        let with = Image::new(&[need(0, 5, 5, true)]).unwrap();
        assert_eq!(with.mailbox_capacity(), whole - 20 - 14 - 22);
    }

    #[test]
    fn inputs_are_taken_with_the_right_working_counter_only() {
        let mut image = Image::new(&[need(0, 1, 1, true), need(0, 1, 1, true)]).unwrap();
        let receive = |image: &mut Image, counter| {
            image.groups[0].counter = 0;
            image.groups[0].parts = 0;
            assert!(image.receive(0, Command::Lrw, &[0, 0, 7, 8], counter));
        };
        receive(&mut image, 3);
        assert!(!image.settle(0, |_, _| (3, 3)), "one of two is missing");
        assert_eq!(
            (image.inputs(0), image.groups[0].misses),
            ((&[0][..], u32::MAX), 1)
        );
        // Known to be lost: the other one continues.
        let all = image.settle(0, |slave, _| if slave == 0 { (3, 3) } else { (0, 3) });
        assert!(!all);
        assert_eq!(
            (image.inputs(0), image.inputs(1).0),
            ((&[7][..], 0), &[0][..])
        );
        // It is returning and may answer or not.
        receive(&mut image, 6);
        assert!(image.settle(0, |slave, _| if slave == 0 { (3, 3) } else { (0, 3) }));
        assert_eq!(image.inputs(1).0, [8]);
    }

    #[test]
    fn without_lrw_a_group_has_two_datagrams() {
        let mut image = Image::new(&[need(0, 1, 1, false)]).unwrap();
        assert!(!image.receive(0, Command::Lwr, &[0], 1));
        assert!(image.receive(0, Command::Lrd, &[9], 1));
        assert!(image.settle(0, |_, _| (2, 2)));
        assert_eq!(image.inputs(0).0, [9]);
    }
}
