//! The model of an arm's kinematics as it travels: the name of one that Takt knows, or the chain of joints itself, so that a
//! controller, its recordings and its clients compute the same numbers without the file that it was read from. The text of a
//! chain has every number in its shortest exact form.

mod text;

use std::borrow::Cow;
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, de};
use takt_net::JointLimits;
use takt_net::device::Kinematics;

use crate::kinematics::{self, Range};
use crate::urdf::{ArmModel, FileError, read_arm};

pub use text::TextError;

/// What the name of a model from a URDF begins with.
pub const URDF: &str = "urdf:";

/// A model of an arm's kinematics; by default none.
#[derive(Clone, Debug, Default)]
pub struct Model {
    name: Cow<'static, str>,
    arm: Option<Arc<ArmModel>>,
}

impl Model {
    /// The chain of an arm from a URDF.
    #[must_use]
    pub fn of_arm(arm: ArmModel) -> Self {
        let name = Cow::Owned(format!("{URDF}{}", arm.name));
        let arm = Some(Arc::new(arm));
        Self { name, arm }
    }

    /// The same model; if it is the name of a URDF, `urdf:` and its path, the arm of that file. Relative paths are in `folder`.
    ///
    /// # Errors
    /// If the file cannot be read, or describes no arm that can be used.
    pub fn read(self, folder: &Path) -> Result<Self, FileError> {
        let path = self.name.strip_prefix(URDF).filter(|_| self.arm.is_none());
        match path.map(|path| read_arm(&folder.join(path), None, None)) {
            Some(arm) => arm.map(Self::of_arm),
            None => Ok(self),
        }
    }

    /// Its name, such as `kuka_lwr4` or `urdf:ur5e`; empty for none.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether there is no model.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.name.is_empty()
    }

    /// The arm of a URDF; `None` for a model that is known by its name.
    #[must_use]
    pub fn arm(&self) -> Option<&ArmModel> {
        self.arm.as_deref()
    }

    /// Its kinematics within the ranges that it has by itself; `None` if it has no such name or is none.
    #[must_use]
    pub fn unlimited(&self) -> Option<Arc<dyn Kinematics>> {
        match &self.arm {
            Some(arm) => Some(Arc::new(arm.serial.clone())),
            None => kinematics::named(&self.name),
        }
    }

    /// Its kinematics with the joint limits of a particular arm; `None` also if the number of limits is not that of its joints.
    #[must_use]
    pub fn limited(&self, limits: &[JointLimits]) -> Option<Arc<dyn Kinematics>> {
        let Some(arm) = &self.arm else {
            return kinematics::limited(&self.name, limits);
        };
        let ranges: Vec<_> = limits.iter().copied().map(Range::from).collect();
        Some(Arc::new(arm.serial.clone().within(&ranges)?))
    }

    /// The same model without what it looks like, and so without paths of files.
    #[must_use]
    pub fn without_solids(mut self) -> Self {
        if let Some(arm) = &mut self.arm {
            Arc::make_mut(arm).visuals.clear();
        }
        self
    }

    /// Its name or its chain, by which [`str::parse`] makes the same model again; without what it looks like.
    #[must_use]
    pub fn text(&self) -> Cow<'_, str> {
        match &self.arm {
            Some(arm) => Cow::Owned(text::write(arm, false)),
            None => Cow::Borrowed(&self.name),
        }
    }

    /// As [`Self::text`], with what it looks like and the paths of its meshes: for this host only.
    #[must_use]
    pub fn full_text(&self) -> Cow<'_, str> {
        match &self.arm {
            Some(arm) => Cow::Owned(text::write(arm, true)),
            None => Cow::Borrowed(&self.name),
        }
    }
}

impl FromStr for Model {
    type Err = TextError;

    /// From a text; a name need not be known.
    fn from_str(text: &str) -> Result<Self, TextError> {
        if text::is_chain(text) {
            return Ok(Self::of_arm(text::read(text)?));
        }
        Ok(Self::from(text.to_owned()))
    }
}

impl From<&'static str> for Model {
    fn from(name: &'static str) -> Self {
        let name = Cow::Borrowed(name);
        Self { name, arm: None }
    }
}

impl From<String> for Model {
    /// The model of that name.
    fn from(name: String) -> Self {
        let name = Cow::Owned(name);
        Self { name, arm: None }
    }
}

impl<'de> Deserialize<'de> for Model {
    /// From its name or its chain.
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = Cow::<'de, str>::deserialize(from)?;
        text.parse().map_err(de::Error::custom)
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl PartialEq for Model {
    fn eq(&self, other: &Self) -> bool {
        self.full_text() == other.full_text()
    }
}

impl PartialEq<&str> for Model {
    /// Whether it has that name.
    fn eq(&self, name: &&str) -> bool {
        self.name == *name
    }
}

#[cfg(test)]
mod tests;
