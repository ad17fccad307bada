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
}

impl Recording {
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        let name = path.display().to_string();
        let file = File::open(path).with_context(|| format!("cannot open {name}"))?;
        let reader = Reader::new(file).with_context(|| {
            format!("cannot read {name}; `tcpdump -i any -w FILE udp` writes one")
        })?;
        Ok(Self { name, reader })
    }

    pub(super) fn next(&mut self) -> anyhow::Result<Option<Datagram>> {
        let next = self.reader.next().transpose();
        let next = next.with_context(|| format!("cannot read {}", self.name))?;
        if let (None, Some(cut)) = (&next, self.reader.cut()) {
            complain(&format!("note: {}: {cut}", self.name));
        }
        Ok(next)
    }
}
