//! Seeded random inputs for the functions that fuzzers call: words of a format, or damaged files.
//! The properties that must hold for any input are defined with those functions.

#![expect(
    clippy::print_stdout,
    reason = "test support, which prints its results"
)]

use std::fmt::Write as _;
use std::time::Instant;

use takt_link::Random;

/// Longest input composed of bytes or words. Longer ones find no more and cost more.
const BYTES_MAX: usize = 600;
/// Bytes of a failing input that are printed.
const SHOWN_MAX: usize = 4_096;

/// Environment variable with the number of inputs (`cargo xtask fuzz --count`).
pub const COUNT: &str = "TAKT_FUZZ_COUNT";
/// Environment variable with the seed; another seed gives other inputs (`cargo xtask fuzz --seed`).
pub const SEED: &str = "TAKT_FUZZ_SEED";

/// Half of the inputs are bytes; the other half are words of the format, which get further,
/// with a few bytes replaced. Short ones are the most frequent, because they are the fastest.
fn of_words(random: &mut Random, words: &[&[u8]], input: &mut Vec<u8>) {
    input.clear();
    let longest = BYTES_MAX >> random.below(6);
    let len = random.below(longest);
    if words.is_empty() || random.next().is_multiple_of(2) {
        input.resize_with(len, || random.byte());
        return;
    }
    while input.len() < len {
        input.extend_from_slice(words[random.below(words.len())]);
    }
    damage(random, input);
}

/// A file with bytes replaced, removed or duplicated, or truncated.
fn of_files(random: &mut Random, files: &[&[u8]], input: &mut Vec<u8>) {
    input.clear();
    if files.is_empty() {
        return;
    }
    input.extend_from_slice(files[random.below(files.len())]);
    for _ in 0..=random.below(3) {
        let at = random.below(input.len());
        let end = (at + random.below(64)).min(input.len());
        match random.below(6) {
            0 => input.truncate(at),
            1 => drop(input.drain(at..end)),
            2 if input.len() < BYTES_MAX * 16 => input.extend_from_within(at..end),
            3 => {
                // Counts and lengths at their limits.
                let limits = [0, 1, 0x7F, 0x80, 0xFF];
                let limit = limits[random.below(limits.len())];
                let end = end.min(at + 4);
                input[at..end].fill(limit);
            }
            _ => damage(random, input),
        }
    }
}

fn damage(random: &mut Random, input: &mut [u8]) {
    for _ in 0..random.below(4) {
        let at = random.below(input.len());
        let byte = random.byte();
        if let Some(target) = input.get_mut(at) {
            *target = byte;
        }
    }
}

/// Shows the input with which a function panicked.
struct Shown<'a> {
    name: &'a str,
    turn: u64,
    input: Vec<u8>,
}

impl Drop for Shown<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let mut hex = String::new();
            for byte in self.input.iter().take(SHOWN_MAX) {
                let _ = write!(hex, "{byte:02x}");
            }
            let (name, turn) = (self.name, self.turn);
            println!("{name}: input {turn}, {} bytes: {hex}", self.input.len());
        }
    }
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Feeds a function with inputs from words of its format, `usual` of them unless [`COUNT`] is set,
/// and prints the rate.
pub fn feed(name: &str, target: impl FnMut(&[u8]), words: &[&[u8]], usual: u64) {
    run(name, target, usual, |random, input| {
        of_words(random, words, input);
    });
}

/// As [`feed`], with damaged files.
pub fn feed_files(name: &str, target: impl FnMut(&[u8]), files: &[&[u8]], usual: u64) {
    run(name, target, usual, |random, input| {
        of_files(random, files, input);
    });
}

fn run(
    name: &str,
    mut target: impl FnMut(&[u8]),
    usual: u64,
    mut make: impl FnMut(&mut Random, &mut Vec<u8>),
) {
    let count = number(COUNT).unwrap_or(usual);
    let mut random = Random::new(number(SEED).unwrap_or(0));
    let mut shown = Shown {
        name,
        turn: 0,
        input: Vec::new(),
    };
    let begin = Instant::now();
    for turn in 0..count {
        shown.turn = turn;
        make(&mut random, &mut shown.input);
        target(&shown.input);
    }
    let seconds = begin.elapsed().as_secs_f64();
    let rate = count as f64 / seconds.max(1e-9);
    println!("fuzzed {name}: {count} inputs in {seconds:.1} s, {rate:.0}/s");
}

/// The words of a text, split at spaces.
#[must_use]
pub fn words(text: &str) -> Vec<&[u8]> {
    let words = text.split(' ').filter(|word| !word.is_empty());
    words.map(str::as_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_reproduces_inputs() {
        let inputs = |seed| {
            let mut random = Random::new(seed);
            let mut made = Vec::new();
            for turn in 0..200 {
                let mut input = Vec::new();
                if turn % 2 == 0 {
                    of_words(&mut random, &[b"ab", b"c"], &mut input);
                } else {
                    of_files(&mut random, &[b"0123456789", b""], &mut input);
                }
                made.push(input);
            }
            made
        };
        assert_eq!(inputs(1), inputs(1));
        assert_ne!(inputs(1), inputs(2));
        assert!(inputs(1).iter().any(|input| input.len() > 10));
    }

    #[test]
    fn feed_uses_requested_count() {
        let mut seen = 0;
        feed("nothing", |_| seen += 1, &[], 37);
        assert_eq!(seen, number(COUNT).unwrap_or(37));
    }
}
