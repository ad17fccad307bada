//! Values of other nets during loading: checks that the named net exists and has a value of the
//! right type. Nothing is copied here.

use crate::fault::Fault;
use crate::load::builder::Build;
use crate::netcomm::{Entry, INTER_STATUS, Inter, NetBoxes};
use crate::value::{Type, Value};

/// Name of the parameter that names the net.
const NET: &str = "RemoteNet";
/// Name of the parameter that names the value.
const KEY: &str = "RemoteKey";

impl Build<'_, '_> {
    /// Allocates a hidden in value for the out value of the net of parameter `RemoteNet` with the
    /// key of `RemoteKey`; returns its index, that of the value's first word, and its number of
    /// elements.
    ///
    /// # Errors
    /// If there is no such net, or it has no such out value, or one of another type.
    pub(crate) fn inter_in<T: Value>(&mut self, array: bool) -> Result<(usize, usize), Fault> {
        let boxes = self.other_net()?;
        let from = self.remote::<T>(boxes.outbox.entries(), "out", array)?;
        self.check_netcomm_bound()?;
        let words = from.value_words();
        let key = format!("<{}.{}", self.text(NET), self.text(KEY));
        let parts = &mut *self.parts;
        let at = parts.inbox.add(key, from.ty, INTER_STATUS + words, false);
        parts.inbox_words.resize(parts.inbox.words(), 0);
        let to = parts.inbox.entries().last().cloned();
        let net = self.text(NET).to_owned();
        let inter = to.map(|to| Inter { net, from, to });
        self.parts.inter_ins.extend(inter);
        Ok((at, words / T::WORDS))
    }

    /// Allocates a hidden out value that is copied to the in value of the net of parameter
    /// `RemoteNet` with the key of `RemoteKey`, of `len` elements if it is an array; returns its
    /// index.
    ///
    /// # Errors
    /// If there is no such net, or it has no such in value, or one of another type or size.
    pub(crate) fn inter_out<T: Value>(&mut self, len: Option<usize>) -> Result<usize, Fault> {
        let boxes = self.other_net()?;
        let to = self.remote::<T>(boxes.inbox.entries(), "in", len.is_some())?;
        self.check_netcomm_bound()?;
        let (words, wanted) = (len.unwrap_or(1) * T::WORDS, to.value_words());
        if words != wanted {
            let (has, wants) = (words / T::WORDS, wanted / T::WORDS);
            let why = format!("that value has {wants} elements, the source has {has}");
            return Err(self.parameter_fault(KEY, why));
        }
        let number = self.parts.inter_outs.len();
        let key = format!(">{}.{}#{number}", self.text(NET), self.text(KEY));
        let at = self.parts.outbox.add(key, to.ty, words, false);
        let from = self.parts.outbox.entries().last().cloned();
        let net = self.text(NET).to_owned();
        let inter = from.map(|from| Inter { net, from, to });
        self.effects().acts = true;
        self.parts.inter_outs.extend(inter);
        Ok(at)
    }

    fn other_net(&self) -> Result<NetBoxes, Fault> {
        let name = self.text(NET);
        self.devices().net(name).ok_or_else(|| {
            let why = format!("there is no net `{name}` here; load it first");
            self.parameter_fault(NET, why)
        })
    }

    /// The entry with the parameter's key, with or without the prefix of keys on the wire.
    fn remote<T: Value>(
        &self,
        entries: &[Entry],
        begin: &str,
        array: bool,
    ) -> Result<Entry, Fault> {
        let key = self.text(KEY);
        let whole = format!("{begin}{key}");
        let mut seen = entries.iter().filter(|e| !e.is_hidden());
        let found = seen
            .clone()
            .find(|e| e.key == whole)
            .or_else(|| seen.find(|e| e.key == key));
        let Some(entry) = found else {
            let why = format!("net `{}` has no value `{whole}`", self.text(NET));
            return Err(self.parameter_fault(KEY, why));
        };
        let ty = Type {
            element: T::ELEMENT,
            array,
        };
        if entry.ty != ty {
            let why = format!("`{}` is of type {}, not {ty}", entry.key, entry.ty);
            return Err(self.parameter_fault(KEY, why));
        }
        Ok(entry.clone())
    }
}
