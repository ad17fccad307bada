//! An input or output of a device, as `io:3` names it. Whether the device exists is not known here.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

/// Longest name of a device, bytes.
const NAME_MAX: usize = 64;

/// An input or output of a device.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(try_from = "String")]
pub struct Channel {
    /// The device.
    pub device: String,
    /// Which one of its kind and direction, from 0.
    pub port: u16,
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.device, self.port)
    }
}

impl FromStr for Channel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.rsplit_once(':');
        let parts = parts.and_then(|(device, port)| Some((device, port.parse().ok()?)));
        let channel = parts.filter(|(device, _)| is_device(device) && device.len() <= NAME_MAX);
        let (device, port) = channel.ok_or_else(|| {
            let shown: String = text.chars().take(80).collect();
            format!(
                "`{}` is not DEVICE:PORT, such as io:3",
                shown.escape_debug()
            )
        })?;
        let device = device.to_owned();
        Ok(Self { device, port })
    }
}

impl TryFrom<String> for Channel {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Whether a text can be the name of a device, or of a variable in a net.
pub(crate) fn is_device(name: &str) -> bool {
    let is_name = |c: char| c.is_alphanumeric() || "_-.[]".contains(c);
    !name.is_empty() && name.chars().all(is_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channel_text_is_read_or_refused() {
        let channel: Channel = "io:3".parse().unwrap();
        assert_eq!((channel.device.as_str(), channel.port), ("io", 3));
        assert_eq!(channel.to_string(), "io:3");
        for wrong in ["io", "io:", ":3", "io:-1", "io:65536", "a b:1", "a':1"] {
            let why = wrong.parse::<Channel>().unwrap_err();
            assert!(why.contains("is not DEVICE:PORT"), "{wrong}: {why}");
        }
    }
}
