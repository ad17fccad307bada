//! Parameters of a device as programs give them: texts by name. Each reader documents its own.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use takt_net::value::text::parse_array;

use crate::device::on_end::{OnEnd, OutputsOnEnd};
use crate::device::{LEAST, MOST};
use crate::error::Error;

/// The parameters of one device.
pub(super) struct Parameters<'a> {
    pub(super) name: &'a str,
    pub(super) texts: &'a BTreeMap<String, String>,
}

impl Parameters<'_> {
    pub(super) fn wrong(&self, what: String) -> Error {
        Error::DeviceParameter {
            name: self.name.to_owned(),
            what,
        }
    }

    /// A list of `len` numbers from -[`MOST`] to [`MOST`], if present.
    pub(super) fn list(&self, key: &str, len: usize) -> Result<Option<Vec<f64>>, Error> {
        let Some(text) = self.texts.get(key) else {
            return Ok(None);
        };
        let values = parse_array::<f64>(text, len)
            .map_err(|e| self.wrong(format!("{key}: {}", e.message)))?;
        if values.len() != len || !values.iter().all(|v| v.abs() <= MOST) {
            let what = format!("{key}: {len} numbers from -{MOST:e} to {MOST:e} are wanted");
            return Err(self.wrong(what));
        }
        Ok(Some(values))
    }

    /// Output policies at the end of a net: `hold`, or a value for each.
    pub(super) fn on_end(&self, bools: usize, reals: usize) -> Result<OutputsOnEnd, Error> {
        let policies = OutputsOnEnd {
            bool: self.policies("on_end_bool", "true or false", |it| it.parse().ok())?,
            real: self.policies("on_end_real", "a finite number", |it| {
                it.parse().ok().filter(|value: &f64| value.is_finite())
            })?,
        };
        let checked = policies.check(bools, reals);
        checked.map_err(|what| self.wrong(what))?;
        Ok(policies)
    }

    fn policies<T>(
        &self,
        key: &str,
        kind: &str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<Vec<OnEnd<T>>, Error> {
        let Some(text) = self.texts.get(key) else {
            return Ok(Vec::new());
        };
        let bare = text.trim().trim_start_matches('[').trim_end_matches(']');
        let one = |(port, item): (usize, &str)| match item.trim() {
            "hold" => Ok(OnEnd::Hold),
            item => parse(item).map(OnEnd::Take).ok_or_else(|| {
                self.wrong(format!(
                    "{key}: `{item}` of output {port} is neither hold nor {kind}"
                ))
            }),
        };
        bare.split(',').enumerate().map(one).collect()
    }

    /// A required list.
    pub(super) fn needed(&self, key: &str, len: usize) -> Result<Vec<f64>, Error> {
        self.list(key, len)?
            .ok_or_else(|| self.wrong(format!("{key} is missing")))
    }

    /// One of the words of a table, by default the first; its value.
    pub(super) fn choice<T: Copy>(&self, key: &str, choices: [(&str, T); 2]) -> Result<T, Error> {
        let [(default, _), (other, _)] = choices;
        let text = self.texts.get(key).map_or(default, |text| text.trim());
        let found = choices.into_iter().find(|(word, _)| *word == text);
        found
            .map(|(_, value)| value)
            .ok_or_else(|| self.wrong(format!("{key}: `{text}` is neither {default} nor {other}")))
    }

    /// A positive number.
    pub(super) fn positive(&self, key: &str, default: f64) -> Result<f64, Error> {
        let Some(text) = self.texts.get(key) else {
            return Ok(default);
        };
        let value = text.trim().parse().ok();
        value.filter(|v| (LEAST..=MOST).contains(v)).ok_or_else(|| {
            let what = format!("{key}: `{text}` is no number from {LEAST:e} to {MOST:e}");
            self.wrong(what)
        })
    }

    /// An integer in a range.
    pub(super) fn count(
        &self,
        key: &str,
        default: usize,
        range: RangeInclusive<usize>,
    ) -> Result<usize, Error> {
        let Some(text) = self.texts.get(key) else {
            return Ok(default);
        };
        let value = text.trim().parse().ok().filter(|n| range.contains(n));
        value.ok_or_else(|| {
            let (from, to) = (range.start(), range.end());
            self.wrong(format!(
                "{key}: `{text}` is no whole number from {from} to {to}"
            ))
        })
    }
}
