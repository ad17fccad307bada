//! Masters against slaves that answer as real devices do: ethercrab and ours here, the others by their scripts. The
//! emulator defines the behaviour of the devices.

use std::time::{Duration, Instant};

use ethercrab::error::Error;
use ethercrab::std::ethercat_now;
use ethercrab::{DcSync, MainDevice};
use takt_cia402::dictionary::{Address, Mapped};
use takt_ethercat::config::{Location, MasterConfig, PdoSpec, SlaveSpec, SyncSpec};
use takt_ethercat::emulator::Profile;
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::{Event, Master};

use crate::crab::{IMAGE, SLAVES, client, into_op, start};

const CYCLE: Duration = Duration::from_millis(4);
/// Working counter of the usual line, by LRW: EL1004 1, EL2004 and EL2889 2, EL3004 1, AKD 3.
const COUNTER: u16 = 9;

pub(crate) fn crab(interface: &str) {
    client::block_on(run(start(interface))).unwrap();
}

async fn run(main: &MainDevice<'_>) -> Result<(), Error> {
    let mut group = main
        .init_single_group::<SLAVES, IMAGE>(ethercat_now)
        .await?;
    let names: Vec<_> = group.iter(main).map(|s| s.name().to_owned()).collect();
    assert_eq!(
        names,
        ["EK1100", "EL1004", "EL2004", "EL2889", "EL3004", "AKD"]
    );
    for mut slave in group.iter_mut(main).filter(|slave| slave.name() == "AKD") {
        slave.sdo_write(0x10F1, 2, 1000_u16).await?;
        slave.sdo_write_array(0x1C12, &[0x1600_u16, 0x1601]).await?;
        slave.sdo_write_array(0x1C13, &[0x1A00_u16, 0x1A01]).await?;
        slave.set_dc_sync(DcSync::Sync0);
    }
    let group = into_op(main, group).await?;
    let mut right = 0;
    for _ in 0..200 {
        let response = group.tx_rx_dc(main).await?;
        right += u32::from(response.working_counter == COUNTER);
        std::thread::sleep(response.extra.next_cycle_wait);
    }
    // The drive has inputs from its first SYNC0 on.
    assert!(right >= 100, "{right} of 200");
    Ok(())
}

fn drive() -> SlaveSpec {
    let pdo = |index, objects: [(u16, u8); 2]| {
        let entries = objects.map(|(index, bits)| Mapped {
            address: Address::new(index, 0),
            bits,
        });
        Some(vec![PdoSpec {
            index,
            entries: entries.to_vec(),
        }])
    };
    SlaveSpec {
        outputs: pdo(0x1600, [(0x6040, 16), (0x607A, 32)]),
        inputs: pdo(0x1A00, [(0x6041, 16), (0x6064, 32)]),
        sync: Some(SyncSpec::sync0(CYCLE)),
        ..SlaveSpec::new("drive", Location::Position(5))
    }
}

/// Brings the usual line to OP over a packet socket, as a driver does.
pub(crate) fn ours(interface: &str) {
    let link = PacketLink::open(interface).unwrap();
    let mac = link.mac();
    let mut port = Port::new(link, mac);
    let terminal = |position| SlaveSpec::new(format!("{position}"), Location::Position(position));
    let mut slaves: Vec<_> = (0..5).map(terminal).collect();
    slaves.push(drive());
    let mut master = Master::new(MasterConfig {
        cycle: CYCLE,
        slaves,
        ..MasterConfig::default()
    })
    .unwrap();
    let mut frame = [0; 1500];
    let mut faults = Vec::new();
    let begin = Instant::now();
    while !master.is_operational() {
        let now = monotonic().unwrap();
        if let Some(len) = master.poll_transmit(now, &mut frame) {
            port.send(&frame[..len]).unwrap();
            while let Some((bytes, at)) = port.receive(Duration::from_millis(200)).unwrap() {
                if master.handle_frame(0, bytes, at) {
                    break;
                }
            }
        }
        while let Some(event) = master.poll_event() {
            if let Event::Fault { .. } = event {
                faults.push(event.to_string());
            }
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "{faults:?}");
        if master.is_exchanging() {
            std::thread::sleep(CYCLE);
        }
    }
    // The duration is printed but not checked: this host may be busy.
    #[expect(clippy::print_stderr, reason = "a figure for those who ask for it")]
    {
        eprintln!("in OP after {:?}", begin.elapsed());
    }
    assert_eq!(faults, Vec::<String>::new());
    assert_eq!(master.reference(), Some(0));
}

/// The devices for the peers.
pub(crate) const KICKCAT: [Profile; 5] = [
    Profile::Ek1100,
    Profile::El1004,
    Profile::El2004,
    Profile::El3004,
    Profile::Lan9252,
];
