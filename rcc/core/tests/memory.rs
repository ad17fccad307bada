//! A controller with little memory: alone in its process, as the limit applies to the whole process.

use nix::sys::resource::{Resource, setrlimit};
use takt_core::controller::{LoadRequest, NetState};
use takt_core::{CellConfig, Controller, Error, SessionId};

fn request(text: String) -> LoadRequest {
    LoadRequest {
        text,
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    }
}

#[test]
fn net_beyond_host_memory_is_rejected() {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    let controller = Controller::start(&cell).unwrap();
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let size = status.lines().find_map(|line| line.strip_prefix("VmSize:"));
    let kib: u64 = size.unwrap().trim_end_matches("kB").trim().parse().unwrap();
    let limit = (kib << 10) + (200 << 20);
    setrlimit(Resource::RLIMIT_AS, limit, limit).unwrap();
    let shortage = takt_core::memory::shortage(1024).unwrap();
    assert!(shortage.contains("nets_memory_mib = "), "{shortage}");
    // Reading it would need far more memory than there is and end the process.
    let mut text = String::with_capacity(8 << 20);
    text.push_str("{x=Cancel(),outTerminate=x.outCancel");
    let mut number = 0;
    while text.len() < (7 << 20) {
        text.push_str(&format!(",c{number}=Core::Clock()"));
        number += 1;
    }
    text.push('}');
    let refused = controller.load(request(text)).unwrap_err();
    assert!(matches!(refused, Error::HostMemory { .. }), "{refused}");
    assert!(
        refused.to_string().contains("hint: unload nets"),
        "{refused}"
    );
    let small = "{x=Cancel(),outTerminate=x.outCancel}".to_owned();
    let small = controller.load(request(small)).unwrap();
    assert_eq!(controller.net(small).unwrap().state(), NetState::Ready);
}
