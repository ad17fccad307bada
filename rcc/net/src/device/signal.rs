//! Typed addresses in the image, where drivers report values and nets give commands, and the layout
//! of both in words. Which device has which of them is defined in [`super::interface`].

use std::fmt;
use std::marker::PhantomData;

use crate::cycle::Cycle;
use crate::device::{Image, Target};
use crate::value::Value;

/// A value that can be stored in the image: a port's value, or a record of several.
pub trait Words: Copy + fmt::Debug {
    /// Number of words.
    const LEN: usize;

    /// Writes it as [`Self::LEN`] words.
    fn put_words(self, word: impl FnMut(usize, u64));

    /// Reads it back from its words.
    fn take_words(word: impl Fn(usize) -> u64) -> Self;
}

impl<T: Value> Words for T {
    const LEN: usize = T::WORDS;

    fn put_words(self, word: impl FnMut(usize, u64)) {
        self.put(word);
    }

    fn take_words(word: impl Fn(usize) -> u64) -> Self {
        Self::take(word)
    }
}

impl Words for u64 {
    const LEN: usize = 1;

    fn put_words(self, mut word: impl FnMut(usize, u64)) {
        word(0, self);
    }

    fn take_words(word: impl Fn(usize) -> u64) -> Self {
        word(0)
    }
}

impl<T: Words> Words for Option<T> {
    const LEN: usize = 1 + T::LEN;

    fn put_words(self, mut word: impl FnMut(usize, u64)) {
        word(0, u64::from(self.is_some()));
        match self {
            Some(value) => value.put_words(|i, w| word(1 + i, w)),
            // Equal states are equal words.
            None => (1..Self::LEN).for_each(|i| word(i, 0)),
        }
    }

    fn take_words(word: impl Fn(usize) -> u64) -> Self {
        (word(0) != 0).then(|| T::take_words(|i| word(1 + i)))
    }
}

/// A struct whose fields are stored in the image one after the other.
macro_rules! record {
    ($(#[$meta:meta])* $name:ident { $($(#[$of_field:meta])* $field:ident: $type:ty,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name {
            $($(#[$of_field])* pub $field: $type,)+
        }

        impl $crate::device::Words for $name {
            const LEN: usize = 0 $(+ <$type as $crate::device::Words>::LEN)+;

            fn put_words(self, mut word: impl FnMut(usize, u64)) {
                let mut at = 0;
                $(
                    $crate::device::Words::put_words(self.$field, |i, w| word(at + i, w));
                    at += <$type as $crate::device::Words>::LEN;
                )+
                debug_assert_eq!(at, <Self as $crate::device::Words>::LEN);
            }

            fn take_words(word: impl Fn(usize) -> u64) -> Self {
                let mut at = 0;
                $(
                    let $field =
                        <$type as $crate::device::Words>::take_words(|i| word(at + i));
                    at += <$type as $crate::device::Words>::LEN;
                )+
                debug_assert_eq!(at, <Self as $crate::device::Words>::LEN);
                Self { $($field),+ }
            }
        }
    };
}
pub(super) use record;

/// The address of a value that a driver reports; null while the driver does not know it.
#[derive(Clone, Copy, Debug)]
pub struct Signal<T>(usize, PhantomData<fn() -> T>);

impl<T: Words> Signal<T> {
    /// The value as nets see it in this cycle.
    pub fn get(self, image: &Image) -> Option<T> {
        Option::take_words(|i| image.signals[self.0 + i].get())
    }

    /// The value in words with the same layout.
    pub fn read(self, words: &[u64]) -> Option<T> {
        Option::take_words(|i| words.get(self.0 + i).copied().unwrap_or(0))
    }

    /// Reports a value in words with the same layout.
    pub fn report(self, words: &mut [u64], value: Option<T>) {
        value.put_words(|i, word| {
            if let Some(slot) = words.get_mut(self.0 + i) {
                *slot = word;
            }
        });
    }
}

/// The address of a command. The value stays there when its net has ended; its stamp shows whether
/// it is in force, see [`Given`].
#[derive(Clone, Copy, Debug)]
pub struct Command<T>(usize, PhantomData<fn() -> T>);

/// Words before the value of a command: the cycle in which a primitive last held it, the cycle in
/// which it was given, and the number of cycles until the next one.
const STAMP: usize = 3;
/// The last of them.
pub(super) const EVERY: usize = 2;

/// A command as its driver sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given<T> {
    /// The cycle in which it was given, as in `Moment::cycle`; from 1.
    pub cycle: u64,
    /// Number of thread cycles until its net gives the next one; 0 once it is withdrawn.
    pub every: u64,
    /// The commanded value.
    pub value: T,
}

impl<T> Given<T> {
    /// Whether its net still commands it in this cycle: for commands that a net repeats as long as
    /// they hold.
    pub const fn is_in_force(&self, cycle: u64) -> bool {
        cycle.saturating_sub(self.cycle) < self.every
    }

    /// Whether its net has ended: for orders, which are given once. A motion that one started
    /// stops; one that has not begun does not begin.
    pub const fn is_withdrawn(&self) -> bool {
        self.every == 0
    }
}

/// Whether the command with first word `at` in copied words is in force in `cycle`.
pub fn is_in_force(words: &[u64], at: usize, cycle: u64) -> bool {
    let word = |i: usize| words.get(at + i).copied().unwrap_or(0);
    cycle.saturating_sub(word(1)) < word(EVERY)
}

/// Withdraws the command with first word `at` in copied words.
pub fn withhold(words: &mut [u64], at: usize) {
    if let Some(every) = words.get_mut(at + EVERY) {
        *every = 0;
    }
}

impl<T: Words> Command<T> {
    /// Whether another primitive gives or holds it in this cycle.
    pub fn is_taken(self, cycle: &Cycle<'_>) -> bool {
        cycle.image.commands[self.0].get() == cycle.moment.cycle
    }

    /// Keeps other primitives from giving it in this cycle; the present command stays.
    pub fn hold(self, cycle: &Cycle<'_>) {
        cycle.image.commands[self.0].set(cycle.moment.cycle);
    }

    /// Gives it.
    pub fn give(self, cycle: &Cycle<'_>, value: T) {
        self.hold(cycle);
        let cells = &cycle.image.commands;
        cells[self.0 + 1].set(cycle.moment.cycle);
        cells[self.0 + EVERY].set(cycle.moment.every.max(1));
        cycle.image.owners[self.0].set(Some(cycle.moment.net));
        value.put_words(|i, word| cells[self.0 + STAMP + i].set(word));
    }

    /// What a net gave in the last cycle, or already in this one; `None` if none did.
    pub fn recent(self, cycle: &Cycle<'_>) -> Option<T> {
        let cells = &cycle.image.commands;
        let [given, every] = [1, EVERY].map(|word| cells[self.0 + word].get());
        let now = cycle.moment.cycle;
        let gap = every.max(cycle.moment.every).max(1) + cycle.image.skipped(now);
        let is_recent = given != 0 && given <= now && now - given <= gap;
        is_recent.then(|| T::take_words(|i| cells[self.0 + STAMP + i].get()))
    }

    /// Its address, for [`crate::Build::commands`].
    pub const fn target(self) -> Target {
        Target::Words(self.0)
    }

    /// The command in words with the same layout; `None` if it was never given.
    pub fn read(self, words: &[u64]) -> Option<Given<T>> {
        let word = |i: usize| words.get(self.0 + i).copied().unwrap_or(0);
        (word(1) != 0).then(|| Given {
            cycle: word(1),
            every: word(EVERY),
            value: T::take_words(|i| word(STAMP + i)),
        })
    }
}

/// Allocates addresses in the image, one after the other. For nets the layout begins at the
/// device's words, for drivers at 0: the same steps then give the same relative addresses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// The next free word of reported values.
    pub signals: usize,
    /// The next free word of commands.
    pub commands: usize,
}

impl Layout {
    /// Allocates a value that a driver reports.
    pub fn signal<T: Words>(&mut self) -> Signal<T> {
        let at = self.signals;
        self.signals += <Option<T> as Words>::LEN;
        Signal(at, PhantomData)
    }

    /// Allocates a command of nets.
    pub fn command<T: Words>(&mut self) -> Command<T> {
        let at = self.commands;
        self.commands += STAMP + T::LEN;
        Command(at, PhantomData)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Answer, JointImpedance, Tool};
    use crate::value::{Frame, Twist, Vector};

    #[test]
    fn signal_values_round_trip() {
        let mut layout = Layout::default();
        let (a, b) = (layout.signal::<Twist>(), layout.signal::<Answer>());
        let mut words = vec![0; layout.signals];
        assert_eq!((a.read(&words), b.read(&words)), (None, None));
        let twist = Twist {
            vel: Vector::new(1.0, 2.0, 3.0),
            rot: Vector::new(4.0, 5.0, f64::MIN_POSITIVE),
        };
        let answer = Answer {
            order: u64::MAX,
            error: -1,
        };
        a.report(&mut words, Some(twist));
        b.report(&mut words, Some(answer));
        assert_eq!(
            (a.read(&words), b.read(&words)),
            (Some(twist), Some(answer))
        );
        a.report(&mut words, None);
        assert_eq!((a.read(&words), b.read(&words)), (None, Some(answer)));
        assert!(words[..7].iter().all(|w| *w == 0), "{words:?}");
    }

    #[test]
    fn record_fields_do_not_overlap() {
        let tool = Tool {
            mass: 1.5,
            com: Frame::translation(0.1, 0.2, 0.3),
            moi: Vector::new(4.0, 5.0, 6.0),
            tcp: Frame::translation(0.7, 0.8, 0.9),
        };
        let mut words = [0; Tool::LEN];
        tool.put_words(|i, w| words[i] = w);
        assert_eq!(Tool::take_words(|i| words[i]), tool);
        let partly = JointImpedance {
            damping: Some(0.7),
            ..JointImpedance::default()
        };
        let mut words = [0; JointImpedance::LEN];
        partly.put_words(|i, w| words[i] = w);
        assert_eq!(JointImpedance::take_words(|i| words[i]), partly);
    }

    #[test]
    fn command_is_in_force_until_next_is_due() {
        let given = |every| Given {
            cycle: 8,
            every,
            value: 0,
        };
        assert!(given(1).is_in_force(8) && !given(1).is_in_force(9));
        assert!(given(4).is_in_force(11) && !given(4).is_in_force(12));
        assert!(!given(0).is_in_force(8) && given(0).is_withdrawn());
    }

    #[test]
    fn missing_words_are_null() {
        let mut layout = Layout::default();
        let (signal, command) = (layout.signal::<f64>(), layout.command::<f64>());
        signal.report(&mut [], Some(1.0));
        assert_eq!(signal.read(&[]), None);
        assert_eq!(command.read(&[]), None);
    }
}
