//! Reading of files of unknown size: each reader passes a maximum, and a longer or
//! endless file, such as a device, is an error instead of exhausting memory. It does not interpret the content.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Maximum bytes of a configuration, a cost table or a data sheet.
pub const TEXT_BYTES_MAX: u64 = 16 << 20;

/// Maximum bytes of a recording or capture that is read as a whole.
pub const RECORDING_BYTES_MAX: u64 = 4 << 30;

/// Maximum bytes of a special file, such as a pipe or a device, whose size is not known in advance.
const STREAM_BYTES_MAX: u64 = 64 << 20;

/// Reads a whole file of at most `most` bytes.
///
/// # Errors
/// If it cannot be read, is longer, or does not fit into memory.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let found = file.metadata()?;
    if found.is_file() {
        if found.len() > most {
            return Err(too_long(most));
        }
        return bytes_of(file, most);
    }
    bytes_of(file, most.min(STREAM_BYTES_MAX))
}

/// Reads a whole text of at most `most` bytes.
///
/// # Errors
/// If it cannot be read, is longer, is not UTF-8, or does not fit into memory.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    text(read(path, most)?)
}

/// Reads a stream of at most `most` bytes as text.
///
/// # Errors
/// If it cannot be read, is longer, is not UTF-8, or does not fit into memory.
pub fn text_of(from: impl Read, most: u64) -> io::Result<String> {
    text(bytes_of(from, most)?)
}

fn bytes_of(from: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    // Memory is reserved step by step, and a lack of memory is an error.
    from.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(too_long(most));
    }
    Ok(bytes)
}

fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8 text"))
}

fn too_long(most: u64) -> io::Error {
    let text = format!(
        "it has more than {most} bytes, the most that is read\nhint: is it the right file?"
    );
    io::Error::new(io::ErrorKind::FileTooLarge, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_file_ends_with_the_bound() {
        let error = read(Path::new("/dev/zero"), 1000).unwrap_err();
        assert!(
            error.to_string().contains("more than 1000 bytes"),
            "{error}"
        );
        let error = crate::CellConfig::read(Path::new("/dev/zero"), &[]).unwrap_err();
        assert!(error.to_string().contains("more than"), "{error}");
        let error = crate::record::replay(Path::new("/dev/zero"));
        let error = error.err().map(|error| error.to_string());
        assert!(error.is_some_and(|e| e.contains("more than")));
    }

    #[test]
    fn file_at_its_bound_is_read() {
        let path = std::env::temp_dir().join(format!("takt-files-{}", std::process::id()));
        std::fs::write(&path, "abcd").unwrap();
        assert_eq!(read_text(&path, 4).unwrap(), "abcd");
        let error = read(&path, 3).unwrap_err();
        std::fs::write(&path, [0xff]).unwrap();
        let no_text = read_text(&path, 3).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        assert!(no_text.to_string().contains("not UTF-8"), "{no_text}");
        assert_eq!(text_of(&b"abc"[..], 3).unwrap(), "abc");
        assert!(text_of(io::repeat(b'a'), 3).is_err());
    }
}
