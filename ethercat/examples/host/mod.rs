//! Host settings of measuring examples. They continue if the host refuses.

use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};

/// Keeps processors out of deep sleep as long as it is open.
pub(crate) fn awake() -> io::Result<File> {
    let mut file = OpenOptions::new()
        .write(true)
        .open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}
