//! The load beside a measurement: processes that keep processors, memory, files and pipes busy. Threads of the
//! measuring process would share its page tables, which other programs do not share with a controller.
//!
//! It uses no network and no device, so it does not replace the load of the real application.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, Write as _};
use std::process::{Child, Command, Stdio};

use anyhow::Context as _;

/// Memory that a worker copies to and fro, bytes: more than the second level cache of one processor.
const MEMORY: usize = 16 << 20;
/// What a worker writes to its file before it begins again, bytes.
const FILE: usize = 16 << 20;
/// What is written to file or pipe at once, bytes.
const PIECE: usize = 32 << 10;
/// Pieces of each kind per turn.
const PIECES: usize = 8;

/// Running workers. They end when this is dropped, and also if this process is killed: their
/// standard input ends with it.
#[derive(Debug)]
pub(crate) struct Load {
    workers: Vec<Child>,
}

impl Load {
    /// Starts that many.
    pub(crate) fn start(workers: u32) -> anyhow::Result<Self> {
        let mut load = Self { workers: vec![] };
        for _ in 0..workers {
            let this = std::env::current_exe().context("cannot find my own program")?;
            let worker = Command::new(this)
                .args(["jitter", "--load-worker"])
                .stdin(Stdio::piped())
                .stdout(Stdio::null())
                .spawn();
            load.workers
                .push(worker.context("cannot start a load worker")?);
        }
        Ok(load)
    }

    /// Whether every worker still works.
    pub(crate) fn is_whole(&mut self) -> bool {
        self.workers
            .iter_mut()
            .all(|worker| matches!(worker.try_wait(), Ok(None)))
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            // It may have ended already.
            let _ = worker.kill();
            let _ = worker.wait();
        }
    }
}

/// Runs a worker process until its standard input ends.
pub(crate) fn work() -> anyhow::Result<()> {
    let worker = std::thread::spawn(|| -> io::Result<()> {
        let mut turn = Turn::new()?;
        loop {
            turn.memory();
            turn.file()?;
            turn.pipe()?;
        }
    });
    let (ended, parent) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        // Nothing is written there: the end of the input means that the parent has ended.
        let _ = io::stdin().read(&mut [0; 1]);
        ended.send(())
    });
    loop {
        if parent
            .recv_timeout(std::time::Duration::from_millis(500))
            .is_ok()
        {
            return Ok(());
        }
        if worker.is_finished() {
            let result = worker.join();
            let result = result.unwrap_or_else(|_| Err(io::Error::other("panicked")));
            return result.context("load worker");
        }
    }
}

/// The work of a worker, in turns.
struct Turn {
    memory: Vec<u64>,
    piece: Vec<u8>,
    file: File,
    written: usize,
    pipe: (io::PipeReader, io::PipeWriter),
}

impl Turn {
    fn new() -> io::Result<Self> {
        let name = format!("takt-load-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let file = File::create_new(&path)?;
        // Unlinked at once, so the file is deleted when this process ends.
        std::fs::remove_file(path)?;
        Ok(Self {
            memory: (0..(MEMORY / 8) as u64).collect(),
            piece: vec![0x5a; PIECE],
            file,
            written: 0,
            pipe: io::pipe()?,
        })
    }

    /// Copies memory and computes a little.
    fn memory(&mut self) {
        let half = self.memory.len() / 2;
        let (one, other) = self.memory.split_at_mut(half);
        one.copy_from_slice(other);
        for (i, word) in (0..).zip(other.iter_mut()) {
            *word = word.rotate_left(7) ^ i;
        }
        std::hint::black_box(&mut self.memory);
    }

    fn file(&mut self) -> io::Result<()> {
        for _ in 0..PIECES {
            self.file.write_all(&self.piece)?;
            self.written += PIECE;
        }
        if self.written >= FILE {
            self.file.sync_data()?;
            self.file.rewind()?;
            self.written = 0;
        }
        Ok(())
    }

    /// Through the kernel and back; a piece fits into a pipe, so writing never waits.
    fn pipe(&mut self) -> io::Result<()> {
        for _ in 0..PIECES {
            self.pipe.1.write_all(&self.piece)?;
            self.pipe.0.read_exact(&mut self.piece)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_turn_stays_bounded() {
        let mut turn = Turn::new().unwrap();
        for _ in 0..=FILE / PIECE / PIECES {
            turn.file().unwrap();
        }
        turn.pipe().unwrap();
        let first = turn.memory[0];
        turn.memory();
        assert_ne!(first, turn.memory[0]);
        assert_eq!(turn.file.metadata().unwrap().len(), FILE as u64);
    }
}
