//! A flood of connections, for tests and figures of what must get through it.

use std::io::Write as _;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Silent connections that take all connection slots of a server, and clients that send nonsense until this is
/// dropped.
pub(crate) struct Flood {
    ending: Arc<AtomicBool>,
    threads: Vec<std::thread::JoinHandle<()>>,
    _silent: Vec<TcpStream>,
}

impl Flood {
    /// Floods these addresses.
    pub(crate) fn start(addresses: &[String]) -> Self {
        let connect = |i: usize| TcpStream::connect(&addresses[i % addresses.len()]).unwrap();
        let silent: Vec<_> = (0..80).map(connect).collect();
        let ending = Arc::new(AtomicBool::new(false));
        let knock = |address: &String| {
            let (address, ending) = (address.clone(), Arc::clone(&ending));
            std::thread::spawn(move || {
                while !ending.load(Ordering::Relaxed) {
                    let stream = TcpStream::connect(&address);
                    // The server may have closed it already.
                    let _ = stream.and_then(|mut stream| stream.write_all(&[b'x'; 4096]));
                }
            })
        };
        let threads = addresses.iter().cycle().take(4).map(knock).collect();
        Self {
            ending,
            threads,
            _silent: silent,
        }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            thread.join().unwrap();
        }
    }
}
