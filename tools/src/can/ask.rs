//! Questions to one node by SDO (CiA 301, clause 7.2.4), one at a time, each to its end. What is asked, and
//! what becomes of the answer, the commands know.

use std::fmt;
use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::sdo::{Client, Message as SdoMessage, Outcome, TRANSFER_MAX};
use takt_can::canopen::{Message, NodeId, SDO_REQUEST};
use takt_cia402::dictionary::{AbortCode, Address};

use super::wire::Wire;

/// How long a node may take for an answer.
pub(super) const PATIENCE: Duration = Duration::from_millis(500);

/// Why a node did not do what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// It says so.
    Node(NodeId, Address, AbortCode),
    /// It says nothing.
    Silent(NodeId, Address, Duration),
    /// Its answer makes no sense.
    Broken(NodeId, Address, AbortCode),
}

impl Refusal {
    /// What the node says, if it says something.
    pub(super) const fn code(self) -> Option<AbortCode> {
        match self {
            Self::Node(_, _, code) => Some(code),
            Self::Silent(..) | Self::Broken(..) => None,
        }
    }

    /// What it is about.
    pub(super) const fn address(self) -> Address {
        match self {
            Self::Node(_, address, _)
            | Self::Silent(_, address, _)
            | Self::Broken(_, address, _) => address,
        }
    }

    pub(super) const fn is_silence(self) -> bool {
        matches!(self, Self::Silent(..))
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Node(node, address, code) => write!(f, "node {node} refuses {address}: {code}"),
            Self::Silent(node, address, time) => write!(
                f,
                "node {node} does not answer about {address} within {time:?}: is it powered, is that its \
                 number (takt can scan), is it not stopped (takt can nmt), is the bit rate right (takt can stat)?"
            ),
            Self::Broken(node, address, code) => write!(
                f,
                "the answer of node {node} about {address} makes no sense: {code}; do two nodes have this \
                 number, or is another master asking?"
            ),
        }
    }
}

/// What came of a question: a node's refusal is no failure of the asking.
pub(super) type Answer<T> = anyhow::Result<Result<T, Refusal>>;

/// Asks one node.
#[derive(Debug)]
pub(super) struct Asker {
    node: NodeId,
    client: Client,
    patience: Duration,
}

impl Asker {
    pub(super) fn new(node: NodeId, patience: Duration) -> Self {
        Self {
            node,
            client: Client::new(TRANSFER_MAX, patience),
            patience,
        }
    }

    pub(super) const fn node(&self) -> NodeId {
        self.node
    }

    /// Reads an entry.
    pub(super) fn read<W: Wire>(
        &mut self,
        wire: &mut W,
        address: Address,
        in_blocks: bool,
    ) -> Answer<Vec<u8>> {
        let first = self.client.read(address, in_blocks, wire.now());
        let outcome = self.finish(wire, first)?;
        Ok(self.judge(outcome, |client| client.value().to_vec()))
    }

    /// Writes an entry.
    pub(super) fn write<W: Wire>(
        &mut self,
        wire: &mut W,
        address: Address,
        value: &[u8],
        in_blocks: bool,
    ) -> Answer<()> {
        let first = self.client.write(address, value, in_blocks, wire.now());
        let first = first.map_err(|code| anyhow::anyhow!("{address}: {code}"))?;
        let outcome = self.finish(wire, first)?;
        Ok(self.judge(outcome, |_| ()))
    }

    fn judge<T>(&self, outcome: Outcome, value: impl Fn(&Client) -> T) -> Result<T, Refusal> {
        let (node, address) = (self.node, self.client.address());
        match outcome {
            Outcome::Read | Outcome::Written => Ok(value(&self.client)),
            Outcome::Refused(code) => Err(Refusal::Node(node, address, code)),
            Outcome::GaveUp(AbortCode::TimedOut) => {
                Err(Refusal::Silent(node, address, self.patience))
            }
            Outcome::GaveUp(code) => Err(Refusal::Broken(node, address, code)),
        }
    }

    fn send<W: Wire>(&self, wire: &mut W, message: SdoMessage) -> anyhow::Result<()> {
        wire.send(&Frame::full(self.node.cob(SDO_REQUEST), message))
    }

    fn finish<W: Wire>(&mut self, wire: &mut W, first: SdoMessage) -> anyhow::Result<Outcome> {
        self.send(wire, first)?;
        loop {
            loop {
                let progress = self.client.poll(wire.now());
                if let Some(message) = progress.send {
                    self.send(wire, message)?;
                }
                if let Some(outcome) = progress.outcome {
                    return Ok(outcome);
                }
                if progress.send.is_none() {
                    break;
                }
            }
            let until = self.client.poll_timeout().unwrap_or_default();
            let Some(frame) = wire.receive_until(until)? else {
                continue;
            };
            let Message::SdoResponse(node, message) = Message::decode(&frame) else {
                continue;
            };
            if node != self.node {
                continue;
            }
            let progress = self.client.handle(&message, wire.now());
            if let Some(message) = progress.send {
                self.send(wire, message)?;
            }
            if let Some(outcome) = progress.outcome {
                return Ok(outcome);
            }
        }
    }
}

/// The number in up to four bytes, little-endian.
pub(super) fn number(bytes: &[u8]) -> Option<u32> {
    let mut four = [0; 4];
    four.get_mut(..bytes.len())?.copy_from_slice(bytes);
    Some(u32::from_le_bytes(four))
}

#[cfg(test)]
mod tests {
    use super::super::lab::{Device, Lab, node};
    use super::*;
    use takt_can::canopen::emulator::DriveNodeConfig;

    #[test]
    fn values_of_every_length_are_read_and_written() {
        let mut lab = Lab::new();
        lab.add_drive(DriveNodeConfig {
            domain_len: 3000,
            ..DriveNodeConfig::new(node(5))
        });
        let mut asker = Asker::new(node(5), PATIENCE);
        let name = asker.read(&mut lab, Address::new(0x1008, 0), false);
        assert_eq!(name.unwrap().unwrap(), b"Takt emulated drive");
        let domain = Address::new(0x2000, 0);
        let value: Vec<u8> = (0..3000_u32).map(|n| n.to_le_bytes()[0]).collect();
        for in_blocks in [false, true] {
            asker
                .write(&mut lab, domain, &value, in_blocks)
                .unwrap()
                .unwrap();
            let read = asker.read(&mut lab, domain, in_blocks).unwrap().unwrap();
            assert_eq!(read, value, "{in_blocks}");
        }
    }

    #[test]
    fn refusals_and_silence_name_node_and_object() {
        let mut lab = Lab::of_drives(&[5]);
        let mut asker = Asker::new(node(5), PATIENCE);
        let refused = asker.read(&mut lab, Address::new(0x2222, 1), false);
        let refused = refused.unwrap().unwrap_err();
        assert_eq!(refused.code(), Some(AbortCode::NoObject));
        assert!(refused.to_string().contains("node 5 refuses 2222h:01"));
        lab.devices[0] = Device::Nothing;
        let silent = asker.write(&mut lab, Address::new(0x1017, 0), &[0, 0], false);
        let silent = silent.unwrap().unwrap_err();
        assert!(silent.is_silence(), "{silent}");
        assert!(silent.to_string().contains("1017h:00 within 500ms"));
    }
}
