//! What users of ethercrab, an independent master, need around it: a future run to its end without a runtime, and a
//! main device at an interface whose thread for the socket lives as long as the program. It drives no slave.

use std::future::Future;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Wake, Waker};
use std::thread::{self, Thread};
use std::time::Duration;

use ethercrab::std::tx_rx_task;
use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};

type Storage = PduStorage<16, { PduStorage::element_size(1100) }>;

/// Wakes a thread.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// Runs a future to its end on this thread.
pub(crate) fn block_on<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let waker = Waker::from(Arc::new(Unpark(thread::current())));
    let mut context = Context::from_waker(&waker);
    loop {
        match future.as_mut().poll(&mut context) {
            Poll::Ready(value) => return value,
            Poll::Pending => thread::park(),
        }
    }
}

/// A main device at an interface, with time-outs for a busy host. It and its frames live as long as the program, as
/// ethercrab asks for, so that the tests of one process may each start one.
pub(crate) fn start(
    interface: &str,
    config: MainDeviceConfig,
) -> io::Result<&'static MainDevice<'static>> {
    let storage: &'static Storage = Box::leak(Box::new(Storage::new()));
    let split = storage.try_split();
    let (tx, rx, pdus) = split.map_err(|()| io::Error::other("its storage is taken"))?;
    let timeouts = Timeouts {
        pdu: Duration::from_millis(500),
        state_transition: Duration::from_secs(10),
        eeprom: Duration::from_secs(2),
        ..Timeouts::default()
    };
    let main = Box::leak(Box::new(MainDevice::new(pdus, timeouts, config)));
    let task = tx_rx_task(interface, tx, rx)?;
    thread::spawn(move || block_on(task).map(|_| ()));
    Ok(main)
}
