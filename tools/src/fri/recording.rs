//! A recording of datagrams as a file. It judges none of them.

use std::fs::File;
use std::path::Path;

use anyhow::Context as _;
use takt_fri::capture::{Datagram, Reader};

use crate::output::complain;

/// The datagrams of a recording, one by one.
pub(super) struct Recording {
    name: String,
    reader: Reader<File>,
    /// Whether a datagram was read.
    has_begun: bool,
}

impl Recording {
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        let name = path.display().to_string();
        let file = File::open(path).with_context(|| format!("cannot open {name}"))?;
        let reader = Reader::new(file).with_context(|| {
            format!("cannot read {name}; `tcpdump -i any -w FILE udp` writes one")
        })?;
        Ok(Self {
            name,
            reader,
            has_begun: false,
        })
    }

    /// The next datagram; `None` at the end, which is where the file is cut or damaged.
    pub(super) fn next(&mut self) -> anyhow::Result<Option<Datagram>> {
        let next = match self.reader.next().transpose() {
            Ok(next) => next,
            Err(error) if self.has_begun => {
                complain(&format!("note: {}: {error}; read up to there", self.name));
                return Ok(None);
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", self.name));
            }
        };
        self.has_begun |= next.is_some();
        if let (None, Some(cut)) = (&next, self.reader.cut()) {
            complain(&format!("note: {}: {cut}", self.name));
        }
        Ok(next)
    }

    /// Packets that hold no whole UDP datagram.
    pub(super) const fn skipped(&self) -> u64 {
        self.reader.skipped()
    }
}
