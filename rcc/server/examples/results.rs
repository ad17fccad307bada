//! How soon a Boolean result of a net reaches a client, beside the round trip of a request in the same run: a client
//! writes a value, and a net answers in its next cycle, by a Boolean and by a number. Last, what it costs the net thread
//! to wake the thread that takes its reports.
//!
//! ```console
//! $ cargo run --release -p takt-server --example results -- [RUNS]
//! ```

#![expect(clippy::print_stdout, reason = "a table is all that it makes")]

use std::error::Error;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_client::{Client, Message, Value};
use takt_core::executor::report::Notifier;
use takt_core::{CellConfig, Controller};
use takt_server::{Server, ServerConfig};

/// Answers `inask` and `innumber` by `outanswer` and `outecho`.
const NET: &str = "{i=Core::BooleanNetcommIn(Key='ask',Value='false'),\
    o=Core::BooleanNetcommOut(inValue=i.outValue,Key='answer'),\
    j=Core::DoubleNetcommIn(Key='number',Value='0'),\
    e=Core::DoubleNetcommOut(inValue=j.outValue,Key='echo'),\
    x=Cancel(),outTerminate=x.outCancel}";

/// Longer than values keep back a second change.
const PAUSE: Duration = Duration::from_millis(23);

const TIMEOUT: Duration = Duration::from_secs(5);

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let runs = std::env::args().nth(1);
    let runs = runs.map_or(Ok(200), |runs| runs.parse::<u32>())?;
    let controller = Controller::start(&CellConfig::default())?;
    let period = controller.period();
    let server = Server::bind(ServerConfig {
        tcp: Some(SocketAddr::from(([127, 0, 0, 1], 0))),
        ..ServerConfig::default()
    })
    .await?;
    let address = server.tcp_address().ok_or("no address")?.to_string();
    tokio::spawn(server.run(controller, std::future::pending()));
    let measured = tokio::task::spawn_blocking(move || measure(&address, runs));
    let [trip, boolean, number] = measured.await?.map_err(|error| error.to_string())?;
    let wake = wake(runs);
    println!("period {period:?}; {runs} runs");
    println!("                                  p50         p99    p50 / round trip");
    for (name, times) in [
        ("round trip of a request", &trip),
        ("Boolean at the client", &boolean),
        ("number at the client", &number),
        ("wake, in the net thread", &wake),
    ] {
        let [p50, p99] = [50, 99].map(|percent| part(times, percent).as_secs_f64() * 1e3);
        let ratio = p50 / (part(&trip, 50).as_secs_f64() * 1e3);
        println!("{name:28} {p50:8.3} ms {p99:8.3} ms {ratio:10.2}");
    }
    let beyond = part(&boolean, 50).saturating_sub(part(&trip, 50));
    println!(
        "a Boolean takes {:.2} periods beyond the round trip (p50)",
        beyond.as_secs_f64() / period.as_secs_f64()
    );
    Ok(())
}

/// Sorted times of a request, of a Boolean and of a number.
fn measure(address: &str, runs: u32) -> Result<[Vec<Duration>; 3], Box<dyn Error + Send + Sync>> {
    let client = Client::connect(address)?;
    let arguments = [
        Value::from(NET),
        "".into(),
        "results".into(),
        0.0.into(),
        Value::Integer(1),
        0.05.into(),
        "every".into(),
    ];
    let net = client.call("nene", arguments)?;
    let net = net.text().ok_or("no net")?.to_owned();
    client.call("nest", [net.as_str()])?;
    let mut times: [Vec<Duration>; 3] = Default::default();
    for run in 0..runs {
        let begin = Instant::now();
        client.call("snc", [Value::map_of::<&str, Value>([])])?;
        times[0].push(begin.elapsed());
        let truth = run.is_multiple_of(2).to_string();
        times[1].push(answered(&client, &net, ["inask", "outanswer"], &truth)?);
        let echo = (run + 1).to_string();
        times[2].push(answered(&client, &net, ["innumber", "outecho"], &echo)?);
    }
    times.iter_mut().for_each(|times| times.sort_unstable());
    Ok(times)
}

/// From writing a value until the answer is received.
fn answered(
    client: &Client,
    net: &str,
    [key, answer]: [&str; 2],
    text: &str,
) -> Result<Duration, Box<dyn Error + Send + Sync>> {
    std::thread::sleep(PAUSE);
    while client.next_push(Duration::ZERO)?.is_some() {}
    let begin = Instant::now();
    let values = Value::map_of([(key, Value::from(text))]);
    client.call("snc", [Value::map_of([(net, values)])])?;
    while begin.elapsed() < TIMEOUT {
        let push = client.next_push(TIMEOUT)?;
        if push.is_some_and(|push| is_answer(&push, answer, text)) {
            return Ok(begin.elapsed());
        }
    }
    Err(format!("{answer} did not become {text}").into())
}

fn is_answer(push: &Message, key: &str, text: &str) -> bool {
    let values = push.args.first().and_then(Value::as_map);
    let value = values.and_then(|values| values.get(key));
    value.and_then(Value::as_str) == Some(text)
}

/// Sorted times of waking a thread that waits.
fn wake(runs: u32) -> Vec<Duration> {
    let (notifier, ended) = (
        Arc::new(Notifier::default()),
        Arc::new(AtomicBool::new(false)),
    );
    let (waits, ends) = (Arc::clone(&notifier), Arc::clone(&ended));
    let receiver = std::thread::spawn(move || {
        waits.attach();
        while !ends.load(Ordering::Relaxed) {
            waits.wait(TIMEOUT);
            waits.take();
        }
    });
    let wake = |_| {
        std::thread::sleep(Duration::from_millis(1));
        let begin = Instant::now();
        notifier.notify(true);
        begin.elapsed()
    };
    let mut times: Vec<_> = (0..runs).map(wake).collect();
    ended.store(true, Ordering::Relaxed);
    notifier.notify(false);
    drop(receiver.join());
    times.sort_unstable();
    times
}

fn part(times: &[Duration], percent: usize) -> Duration {
    let at = times.len().saturating_sub(1) * percent / 100;
    times.get(at).copied().unwrap_or_default()
}
