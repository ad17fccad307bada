//! The CoE side of a slave with an object dictionary (ETG.1000.6, clause 5.6): SDO by expedited, normal and segmented
//! transfer, complete access, the information service, emergencies. The behaviour of the objects is up to their owner.

use std::collections::VecDeque;

use takt_cia402::dictionary::{
    AbortCode, Address, Dictionary, Entry, Hooks, Object, ObjectCode, PdoUse,
};

use crate::coe::{Information, SDO_LEN, Sdo, Whole};
use crate::{CoeService, Emergency, MailboxHeader};

/// A segmented transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Transfer {
    Download {
        address: Address,
        whole: Whole,
        size: usize,
        toggle: bool,
        data: Vec<u8>,
    },
    Upload {
        toggle: bool,
        data: Vec<u8>,
        at: usize,
    },
}

/// An SDO server over CoE.
#[derive(Clone, Debug)]
pub struct CoeServer {
    transfer: Option<Transfer>,
    /// Unsolicited messages to send.
    pending: VecDeque<Vec<u8>>,
    /// Capacity of a mailbox after mailbox header and CoE header, bytes.
    capacity: usize,
    complete_access: bool,
    information: bool,
}

/// Longest value that is transferred, bytes.
const SIZE_MAX: usize = takt_cia402::dictionary::VALUE_MAX;

impl CoeServer {
    /// A server for mailboxes of a given length; complete access is optional.
    pub fn new(mailbox_len: u16, complete_access: bool) -> Self {
        let headers = MailboxHeader::LEN + CoeService::LEN;
        Self {
            transfer: None,
            pending: VecDeque::new(),
            capacity: usize::from(mailbox_len).saturating_sub(headers).max(16),
            complete_access,
            information: true,
        }
    }

    /// Enables or disables the information service.
    #[must_use]
    pub(crate) const fn with_information(mut self, information: bool) -> Self {
        self.information = information;
        self
    }

    /// Aborts transfers, as INIT does.
    pub fn reset(&mut self) {
        self.transfer = None;
        self.pending.clear();
    }

    /// Queues an emergency.
    pub fn emergency(&mut self, emergency: &Emergency) {
        let mut message = CoeService::Emergency.encode().to_vec();
        message.extend(emergency.encode());
        self.pending.push_back(message);
    }

    /// The next unsolicited message.
    pub fn unasked(&mut self, message: &mut Vec<u8>) -> bool {
        let next = self.pending.pop_front();
        let some = next.is_some();
        *message = next.unwrap_or_default();
        some
    }

    /// Handles the content of a CoE mailbox; returns whether there is an answer.
    pub fn answer<H: Hooks>(
        &mut self,
        request: &[u8],
        reply: &mut Vec<u8>,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> bool {
        reply.clear();
        let Some((service, inside)) = CoeService::decode(request) else {
            return false;
        };
        match service {
            CoeService::SdoRequest => match Sdo::decode_request(inside) {
                Some(Sdo::Abort { .. }) => {
                    self.transfer = None;
                    false
                }
                Some(sdo) => {
                    let address = address_of(&sdo);
                    if let Err(code) = self.sdo(&sdo, reply, dictionary, hooks) {
                        self.transfer = None;
                        abort(reply, address, code);
                    }
                    true
                }
                None => {
                    self.transfer = None;
                    abort(reply, Address::default(), AbortCode::CommandSpecifier);
                    true
                }
            },
            CoeService::SdoInformation if !self.information => {
                let code = AbortCode::UnsupportedAccess.raw().to_le_bytes();
                inform(reply, Information::ERROR, 0, &code);
                true
            }
            CoeService::SdoInformation => self.information(inside, reply, dictionary),
            CoeService::Emergency
            | CoeService::SdoResponse
            | CoeService::Pdo(_)
            | CoeService::Other(_) => false,
        }
    }

    fn sdo<H: Hooks>(
        &mut self,
        sdo: &Sdo<'_>,
        reply: &mut Vec<u8>,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        match *sdo {
            Sdo::Upload { address, whole } => {
                let data = self.read(address, whole, dictionary, hooks)?;
                self.begin_upload(address, whole, data, reply);
            }
            Sdo::UploadSegment { toggle } => self.upload_segment(toggle, reply)?,
            Sdo::Download {
                address,
                whole,
                size,
                data,
            } => {
                let size = usize::try_from(size).unwrap_or(usize::MAX);
                if size > SIZE_MAX {
                    return Err(AbortCode::OutOfMemory);
                }
                if data.len() >= size {
                    let data = data.get(..size).unwrap_or_default();
                    self.write(address, whole, data, dictionary, hooks)?;
                } else {
                    self.transfer = Some(Transfer::Download {
                        address,
                        whole,
                        size,
                        toggle: false,
                        data: data.to_vec(),
                    });
                }
                respond(reply, &Sdo::Downloaded { address, whole });
            }
            Sdo::DownloadSegment { toggle, last, data } => {
                self.download_segment(toggle, last, data, dictionary, hooks)?;
                respond(reply, &Sdo::DownloadedSegment { toggle });
            }
            Sdo::Downloaded { .. }
            | Sdo::DownloadedSegment { .. }
            | Sdo::Uploaded { .. }
            | Sdo::UploadedSegment { .. }
            | Sdo::Abort { .. } => return Err(AbortCode::CommandSpecifier),
        }
        Ok(())
    }

    fn begin_upload(&mut self, address: Address, whole: Whole, data: Vec<u8>, reply: &mut Vec<u8>) {
        let size = u32::try_from(data.len()).unwrap_or(u32::MAX);
        let first = data.len().min(self.capacity - SDO_LEN);
        let part = if data.len() <= 4 { data.len() } else { first };
        respond(
            reply,
            &Sdo::Uploaded {
                address,
                whole,
                size,
                data: data.get(..part).unwrap_or_default(),
            },
        );
        self.transfer = (part < data.len()).then_some(Transfer::Upload {
            toggle: false,
            data,
            at: part,
        });
    }

    fn upload_segment(&mut self, toggle: bool, reply: &mut Vec<u8>) -> Result<(), AbortCode> {
        let capacity = self.capacity - 1;
        let Some(Transfer::Upload {
            toggle: expected,
            data,
            at,
        }) = &mut self.transfer
        else {
            return Err(AbortCode::CommandSpecifier);
        };
        if toggle != *expected {
            return Err(AbortCode::Toggle);
        }
        let rest = data.get(*at..).unwrap_or_default();
        let part = rest.get(..rest.len().min(capacity)).unwrap_or_default();
        let last = part.len() == rest.len();
        respond(
            reply,
            &Sdo::UploadedSegment {
                toggle,
                last,
                data: part,
            },
        );
        *at += part.len();
        *expected = !toggle;
        if last {
            self.transfer = None;
        }
        Ok(())
    }

    fn download_segment<H: Hooks>(
        &mut self,
        toggle: bool,
        last: bool,
        part: &[u8],
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        let Some(Transfer::Download {
            address,
            whole,
            size,
            toggle: expected,
            data,
        }) = &mut self.transfer
        else {
            return Err(AbortCode::CommandSpecifier);
        };
        if toggle != *expected {
            return Err(AbortCode::Toggle);
        }
        *expected = !toggle;
        data.extend_from_slice(part);
        if data.len() > *size {
            return Err(AbortCode::TooLong);
        }
        if !last {
            return Ok(());
        }
        if data.len() < *size {
            return Err(AbortCode::TooShort);
        }
        let (address, whole, data) = (*address, *whole, std::mem::take(data));
        self.transfer = None;
        self.write(address, whole, &data, dictionary, hooks)
    }

    fn read<H: Hooks>(
        &self,
        address: Address,
        whole: Whole,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<Vec<u8>, AbortCode> {
        if whole == Whole::Entry {
            return dictionary.upload(address, hooks).map(<[u8]>::to_vec);
        }
        let mut data = Vec::new();
        for sub in self.entries(address, dictionary)? {
            let at = Address::new(address.index, sub);
            let value = dictionary.upload(at, hooks)?;
            data.extend_from_slice(value);
            if sub == 0 {
                data.push(0);
            }
        }
        Ok(data)
    }

    /// The sub-indices of a complete access: from 0 or 1 on.
    fn entries(&self, address: Address, dictionary: &Dictionary) -> Result<Vec<u8>, AbortCode> {
        let object = dictionary
            .object(address.index)
            .ok_or(AbortCode::NoObject)?;
        if !self.complete_access || address.sub > 1 {
            return Err(AbortCode::NoCompleteAccess);
        }
        let subs = object.entries.iter().map(|(sub, _)| *sub);
        // As many as sub-index 0 presently counts.
        let count = dictionary.bytes(Address::new(address.index, 0));
        let count = count.and_then(<[u8]>::first).copied().unwrap_or(0);
        Ok(subs
            .filter(|sub| *sub >= address.sub && *sub <= count)
            .collect())
    }

    fn write<H: Hooks>(
        &self,
        address: Address,
        whole: Whole,
        data: &[u8],
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        if whole == Whole::Entry {
            return dictionary.download(address, data, hooks);
        }
        let object = dictionary
            .object(address.index)
            .ok_or(AbortCode::NoObject)?;
        if !self.complete_access || address.sub > 1 {
            return Err(AbortCode::NoCompleteAccess);
        }
        let subs: Vec<(u8, usize)> = object
            .entries
            .iter()
            .filter(|(sub, _)| *sub >= address.sub)
            .filter_map(|(sub, entry)| Some((*sub, entry.data_type.size()?)))
            .collect();
        let count = (address.sub == 0).then(|| data.first().copied()).flatten();
        let mut rest = data;
        let zero = Address::new(address.index, 0);
        if count.is_some() {
            // The count is changed last, as if each entry were written separately.
            rest = rest.get(2..).ok_or(AbortCode::TooShort)?;
            dictionary.download(zero, &[0], hooks)?;
        }
        for (sub, len) in subs.into_iter().filter(|(sub, _)| *sub > 0) {
            if rest.is_empty() {
                break;
            }
            let (value, after) = rest.split_at_checked(len).ok_or(AbortCode::TooShort)?;
            dictionary.download(Address::new(address.index, sub), value, hooks)?;
            rest = after;
        }
        match count {
            Some(count) => dictionary.download(zero, &[count], hooks),
            None => Ok(()),
        }
    }

    fn information(&mut self, inside: &[u8], reply: &mut Vec<u8>, d: &Dictionary) -> bool {
        let Some((header, data)) = Information::decode(inside) else {
            return false;
        };
        let index = data.first_chunk().map_or(0, |two| u16::from_le_bytes(*two));
        let answer = match header.operation {
            Information::LIST => {
                self.list(index, reply, d);
                return true;
            }
            Information::OBJECT => d.object(index).map(describe_object),
            Information::ENTRY => {
                let sub = data.get(2).copied().unwrap_or(0);
                let entry = d.entry(Address::new(index, sub));
                entry.map(|entry| describe_entry(index, sub, entry))
            }
            _ => None,
        };
        let (operation, data) = match answer {
            Some(data) => (header.operation + 1, data),
            None => {
                let code = if d.object(index).is_some() {
                    AbortCode::NoSubIndex
                } else {
                    AbortCode::NoObject
                };
                (Information::ERROR, code.raw().to_le_bytes().to_vec())
            }
        };
        inform(reply, operation, 0, &data);
        true
    }

    /// Lists of indices: 0 their lengths, 1 all, 2 and 3 those for PDOs, 4 and 5 those that can be
    /// written.
    fn list(&mut self, kind: u16, reply: &mut Vec<u8>, d: &Dictionary) {
        let listed = |kind: u16| -> Vec<u16> {
            let wanted = |object: &&Object| match kind {
                1 => true,
                2 => has(object, |e| matches!(e.pdo, PdoUse::Receive | PdoUse::Both)),
                3 => has(object, |e| matches!(e.pdo, PdoUse::Transmit | PdoUse::Both)),
                4 | 5 => has(object, |e| e.access.is_writable()),
                _ => false,
            };
            d.objects().iter().filter(wanted).map(|o| o.index).collect()
        };
        let words: Vec<u16> = if kind == 0 {
            (1..=5)
                .map(|kind| u16::try_from(listed(kind).len()).unwrap_or(u16::MAX))
                .collect()
        } else {
            listed(kind)
        };
        let each = (self.capacity - Information::LEN - 2) / 2;
        let parts: Vec<&[u16]> = words.chunks(each).collect();
        let count = parts.len().max(1);
        for number in 0..count {
            let part = parts.get(number).copied().unwrap_or_default();
            let mut data = if number == 0 {
                kind.to_le_bytes().to_vec()
            } else {
                Vec::new()
            };
            data.extend(part.iter().flat_map(|word| word.to_le_bytes()));
            let mut message = Vec::new();
            let left = u16::try_from(count - 1 - number).unwrap_or(u16::MAX);
            inform(&mut message, Information::LIST + 1, left, &data);
            if number == 0 {
                *reply = message;
            } else {
                self.pending.push_back(message);
            }
        }
    }
}

fn has(object: &Object, so: impl Fn(&Entry) -> bool) -> bool {
    object.entries.iter().any(|(_, entry)| so(entry))
}

fn describe_object(object: &Object) -> Vec<u8> {
    let entry = object.entries.last();
    let data_type = entry.map_or(0, |(_, entry)| entry.data_type.raw());
    let highest = match object.code {
        ObjectCode::Var | ObjectCode::Domain => 0,
        ObjectCode::Array | ObjectCode::Record | ObjectCode::Other(_) => {
            entry.map_or(0, |(sub, _)| *sub)
        }
    };
    let mut data = object.index.to_le_bytes().to_vec();
    data.extend(data_type.to_le_bytes());
    data.extend([highest, object.code.raw()]);
    data.extend(object.name.as_bytes());
    data
}

fn describe_entry(index: u16, sub: u8, entry: &Entry) -> Vec<u8> {
    let mut data = index.to_le_bytes().to_vec();
    let bits = entry.data_type.bits().unwrap_or(8 * entry.max_len);
    let access = (u16::from(entry.access.is_readable()) * 0x07)
        | (u16::from(entry.access.is_writable()) * 0x38)
        | u16::from(matches!(entry.pdo, PdoUse::Receive | PdoUse::Both)) << 6
        | u16::from(matches!(entry.pdo, PdoUse::Transmit | PdoUse::Both)) << 7;
    data.extend([sub, 0]);
    data.extend(entry.data_type.raw().to_le_bytes());
    data.extend(u16::try_from(bits).unwrap_or(u16::MAX).to_le_bytes());
    data.extend(access.to_le_bytes());
    data.extend(entry.name.as_bytes());
    data
}

fn inform(reply: &mut Vec<u8>, operation: u8, left: u16, data: &[u8]) {
    let header = Information {
        operation,
        incomplete: left > 0,
        left,
    };
    reply.clear();
    reply.extend(CoeService::SdoInformation.encode());
    reply.extend(header.encode());
    reply.extend_from_slice(data);
}

const fn address_of(sdo: &Sdo<'_>) -> Address {
    match sdo {
        Sdo::Download { address, .. }
        | Sdo::Upload { address, .. }
        | Sdo::Downloaded { address, .. }
        | Sdo::Uploaded { address, .. }
        | Sdo::Abort { address, .. } => *address,
        Sdo::DownloadSegment { .. }
        | Sdo::UploadSegment { .. }
        | Sdo::DownloadedSegment { .. }
        | Sdo::UploadedSegment { .. } => Address::new(0, 0),
    }
}

fn write_sdo(reply: &mut Vec<u8>, service: CoeService, sdo: &Sdo<'_>) {
    reply.clear();
    reply.extend(service.encode());
    let start = reply.len();
    let len = match sdo {
        Sdo::Uploaded { data, .. } | Sdo::UploadedSegment { data, .. } => data.len(),
        Sdo::Download { .. }
        | Sdo::DownloadSegment { .. }
        | Sdo::Upload { .. }
        | Sdo::UploadSegment { .. }
        | Sdo::Downloaded { .. }
        | Sdo::DownloadedSegment { .. }
        | Sdo::Abort { .. } => 0,
    };
    reply.resize(start + SDO_LEN + len, 0);
    let written = reply.get_mut(start..).and_then(|to| sdo.encode(to));
    reply.truncate(start + written.unwrap_or(0));
}

fn respond(reply: &mut Vec<u8>, sdo: &Sdo<'_>) {
    write_sdo(reply, CoeService::SdoResponse, sdo);
}

/// An abort has the service of a request.
fn abort(reply: &mut Vec<u8>, address: Address, code: AbortCode) {
    write_sdo(reply, CoeService::SdoRequest, &Sdo::Abort { address, code });
}
