//! SDO transfers with one node (CiA 301, clause 7.2.4), one at a time, each to its end. The commands choose the
//! objects and interpret the values.

use std::fmt;
use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::sdo::{Client, Message as SdoMessage, Outcome, TRANSFER_MAX};
use takt_can::canopen::{Message, NodeId, SDO_REQUEST};
use takt_cia402::dictionary::{AbortCode, Address};

use super::wire::Wire;

/// Timeout of an SDO response in tests.
#[cfg(test)]
pub(super) const TIMEOUT: Duration = Duration::from_millis(500);

/// Why an SDO transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SdoError {
    /// The node aborted the transfer.
    Aborted(NodeId, Address, AbortCode),
    /// The node did not answer.
    Timeout(NodeId, Address, Duration),
    /// The node sent an invalid response.
    Invalid(NodeId, Address, AbortCode),
}

impl SdoError {
    /// The abort code that the node sent, if it sent one.
    pub(super) const fn code(self) -> Option<AbortCode> {
        match self {
            Self::Aborted(_, _, code) => Some(code),
            Self::Timeout(..) | Self::Invalid(..) => None,
        }
    }

    /// The object of the transfer.
    pub(super) const fn address(self) -> Address {
        match self {
            Self::Aborted(_, address, _)
            | Self::Timeout(_, address, _)
            | Self::Invalid(_, address, _) => address,
        }
    }

    pub(super) const fn is_timeout(self) -> bool {
        matches!(self, Self::Timeout(..))
    }
}

impl fmt::Display for SdoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aborted(node, address, code) => {
                write!(f, "node {node} refuses {address}: {code}")
            }
            Self::Timeout(node, address, time) => write!(
                f,
                "node {node} does not answer the SDO request for {address} within {time:?}\nhint: check its power, its number \
                 (takt can scan), its NMT state (takt can nmt) and the bit rate (takt can stat)"
            ),
            Self::Invalid(node, address, code) => write!(
                f,
                "node {node} sent an invalid SDO response for {address}: {code}; another node may have the same number, \
                 or another master may be sending requests"
            ),
        }
    }
}

/// The outer error is one of the interface, the inner one of the transfer.
pub(super) type Answer<T> = anyhow::Result<Result<T, SdoError>>;

/// SDO client of one node.
#[derive(Debug)]
pub(super) struct SdoClient {
    node: NodeId,
    client: Client,
    timeout: Duration,
}

impl SdoClient {
    pub(super) fn new(node: NodeId, timeout: Duration) -> Self {
        Self {
            node,
            client: Client::new(TRANSFER_MAX, timeout),
            timeout,
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
        Ok(self.result_of(outcome, |client| client.value().to_vec()))
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
        Ok(self.result_of(outcome, |_| ()))
    }

    fn result_of<T>(&self, outcome: Outcome, value: impl Fn(&Client) -> T) -> Result<T, SdoError> {
        let (node, address) = (self.node, self.client.address());
        match outcome {
            Outcome::Read | Outcome::Written => Ok(value(&self.client)),
            Outcome::Refused(code) => Err(SdoError::Aborted(node, address, code)),
            Outcome::GaveUp(AbortCode::TimedOut) => {
                Err(SdoError::Timeout(node, address, self.timeout))
            }
            Outcome::GaveUp(code) => Err(SdoError::Invalid(node, address, code)),
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
    fn sdo_values_of_every_length_are_transferred() {
        let mut lab = Lab::new();
        lab.add_drive(DriveNodeConfig {
            domain_len: 3000,
            ..DriveNodeConfig::new(node(5))
        });
        let mut client = SdoClient::new(node(5), TIMEOUT);
        let name = client.read(&mut lab, Address::new(0x1008, 0), false);
        assert_eq!(name.unwrap().unwrap(), b"Takt emulated drive");
        let domain = Address::new(0x2000, 0);
        let value: Vec<u8> = (0..3000_u32).map(|n| n.to_le_bytes()[0]).collect();
        for in_blocks in [false, true] {
            client
                .write(&mut lab, domain, &value, in_blocks)
                .unwrap()
                .unwrap();
            let read = client.read(&mut lab, domain, in_blocks).unwrap().unwrap();
            assert_eq!(read, value, "{in_blocks}");
        }
    }

    #[test]
    fn sdo_errors_name_node_and_object() {
        let mut lab = Lab::of_drives(&[5]);
        let mut client = SdoClient::new(node(5), TIMEOUT);
        let refused = client.read(&mut lab, Address::new(0x2222, 1), false);
        let refused = refused.unwrap().unwrap_err();
        assert_eq!(refused.code(), Some(AbortCode::NoObject));
        assert!(refused.to_string().contains("node 5 refuses 2222h:01"));
        lab.devices[0] = Device::Nothing;
        let silent = client.write(&mut lab, Address::new(0x1017, 0), &[0, 0], false);
        let silent = silent.unwrap().unwrap_err();
        assert!(silent.is_timeout(), "{silent}");
        assert!(silent.to_string().contains("1017h:00 within 500ms"));
    }
}
