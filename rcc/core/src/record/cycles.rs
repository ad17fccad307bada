//! The words of cycles in a file. Most are the same as in the cycle before, so that a message has only those that changed; the first
//! cycle of a file, and each whose number of words differs from the one before it, is there as a whole.
//!
//! A message is a sequence of words: the number of words of its cycle, with [`WHOLE`] if all of them follow; the number of the cycle
//! in the file, from 0; then all words, or one bit for each word that changed (bit 0 of the first is the first word) and these.

/// Maximum number of words of one cycle.
pub(super) const WORDS_A_CYCLE: usize = 16_384;
/// In the first word of a message that has all words of its cycle.
const WHOLE: u64 = 1 << 63;
/// Words of the cycle for each word of bits.
const BITS: usize = 64;

/// Makes the messages of one file.
#[derive(Debug, Default)]
pub(super) struct Encoder {
    last: Vec<u64>,
    number: u64,
    message: Vec<u64>,
}

impl Encoder {
    /// The message of the next cycle.
    pub(super) fn encode(&mut self, words: &[u64]) -> &[u64] {
        self.message.clear();
        let count = words.len() as u64;
        if self.number > 0 && self.last.len() == words.len() {
            self.message.extend([count, self.number]);
            let bits = self.message.len();
            self.message.resize(bits + words.len().div_ceil(BITS), 0);
            let pairs = words.chunks(BITS).zip(self.last.chunks_mut(BITS));
            // Most are the same: compared as a whole, that takes almost no time.
            for (part, (words, last)) in
                pairs.enumerate().filter(|(_, (words, last))| words != last)
            {
                let (mut changed, mut end) = (0, self.message.len());
                // Each is written, and the place of one that is the same is used again: a branch for each would take longer.
                self.message.resize(end + words.len(), 0);
                for (bit, (word, last)) in words.iter().zip(last).enumerate() {
                    let differs = *word != *last;
                    changed |= u64::from(differs) << bit;
                    *last = *word;
                    if let Some(to) = self.message.get_mut(end) {
                        *to = *word;
                    }
                    end += usize::from(differs);
                }
                self.message.truncate(end);
                if let Some(to) = self.message.get_mut(bits + part) {
                    *to = changed;
                }
            }
        } else {
            self.message.extend([count | WHOLE, self.number]);
            self.message.extend_from_slice(words);
            self.last.clear();
            self.last.extend_from_slice(words);
        }
        self.number += 1;
        &self.message
    }
}

/// Reads the messages of one file in order.
#[derive(Debug, Default)]
struct Decoder {
    words: Vec<u64>,
    number: u64,
}

impl Decoder {
    /// The words of the next cycle.
    fn decode(&mut self, message: &[u64]) -> Result<&[u64], &'static str> {
        let [head, number, rest @ ..] = message else {
            return Err("a cycle is cut off");
        };
        if *number != self.number {
            return Err("cycles are missing before another");
        }
        let count = usize::try_from(head & !WHOLE).unwrap_or(usize::MAX);
        if count > WORDS_A_CYCLE {
            return Err("a cycle is too long");
        }
        if head & WHOLE != 0 {
            if rest.len() != count {
                return Err("a cycle is cut off");
            }
            self.words.clear();
            self.words.extend_from_slice(rest);
        } else {
            if *number == 0 || count != self.words.len() {
                return Err("a cycle changes words that the one before it does not have");
            }
            let parts = rest.split_at_checked(count.div_ceil(BITS));
            let (bits, changed) = parts.ok_or("a cycle is cut off")?;
            let mut changed = changed.iter();
            for (words, bits) in self.words.chunks_mut(BITS).zip(bits) {
                let mut left = *bits;
                for word in words {
                    if left & 1 != 0 {
                        *word = *changed.next().ok_or("a cycle is cut off")?;
                    }
                    left >>= 1;
                }
                if left != 0 {
                    return Err("a cycle changes words beyond its last");
                }
            }
            if changed.next().is_some() {
                return Err("a cycle has more words than it says");
            }
        }
        self.number += 1;
        Ok(&self.words)
    }
}

/// The cycles of a file, as they are in it: unpacked they would take ten times as much.
#[derive(Debug, Default)]
pub(super) struct Cycles {
    messages: Vec<Vec<u64>>,
    decoder: Decoder,
}

impl Cycles {
    pub(super) const fn is_empty(&self) -> bool {
        self.messages.is_empty()
    }

    /// Adds the next message of the file.
    pub(super) fn push(&mut self, message: Vec<u64>) -> Result<(), &'static str> {
        self.decoder.decode(&message)?;
        self.messages.push(message);
        Ok(())
    }

    /// The words of each cycle.
    pub(super) fn iter(&self) -> impl Iterator<Item = Vec<u64>> {
        let mut decoder = Decoder::default();
        // All of them were decoded when they were added.
        let decode = move |message: &Vec<u64>| decoder.decode(message).ok().map(<[u64]>::to_vec);
        self.messages.iter().map_while(decode)
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    fn messages(cycles: &[Vec<u64>]) -> Vec<Vec<u64>> {
        let mut encoder = Encoder::default();
        let message = |words: &Vec<u64>| encoder.encode(words).to_vec();
        cycles.iter().map(message).collect()
    }

    fn read(messages: &[Vec<u64>]) -> Result<Vec<Vec<u64>>, &'static str> {
        let mut cycles = Cycles::default();
        for message in messages {
            cycles.push(message.clone())?;
        }
        Ok(cycles.iter().collect())
    }

    proptest! {
        #[test]
        fn cycles_are_read_as_written(cycles in vec(vec(0..3_u64, 60..70), 0..20)) {
            prop_assert_eq!(read(&messages(&cycles)), Ok(cycles));
        }

        #[test]
        fn any_messages_are_read_or_rejected(messages in vec(vec(0..70_u64, 0..8), 0..5)) {
            let _ = read(&messages);
        }
    }

    #[test]
    fn unchanged_cycle_takes_bits_only() {
        let cycles = [vec![7; 640], vec![7; 640], vec![7; 639], vec![7; 639]];
        let lengths: Vec<_> = messages(&cycles).iter().map(Vec::len).collect();
        assert_eq!(lengths, [642, 12, 641, 12]);
    }

    #[test]
    fn damaged_cycles_are_named() {
        let whole = vec![2 | WHOLE, 0, 5, 6];
        for (second, why) in [
            (vec![2], "a cycle is cut off"),
            (vec![2, 2, 0], "cycles are missing before another"),
            (vec![1 << 40, 1], "a cycle is too long"),
            (vec![2 | WHOLE, 1, 5], "a cycle is cut off"),
            (
                vec![3, 1, 0],
                "a cycle changes words that the one before it does not have",
            ),
            (vec![2, 1], "a cycle is cut off"),
            (vec![2, 1, 0b10], "a cycle is cut off"),
            (
                vec![2, 1, 0b100, 9],
                "a cycle changes words beyond its last",
            ),
            (vec![2, 1, 0b1, 9, 9], "a cycle has more words than it says"),
        ] {
            assert_eq!(
                read(&[whole.clone(), second.clone()]),
                Err(why),
                "{second:?}"
            );
        }
        let changes = vec![2, 0, 0];
        assert!(read(&[changes]).is_err(), "the first has to be whole");
        let second = vec![2, 1, 0b10, 9];
        assert_eq!(read(&[whole, second]), Ok(vec![vec![5, 6], vec![5, 9]]));
    }
}
