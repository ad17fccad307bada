//! Serves an emulated segment at a network interface, for any EtherCAT master at the other end of
//! its cable. It ends when its standard input does.
//!
//! ```console
//! # ip link add near type veth peer name far && ip link set near up && ip link set far up
//! # cargo run --example emulated_segment near
//! ```
//! The master then works on `far`.

#[cfg(target_os = "linux")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    use std::os::fd::AsFd as _;
    use std::time::Duration;

    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    use takt_ethercat::emulator::{
        Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
    };
    use takt_ethercat::linux::{PacketLink, monotonic};

    let interface = std::env::args().nth(1);
    let interface = interface.ok_or("name the interface to serve")?;
    let (digital, io) = Io::digital(8, 8);
    let (analogue, channels) = Io::analogue(1, 1);
    let servo = |drift_ppb| {
        let mut config = ServoConfig {
            clock: (0, drift_ppb),
            ..ServoConfig::default()
        };
        // Masters that are not real-time miss SYNC0 now and then.
        config.axes[0].quirks.missing_set_points = None;
        ServoDrive::slave(config)
    };
    let (first, _) = servo(20_000)?;
    let (second, _) = servo(-30_000)?;
    let segment = Segment::line([Coupler::slave(), digital, analogue, first, second]);
    let link = PacketLink::open(&interface)?;
    let mut server = Server::new(SharedSegment::new(segment), link);
    let input = std::io::stdin();
    loop {
        server.turn(Duration::from_millis(10), &mut monotonic)?;
        // Outputs of the master are returned as inputs.
        io.set_inputs(&io.outputs());
        channels.set_inputs(&channels.outputs());
        let mut ended = [PollFd::new(input.as_fd(), PollFlags::POLLIN)];
        if poll(&mut ended, PollTimeout::ZERO)? > 0 {
            return Ok(());
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn main() {}
