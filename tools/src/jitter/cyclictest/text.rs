//! The histogram that `cyclictest -h` prints: a row for each microsecond with a column for each thread,
//! and lines with `#` around it.
//!
//! Its live lines and what other programs wrote around it are passed over; rows are not.

use anyhow::Context as _;

use super::{Output, THREADS_MAX, Thread};

/// Reads it. Its times are taken to be us: the text does not name the unit, and `-N` is rare.
pub(super) fn read(text: &str) -> anyhow::Result<Output> {
    let figures = |name: &str| figures(text, name);
    let min = figures("# Min Latencies:")?;
    let (max, mean) = (figures("# Max Latencies:")?, figures("# Avg Latencies:")?);
    let beyond = figures("# Histogram Overflows:")?;
    let count = min.len();
    anyhow::ensure!((1..=THREADS_MAX).contains(&count), "it holds no thread");
    anyhow::ensure!(
        max.len() == count && mean.len() == count && beyond.len() >= count,
        "its totals have columns for different numbers of threads"
    );
    let rows = rows(text, count)?;
    let (mut threads, mut all_beyond) = (Vec::new(), 0);
    for column in 0..count {
        let counts = rows
            .iter()
            .map(|(time, counts)| (*time, counts.get(column).copied().unwrap_or(0)));
        let counts: Vec<_> = counts.filter(|(_, count)| *count > 0).collect();
        let counted: u128 = counts.iter().map(|(_, count)| u128::from(*count)).sum();
        let cycles = u64::try_from(counted + u128::from(beyond[column]));
        let thread = Thread {
            counts,
            cycles: cycles.context("more cycles than can be counted")?,
            min: min[column],
            mean_ns: mean[column].saturating_mul(1000),
            max: max[column],
        };
        let read = thread.report(None, 1000);
        let (thread, more) = read.with_context(|| format!("thread {column}"))?;
        threads.push(thread);
        all_beyond += more;
    }
    Ok(Output {
        version: String::new(),
        period: None,
        priority: None,
        threads,
        beyond: all_beyond,
    })
}

/// The numbers of a line that begins so.
fn figures(text: &str, name: &str) -> anyhow::Result<Vec<u64>> {
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    let line =
        line.with_context(|| format!("no line `{name}`: no output of cyclictest -h or --json"))?;
    let figures: Result<Vec<_>, _> = line.split_whitespace().map(str::parse).collect();
    figures.with_context(|| format!("the line `{name}` holds more than numbers"))
}

/// Time and counts, for all threads and perhaps their sum (`-H`).
fn rows(text: &str, threads: usize) -> anyhow::Result<Vec<(u64, Vec<u64>)>> {
    let is_row = |line: &&str| line.starts_with(|c: char| c.is_ascii_digit());
    let mut rows = Vec::new();
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| is_row(line)) {
        let row: Result<Vec<u64>, _> = line.split_whitespace().map(str::parse).collect();
        let wrong = || format!("line {number} is no row of {threads} threads: `{line}`");
        let row = row.ok().with_context(wrong)?;
        let (time, counts) = row.split_first().with_context(wrong)?;
        let columns = counts.len();
        anyhow::ensure!(columns == threads || columns == threads + 1, wrong());
        let ascends = rows.last().is_none_or(|(last, _)| last < time);
        anyhow::ensure!(ascends, "line {number}: times do not ascend");
        rows.push((*time, counts.to_vec()));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# /dev/cpu_dma_latency set to 0us\n\
        T: 0 ( 1234) P:80 I:1000 C:  10 Min: 14 Act: 15 Avg: 16 Max: 26\n\
        # Histogram\n\
        000000 000000\t000000\n\
        000014 000009\t000001\n\
        000026 000001\t000003\n\
        # Total: 000000010 000000004\n\
        # Min Latencies: 00014 00014\n\
        # Avg Latencies: 00015 00024\n\
        # Max Latencies: 00026 00323\n\
        # Histogram Overflows: 00000 00001\n\
        # Histogram Overflow at cycle number:\n\
        # Thread 0:\n\
        # Thread 1: 00003\n";

    #[test]
    fn a_column_for_each_thread() {
        let output = read(TEXT).unwrap();
        let cycles: Vec<_> = output.threads.iter().map(|thread| thread.cycles).collect();
        assert_eq!((cycles, output.beyond), (vec![10, 5], 1));
        assert_eq!(output.threads[0].latency_ns.quantile(0.5), 14_555);
        assert_eq!(output.threads[1].latency_ns.max_ns(), 323_000);
        // With -H there is a column for all threads together.
        let summed = TEXT.replace("000009\t000001", "000009\t000001\t000010");
        assert_eq!(read(&summed).unwrap(), output);
    }

    #[test]
    fn cyclictest_text_of_other_form_is_refused() {
        for (from, to) in [
            ("000009\t000001", "000009"),
            ("000009\t000001", "000009\tx"),
            ("000009\t000001", "000009\t-1"),
            ("000026 000001", "000013 000001"),
            ("# Max Latencies: 00026 00323", "# Max Latencies: 00026"),
            ("# Min Latencies: 00014", "# Min Latencies: 0001x"),
            ("# Avg Latencies", "# Latencies"),
            ("# Min Latencies: 00014 00014", "# Min Latencies:"),
            ("000014 000009", "000014 99999999999999999999"),
        ] {
            assert!(TEXT.contains(from));
            assert!(read(&TEXT.replace(from, to)).is_err(), "{to}");
        }
        assert!(read("").is_err());
    }
}
