//! Named drive quirks for the master: cells and tools configure them with the same names. What each one changes is up
//! to the master; emulated drives have their own set of quirks.

use std::str::FromStr;

use crate::MasterOptions;

/// A deviation of a drive from CiA 402.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quirk {
    /// Bit 12 of 6041h stays low although a cyclic mode follows its target.
    NoFollowBit,
    /// 6041h is 0020h in Switch on disabled, as an old sample stack shows it.
    SodAs0020,
    /// 6061h shows the mode commanded by 6060h only in Operation enabled.
    ModeAfterEnable,
}

impl Quirk {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::NoFollowBit, Self::SodAs0020, Self::ModeAfterEnable];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoFollowBit => "no_follow_bit",
            Self::SodAs0020 => "sod_as_0020",
            Self::ModeAfterEnable => "mode_after_enable",
        }
    }
}

/// An unknown quirk name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no quirk `{0}`; quirks are no_follow_bit (bit 12 of 6041h stays low in cyclic modes), sod_as_0020 (6041h is \
     0020h in Switch on disabled) and mode_after_enable (6061h follows 6060h only when enabled)"
)]
pub struct UnknownQuirk(String);

impl FromStr for Quirk {
    type Err = UnknownQuirk;

    fn from_str(name: &str) -> Result<Self, UnknownQuirk> {
        let found = Self::ALL.into_iter().find(|quirk| quirk.name() == name);
        found.ok_or_else(|| UnknownQuirk(name.to_owned()))
    }
}

impl MasterOptions {
    /// These settings plus those for the given quirks.
    #[must_use]
    pub fn with_quirks(mut self, quirks: &[Quirk]) -> Self {
        for quirk in quirks {
            match quirk {
                Quirk::NoFollowBit => self.no_follow_bit = true,
                Quirk::SodAs0020 => self.sod_as_0020 = true,
                Quirk::ModeAfterEnable => self.mode_after_enable = true,
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quirk_names_are_read_back() {
        for quirk in Quirk::ALL {
            assert_eq!(quirk.name().parse(), Ok(quirk));
            let options = MasterOptions::default().with_quirks(&[quirk]);
            assert_ne!(options, MasterOptions::default());
        }
        let error = "bit12".parse::<Quirk>().unwrap_err().to_string();
        assert!(error.starts_with("there is no quirk `bit12`; quirks are"));
        for quirk in Quirk::ALL {
            assert!(error.contains(quirk.name()), "{error}");
        }
    }
}
