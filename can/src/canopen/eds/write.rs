//! Writes data sheets and configurations. The caller sets dates.

use std::fmt::Write;

use takt_cia402::dictionary::{Access, Address, Dictionary, Entry, Object, ObjectCode, PdoUse};

use super::{Eds, NodeId, value};

impl Eds {
    /// The data sheet of a device with these objects, and the entries required by CiA 306.
    pub fn of_device(objects: Vec<Object>, relative: Vec<Address>, file_name: &str) -> Self {
        let count = |from: u16| {
            let within = |object: &&Object| (from..from + 0x200).contains(&object.index);
            objects.iter().filter(within).count().to_string()
        };
        let number = |sub: u8| {
            let identity = objects.iter().find(|object| object.index == 0x1018);
            let entry = identity.and_then(|o| o.entries.iter().find(|(s, _)| *s == sub));
            entry.map_or_else(
                || "0x0".into(),
                |(_, e)| value::print(e.data_type, &e.default, false),
            )
        };
        let name = objects.iter().find(|object| object.index == 0x1008);
        let name = name
            .and_then(|o| o.entries.first())
            .map_or(String::new(), |(_, entry)| {
                String::from_utf8_lossy(&entry.default).into_owned()
            });
        let text = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let mut device = vec![
            text("VendorName", ""),
            text("VendorNumber", &number(1)),
            text("ProductName", &name),
            text("ProductNumber", &number(2)),
            text("RevisionNumber", &number(3)),
        ];
        for rate in [10, 20, 50, 125, 250, 500, 800, 1000] {
            device.push((format!("BaudRate_{rate}"), "1".into()));
        }
        device.extend([
            text("SimpleBootUpMaster", "0"),
            text("SimpleBootUpSlave", "1"),
            text("Granularity", "1"),
            text("DynamicChannelsSupported", "0"),
            text("GroupMessaging", "0"),
            text("NrOfRXPDO", &count(0x1400)),
            text("NrOfTXPDO", &count(0x1800)),
            text("LSS_Supported", "1"),
        ]);
        let file = vec![
            text("FileName", file_name),
            text("FileVersion", "1"),
            text("FileRevision", "0"),
            text("EDSVersion", "4.0"),
            text("Description", &name),
            text("CreatedBy", "Takt"),
        ];
        let dummies = (1..8)
            .map(|n| (format!("Dummy{n:04}"), "1".to_owned()))
            .collect();
        Self {
            sections: vec![
                ("FileInfo".into(), file),
                ("DeviceInfo".into(), device),
                ("DummyUsage".into(), dummies),
            ],
            objects,
            relative,
            ..Self::default()
        }
    }

    /// Turns it into the DCF of one device: node number, bit rate in kbit/s, and the current values
    /// of its dictionary.
    pub fn configure(&mut self, node: NodeId, kbit: u32, dictionary: &Dictionary) {
        (self.node, self.kbit) = (Some(node), Some(kbit));
        self.values = self
            .objects
            .iter()
            .flat_map(|object| object.entries.iter().map(|(sub, _)| (object.index, *sub)))
            .map(|(index, sub)| Address::new(index, sub))
            .filter_map(|address| Some((address, dictionary.bytes(address)?.to_vec())))
            .filter(|(_, value)| value.len() <= 255)
            .collect();
    }

    /// The text of the file: an EDS, or a DCF if it has a node number. [`Eds::parse`] reads it back
    /// unchanged.
    pub fn print(&self) -> String {
        let mut out = String::new();
        for (name, keys) in &self.sections {
            let lists = ["MandatoryObjects", "OptionalObjects", "ManufacturerObjects"];
            let own = lists
                .iter()
                .chain(&["DeviceComissioning", "DeviceCommissioning"]);
            if own.into_iter().any(|own| own.eq_ignore_ascii_case(name)) {
                continue;
            }
            section(
                &mut out,
                name,
                keys.iter().map(|(k, v)| (k.as_str(), v.clone())),
            );
        }
        if let Some(node) = self.node {
            let kbit = self.kbit.unwrap_or(1000).to_string();
            let keys = [
                ("NodeID", format!("0x{:02X}", node.raw())),
                ("Baudrate", kbit),
            ];
            section(&mut out, "DeviceComissioning", keys);
        }
        self.lists(&mut out);
        for object in &self.objects {
            self.object_sections(&mut out, object);
        }
        out
    }

    fn lists(&self, out: &mut String) {
        let mandatory = |index: u16| matches!(index, 0x1000 | 0x1001 | 0x1018);
        let manufacturer = |index: u16| (0x2000..0x6000).contains(&index);
        let list = |wanted: &dyn Fn(u16) -> bool| -> Vec<u16> {
            let all = self.objects.iter().map(|object| object.index);
            all.filter(|index| wanted(*index)).collect()
        };
        for (name, indices) in [
            ("MandatoryObjects", list(&mandatory)),
            (
                "OptionalObjects",
                list(&|i| !mandatory(i) && !manufacturer(i)),
            ),
            ("ManufacturerObjects", list(&manufacturer)),
        ] {
            let count = indices.len().to_string();
            let numbers: Vec<_> = (1..=indices.len()).map(|n| n.to_string()).collect();
            let keys = numbers.iter().map(String::as_str).zip(indices);
            let keys = keys.map(|(n, index)| (n, format!("0x{index:04X}")));
            section(
                out,
                name,
                std::iter::once(("SupportedObjects", count)).chain(keys),
            );
        }
    }

    fn object_sections(&self, out: &mut String, object: &Object) {
        let index = object.index;
        let object_type = format!("0x{:X}", object.code.raw());
        let name = ("ParameterName", object.name.to_string());
        if matches!(object.code, ObjectCode::Var | ObjectCode::Domain)
            && let [(0, entry)] = object.entries.as_slice()
        {
            let keys = self.entry_keys(Address::new(index, 0), entry);
            let keys = [name, ("ObjectType", object_type)].into_iter().chain(keys);
            section(out, &format!("{index:04X}"), keys);
            return;
        }
        let count = format!("0x{:X}", object.entries.len());
        let keys = [name, ("ObjectType", object_type), ("SubNumber", count)];
        section(out, &format!("{index:04X}"), keys);
        for (sub, entry) in &object.entries {
            let name = ("ParameterName", entry.name.to_string());
            let keys = self.entry_keys(Address::new(index, *sub), entry);
            let head = [name, ("ObjectType", "0x7".to_owned())];
            section(
                out,
                &format!("{index:04X}sub{sub:X}"),
                head.into_iter().chain(keys),
            );
        }
    }

    fn entry_keys(&self, address: Address, entry: &Entry) -> Vec<(&'static str, String)> {
        let kind = entry.data_type;
        let (access, mapping) = match (entry.access, entry.pdo) {
            (Access::ReadWrite, PdoUse::Receive) => ("rww", 1),
            (Access::ReadWrite, PdoUse::Transmit) => ("rwr", 1),
            (Access::Const, pdo) => ("const", u8::from(pdo != PdoUse::None)),
            (Access::ReadOnly, pdo) => ("ro", u8::from(pdo != PdoUse::None)),
            (Access::WriteOnly, pdo) => ("wo", u8::from(pdo != PdoUse::None)),
            (Access::ReadWrite, pdo) => ("rw", u8::from(pdo != PdoUse::None)),
        };
        let relative = self.relative.contains(&address);
        // A domain is a file, not a default.
        let long = entry.default.len() > 255;
        let default = if long {
            String::new()
        } else {
            value::print(kind, &entry.default, relative)
        };
        let mut keys = vec![
            ("DataType", format!("0x{:04X}", kind.raw())),
            ("AccessType", access.to_owned()),
            ("DefaultValue", default),
            ("PDOMapping", mapping.to_string()),
        ];
        keys.extend(entry.low.map(|low| ("LowLimit", low.to_string())));
        keys.extend(entry.high.map(|high| ("HighLimit", high.to_string())));
        let value_of_dcf = self.values.iter().find(|(at, _)| *at == address);
        if let Some((_, value_of_dcf)) =
            value_of_dcf.filter(|(_, value_of_dcf)| *value_of_dcf != entry.default || relative)
        {
            keys.push(("ParameterValue", value::print(kind, value_of_dcf, false)));
        }
        keys
    }
}

fn section<'a>(out: &mut String, name: &str, keys: impl IntoIterator<Item = (&'a str, String)>) {
    // Writing into a string cannot fail. Line endings follow CiA 306.
    let _ = write!(out, "[{name}]\r\n");
    for (key, value) in keys {
        let _ = write!(out, "{key}={value}\r\n");
    }
    out.push_str("\r\n");
}
