//! Which drivers a program has, and their tables in a cell file. The program that assembles the drivers supplies a list of
//! [`DriverKind`]; this module knows no bus and no robot.

use std::any::Any;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use serde::Deserialize as _;
use serde::de::{DeserializeOwned, Deserializer as _, IntoDeserializer as _, Visitor};
use toml::Spanned;
use toml::de::{DeTable, DeValue, Error, ValueDeserializer};

use crate::device::driver::DriverConfig;

/// A driver's table of a cell file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// `[[device]]` of this type: a robot with a driver of its own.
    Device(&'static str),
    /// `[[…]]` of this name: a bus with any number of devices.
    Bus(&'static str),
}

type Read = fn(ValueDeserializer<'_>) -> Result<Vec<Arc<dyn DriverConfig>>, Error>;

/// A driver that a cell file can configure.
#[derive(Clone, Copy, Debug)]
pub struct DriverKind {
    section: Section,
    /// How the table is read, or the cargo feature that the driver needs.
    read: Result<Read, &'static str>,
    configures: fn(&dyn DriverConfig) -> bool,
}

impl DriverKind {
    /// A driver whose table deserializes to `C`.
    #[must_use]
    pub const fn new<C: DriverConfig + DeserializeOwned>(section: Section) -> Self {
        let read: Read = match section {
            Section::Device(_) => |value| Ok(vec![Arc::new(C::deserialize(value)?)]),
            Section::Bus(_) => |value| {
                let all = Vec::<C>::deserialize(value)?.into_iter();
                Ok(all.map(|it| Arc::new(it) as _).collect())
            },
        };
        Self {
            section,
            read: Ok(read),
            configures: |config| (config as &dyn Any).is::<C>(),
        }
    }

    /// A driver that this program was built without; `feature` is the cargo feature that adds it.
    #[must_use]
    pub const fn without(section: Section, feature: &'static str) -> Self {
        Self {
            section,
            read: Err(feature),
            configures: |_| false,
        }
    }

    /// Its table.
    #[must_use]
    pub const fn section(&self) -> Section {
        self.section
    }

    /// Whether this program has the driver.
    #[must_use]
    pub const fn is_built(&self) -> bool {
        self.read.is_ok()
    }

    /// Whether this is a configuration of such a driver.
    #[must_use]
    pub fn configures(&self, config: &dyn DriverConfig) -> bool {
        (self.configures)(config)
    }

    fn read(&self, value: Spanned<DeValue<'_>>) -> Result<Vec<Arc<dyn DriverConfig>>, Error> {
        match self.read {
            Ok(read) => read(value.into_deserializer()),
            Err(feature) => Err(error_at(value.span(), &self.missing(feature))),
        }
    }

    fn missing(&self, feature: &str) -> String {
        let (Section::Device(name) | Section::Bus(name)) = self.section;
        format!(
            "this program was built without the driver of `{name}`\nhint: build it with the cargo feature `{feature}`"
        )
    }
}

/// Tables that are not those of drivers.
const OWN: [&str; 8] = [
    "controller",
    "live",
    "fleet",
    "frame",
    "base",
    "tool",
    "home",
    "object",
];

/// What drivers read of a cell file.
#[derive(Debug, Default)]
pub(super) struct Configured {
    pub(super) devices: Vec<Arc<dyn DriverConfig>>,
    pub(super) buses: Vec<Arc<dyn DriverConfig>>,
}

/// Takes the tables of drivers out of a cell file. What remains is the controller's.
pub(super) fn take(table: &mut DeTable<'_>, kinds: &[DriverKind]) -> Result<Configured, Error> {
    let mut configured = Configured::default();
    if let Some(devices) = table.remove("device") {
        let span = devices.span();
        let DeValue::Array(devices) = devices.into_inner() else {
            return Err(error_at(span, "expected tables `[[device]]`"));
        };
        for device in devices {
            configured.devices.extend(read_device(device, kinds)?);
        }
    }
    for kind in kinds {
        if let Section::Bus(name) = kind.section
            && let Some(buses) = table.remove(name)
        {
            configured.buses.extend(kind.read(buses)?);
        }
    }
    let unknown = table
        .keys()
        .find(|key| !OWN.contains(&key.get_ref().as_ref()));
    match unknown {
        None => Ok(configured),
        Some(key) => {
            let buses = kinds.iter().filter_map(|kind| match kind.section {
                Section::Bus(name) => Some(name),
                Section::Device(_) => None,
            });
            let known = one_of(OWN.into_iter().chain(["device"]).chain(buses));
            let text = format!("unknown field `{}`, expected {known}", key.get_ref());
            Err(error_at(key.span(), &text))
        }
    }
}

/// A device by the kind that its `type` names.
fn read_device(
    device: Spanned<DeValue<'_>>,
    kinds: &[DriverKind],
) -> Result<Vec<Arc<dyn DriverConfig>>, Error> {
    let span = device.span();
    let DeValue::Table(mut table) = device.into_inner() else {
        return Err(error_at(span, "expected a table `[[device]]`"));
    };
    let Some(kind) = table.remove("type") else {
        return Err(error_at(span, "missing field `type`"));
    };
    let Some(name) = kind.get_ref().as_str() else {
        return Err(error_at(kind.span(), "`type` must be a string"));
    };
    let types = || {
        kinds.iter().filter_map(|kind| match kind.section {
            Section::Device(name) => Some((name, kind)),
            Section::Bus(_) => None,
        })
    };
    match types().find(|(known, _)| *known == name) {
        Some((_, kind)) => kind.read(Spanned::new(span, DeValue::Table(table))),
        None => {
            let known = one_of(types().map(|(name, _)| name));
            let text = format!("unknown variant `{name}`, expected {known}");
            Err(error_at(kind.span(), &text))
        }
    }
}

/// Names as serde lists them.
fn one_of<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<_> = names.map(|name| format!("`{name}`")).collect();
    match &names[..] {
        [] => "none".to_owned(),
        [only] => only.clone(),
        [first, second] => format!("{first} or {second}"),
        _ => format!("one of {}", names.join(", ")),
    }
}

/// An error at a location of the file: an error of a visitor takes the location of the value that it visits.
pub(super) fn error_at(span: Range<usize>, text: &str) -> Error {
    struct Refusal<'a>(&'a str);

    impl Visitor<'_> for Refusal<'_> {
        type Value = Error;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(self.0)
        }

        fn visit_bool<E: serde::de::Error>(self, _: bool) -> Result<Error, E> {
            Err(E::custom(self.0))
        }
    }

    let value = ValueDeserializer::from(Spanned::new(span, DeValue::Boolean(true)));
    value
        .deserialize_bool(Refusal(text))
        .unwrap_or_else(|error| error)
}
