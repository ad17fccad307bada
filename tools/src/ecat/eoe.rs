//! `takt ecat eoe`: the Ethernet port of a slave: its addresses, and a tunnel from it to a network interface of this host.

use std::net::Ipv4Addr;
use std::process::Command;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use clap::{Args, Subcommand};
use serde::Serialize;
use takt_ethercat::AlState;
use takt_ethercat::eoe::{EoeRequest, FRAME_MAX, HostName, IpSettings, UNIT};
use takt_ethercat::link::Link;
use takt_ethercat::linux::TapLink;
use takt_ethercat::master::{EthernetCounters, EthernetJob, Job, JobKind, Reply};

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::Verdict;
use crate::output::{complain, positive_span, say};
use crate::signal::Stop;

/// Use the Ethernet port of a slave (EoE): its addresses, and a tunnel to it.
///
/// All slaves are brought to PRE-OP. Addresses last until the slave is switched off, with some slaves until they leave PRE-OP.
/// Exit status: 0 done; 1 the slave refuses, with its reason, or was lost; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat eoe enp2s0 3 get
  takt ecat eoe enp2s0 3 set-ip 192.168.7.2/24
  takt ecat eoe enp2s0 3 tunnel drive0 --slave-ip 192.168.7.2/24 --host-ip 192.168.7.1/24
  ping 192.168.7.2                     in another terminal, while the tunnel runs")]
pub(crate) struct Eoe {
    #[command(flatten)]
    target: Target,
    /// The slave: its position from 0, or its name or order code if it is unique.
    slave: String,
    /// The port of the slave, 1 to 15; 0 for a slave with one.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=15))]
    port: u8,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Read the addresses of the port.
    Get {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Set the addresses of the port.
    SetIp(Addresses),
    /// Make a network interface of this host whose other end is the port, until Ctrl-C. As root.
    ///
    /// What is dropped on the way is counted and reported. A slave with mailboxes of 1024 bytes takes two messages for a
    /// frame of 1500 bytes, one of 128 bytes sixteen, and each message takes about two cycles.
    Tunnel(Tunnel),
}

#[derive(Debug, Args)]
struct Addresses {
    /// IP address and length of its subnet, such as 192.168.7.2/24.
    #[arg(value_name = "IP/BITS", value_parser = subnet)]
    ip: Subnet,
    /// Default gateway.
    #[arg(long, value_name = "IP")]
    gateway: Option<Ipv4Addr>,
    /// MAC address; default: a local one, 02:54:4b:00 and the position of the slave.
    #[arg(long, value_name = "MAC", value_parser = mac)]
    mac: Option<[u8; 6]>,
    /// DNS server.
    #[arg(long, value_name = "IP")]
    dns: Option<Ipv4Addr>,
    /// Host name, up to 32 letters, digits, `-`, `.`, `_`.
    #[arg(long, value_parser = host_name)]
    name: Option<HostName>,
}

#[derive(Debug, Args)]
struct Tunnel {
    /// The interface to make, up to 15 letters.
    #[arg(value_name = "NAME")]
    name: String,
    /// Set this address of the slave first.
    #[arg(long, value_name = "IP/BITS", value_parser = subnet)]
    slave_ip: Option<Subnet>,
    /// Give the interface this address and bring it up, by `ip`.
    #[arg(long, value_name = "IP/BITS", value_parser = subnet)]
    host_ip: Option<Subnet>,
    /// The cycle of the segment: a shorter one carries more.
    #[arg(long, value_name = "TIME", default_value = "500us", value_parser = positive_span)]
    cycle: Duration,
    /// Stop after this time; default: at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

/// An address in a subnet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Subnet {
    ip: Ipv4Addr,
    bits: u32,
}

impl Subnet {
    const fn mask(self) -> Ipv4Addr {
        let host = u32::MAX.checked_shr(self.bits);
        let host = match host {
            Some(host) => host,
            None => 0,
        };
        Ipv4Addr::from_bits(!host)
    }
}

fn subnet(text: &str) -> Result<Subnet, String> {
    let parsed = text.split_once('/').and_then(|(ip, bits)| {
        let (ip, bits) = (ip.parse().ok()?, bits.parse().ok()?);
        (1..=30).contains(&bits).then_some(Subnet { ip, bits })
    });
    parsed
        .ok_or_else(|| format!("`{text}` is no address such as 192.168.7.2/24, with 1 to 30 bits"))
}

fn mac(text: &str) -> Result<[u8; 6], String> {
    let bytes: Option<Vec<u8>> = text
        .split([':', '-'])
        .map(|part| u8::from_str_radix(part, 16).ok())
        .collect();
    let mac = bytes.and_then(|bytes| <[u8; 6]>::try_from(bytes).ok());
    let mac = mac.ok_or_else(|| format!("`{text}` is no MAC address such as 02:00:00:00:00:07"))?;
    if mac[0] & 1 == 1 {
        return Err(format!(
            "`{text}` is a group address; the first byte of a station is even"
        ));
    }
    Ok(mac)
}

fn host_name(text: &str) -> Result<HostName, String> {
    HostName::new(text).ok_or_else(|| {
        format!("`{text}` is no host name: write 1 to 32 letters, digits, `-`, `.`, `_`")
    })
}

/// A local MAC address of the slave in this position.
fn local_mac(slave: usize) -> [u8; 6] {
    let [high, low] = u16::try_from(slave).unwrap_or(u16::MAX).to_be_bytes();
    [0x02, 0x54, 0x4B, 0, high, low]
}

impl Addresses {
    /// All up to the last included one, as slaves read them in one of two ways otherwise.
    fn settings(&self, slave: usize) -> IpSettings {
        let none = Ipv4Addr::UNSPECIFIED;
        IpSettings {
            mac: Some(self.mac.unwrap_or_else(|| local_mac(slave))),
            ip: Some(self.ip.ip),
            mask: Some(self.ip.mask()),
            gateway: Some(self.gateway.unwrap_or(none)),
            dns: self.dns.or_else(|| self.name.map(|_| none)),
            name: self.name,
        }
    }

    const fn of(ip: Subnet) -> Self {
        Self {
            ip,
            gateway: None,
            mac: None,
            dns: None,
            name: None,
        }
    }
}

impl Eoe {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let cycle = match &self.action {
            Action::Tunnel(tunnel) => tunnel.cycle,
            Action::Get { .. } | Action::SetIp(_) => REQUEST_CYCLE,
        };
        let mut session = self.target.bring_up(AlState::PreOp, cycle)?;
        let slave = session.find(&self.slave)?;
        session.hold_ethernet(slave, self.target.timeout)?;
        match self.action {
            Action::Get { json } => get(&mut session, slave, self.port, json),
            Action::SetIp(addresses) => {
                let settings = addresses.settings(slave);
                set(&mut session, slave, self.port, &settings)
            }
            Action::Tunnel(tunnel) => tunnel.run(&mut session, slave, self.port),
        }
    }
}

const fn asked(port: u8, request: EoeRequest) -> JobKind {
    JobKind::Ethernet(EthernetJob::Request { port, request })
}

/// Sets addresses; says so, or why not.
fn set<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    port: u8,
    settings: &IpSettings,
) -> anyhow::Result<Verdict> {
    let kind = asked(port, EoeRequest::SetAddress);
    match session.request(slave, kind, settings.encode())? {
        Ok(_) => {
            say(&format!("slave {slave}: {settings}"))?;
            Ok(Verdict::Good)
        }
        Err(why) => Ok(refused(slave, &why)),
    }
}

fn refused(slave: usize, why: &dyn std::fmt::Display) -> Verdict {
    complain(&format!("takt: slave {slave}: {why}"));
    Verdict::Failed
}

fn get<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    port: u8,
    json: bool,
) -> anyhow::Result<Verdict> {
    let kind = asked(port, EoeRequest::GetAddress);
    let bytes = match session.request(slave, kind, Vec::with_capacity(FRAME_MAX))? {
        Ok(bytes) => bytes,
        Err(why) => return Ok(refused(slave, &why)),
    };
    let Some(settings) = IpSettings::decode(&bytes) else {
        return Ok(refused(
            slave,
            &"its addresses are truncated; a fault of its firmware",
        ));
    };
    if json {
        let text = |field: Option<Ipv4Addr>| field.map(|ip| ip.to_string());
        let mac = settings.mac.map(|mac| {
            let bytes: Vec<String> = mac.iter().map(|byte| format!("{byte:02x}")).collect();
            bytes.join(":")
        });
        say(&serde_json::json!({
            "version": 1, "slave": slave, "mac": mac, "ip": text(settings.ip), "mask": text(settings.mask),
            "gateway": text(settings.gateway), "dns": text(settings.dns),
            "name": settings.name.map(|name| name.to_string()),
        })
        .to_string())?;
    } else {
        say(&format!("slave {slave}: {settings}"))?;
    }
    Ok(Verdict::Good)
}

/// What went through a tunnel, as its report.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Traffic {
    version: u32,
    seconds: f64,
    /// Frames and bytes to the slave.
    to_slave: (u64, u64),
    /// Frames and bytes from the slave.
    from_slave: (u64, u64),
    /// Frames of the host that the slave did not accept, and the reason of the last.
    refused: u64,
    reason: Option<String>,
    /// Frames of the slave whose fragments do not fit together, and the cause of the last.
    broken: u64,
    cause: Option<String>,
    /// Frames of the slave that were not fetched in time.
    overflowed: u64,
    /// Frames for the slave in the master.
    #[serde(skip)]
    waiting: u64,
}

impl Traffic {
    /// A frame of the host was sent, or was not.
    fn sent(&mut self, reply: &Reply) {
        self.waiting = self.waiting.saturating_sub(1);
        match &reply.result {
            Ok(()) => {
                self.to_slave.0 += 1;
                self.to_slave.1 += bytes(reply.job.data.len());
            }
            Err(error) => {
                self.refused += 1;
                self.reason = Some(error.to_string());
            }
        }
    }

    fn count(&mut self, counters: EthernetCounters) {
        (self.broken, self.overflowed) = (counters.broken, counters.overflowed);
        self.cause = counters.cause.map(|cause| cause.to_string());
    }

    fn text(&self) -> String {
        #[expect(
            clippy::cast_precision_loss,
            reason = "bytes of a tunnel are far below 2^52"
        )]
        let rate = |bytes: u64| bytes as f64 / self.seconds.max(1e-3) / 1e3;
        let line = |what: &str, (frames, bytes): (u64, u64)| {
            format!(
                "{what}  {frames} frames, {bytes} bytes, {:.1} kB/s",
                rate(bytes)
            )
        };
        let because = |text: &Option<String>| {
            let text = text.as_deref();
            text.map_or_else(String::new, |text| format!(", last: {text}"))
        };
        format!(
            "{}\n{}\ndropped     {} not accepted by the slave{}; {} from the slave with broken fragments{}, {} not fetched \
             in time",
            line("to slave  ", self.to_slave),
            line("from slave", self.from_slave),
            self.refused,
            because(&self.reason),
            self.broken,
            because(&self.cause),
            self.overflowed,
        )
    }
}

impl Tunnel {
    fn run<W: Wire>(
        &self,
        session: &mut Session<W>,
        slave: usize,
        port: u8,
    ) -> anyhow::Result<Verdict> {
        let mut tap = TapLink::open(&self.name)?;
        if let Some(ip) = self.slave_ip {
            let settings = Addresses::of(ip).settings(slave);
            if set(session, slave, port, &settings)? == Verdict::Failed {
                return Ok(Verdict::Failed);
            }
        }
        if let Some(host) = self.host_ip {
            configure(&self.name, host)?;
        }
        let name = &self.name;
        let rate = limit(session, slave);
        say(&format!(
            "slave {slave} is at {name}, at most {rate} kB/s each way; Ctrl-C ends it"
        ))?;
        if self.host_ip.is_none() {
            say(&format!(
                "hint: ip addr add 192.168.7.1/24 dev {name} && ip link set {name} up"
            ))?;
        }
        let stop = Stop::listen()?;
        let begin = session.now()?;
        let mut traffic = Traffic {
            version: 1,
            ..Traffic::default()
        };
        let ended = loop {
            if let Err(why) = carry(session, slave, port, &mut tap, &mut traffic)? {
                break Some(why);
            }
            let passed = session.now()?.saturating_sub(begin);
            traffic.seconds = passed.as_secs_f64();
            if stop.requests() > 0 || self.duration.is_some_and(|most| passed >= most) {
                break None;
            }
        };
        if self.json {
            say(&serde_json::to_string(&traffic)?)?;
        } else {
            say(&traffic.text())?;
        }
        Ok(match ended {
            None => Verdict::Good,
            Some(why) => refused(slave, &why),
        })
    }
}

/// Brings the interface up with an address.
fn configure(name: &str, host: Subnet) -> anyhow::Result<()> {
    let Subnet { ip, bits } = host;
    let address = format!("{ip}/{bits}");
    for arguments in [
        &["addr", "add", &address, "dev", name][..],
        &["link", "set", name, "up"],
    ] {
        let text = format!("ip {}", arguments.join(" "));
        let output = Command::new("ip")
            .args(arguments)
            .output()
            .with_context(|| {
                format!("cannot run `{text}`\nhint: install iproute2, or leave --host-ip out")
            })?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "`{text}`: {}", errors.trim());
    }
    Ok(())
}

/// Bytes that the mailbox carries each way, kB/s: each message takes a cycle to write or read, and one to poll.
fn limit<W: Wire>(session: &Session<W>, slave: usize) -> u64 {
    let master = session.master();
    let len = master
        .slave(slave)
        .map_or(0, |slave| slave.info().mailbox.receive_len);
    let data = usize::from(len).saturating_sub(10) / UNIT * UNIT;
    let cycle = master.config().cycle.as_micros().max(1);
    u64::try_from(data).unwrap_or(0) * 1000 / 2 / u64::try_from(cycle).unwrap_or(1)
}

/// Frames for the slave that wait in the master.
const WAITING_MAX: u64 = 4;
/// Shortest Ethernet frame without checksum, bytes.
const PADDED: usize = 60;

/// One cycle of a tunnel; the inner error ends it.
pub(super) fn carry<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    port: u8,
    tap: &mut impl Link,
    traffic: &mut Traffic,
) -> anyhow::Result<Result<(), String>> {
    let mut frame = [0; FRAME_MAX + 1];
    // A full queue leaves frames in the interface, which drops and counts what does not fit.
    while traffic.waiting < WAITING_MAX
        && let Some((len, _)) = tap.receive(&mut frame, Duration::ZERO)?
    {
        let data = frame.get(..len).unwrap_or_default();
        let mut data = data.to_vec();
        data.resize(len.max(PADDED), 0);
        let job = Job {
            slave,
            kind: JobKind::Ethernet(EthernetJob::Send { port }),
            data,
            token: 0,
        };
        traffic.waiting += 1;
        if let Err(refused) = session.master_mut().submit(job) {
            traffic.sent(&refused);
        }
    }
    session.cycle()?;
    while let Some(reply) = session.master_mut().poll_reply() {
        traffic.sent(&reply);
    }
    while let Some(len) = session.master_mut().poll_ethernet(slave, &mut frame) {
        traffic.from_slave.0 += 1;
        traffic.from_slave.1 += bytes(len);
        tap.send(frame.get(..len).unwrap_or_default())?;
    }
    let view = session.master().slave(slave);
    if let Some(counters) = view.and_then(|view| view.ethernet()) {
        traffic.count(counters);
    }
    let fault = view.and_then(|view| view.fault());
    Ok(fault.map_or(Ok(()), |fault| Err(fault.to_string())))
}

fn bytes(len: usize) -> u64 {
    u64::try_from(len).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
