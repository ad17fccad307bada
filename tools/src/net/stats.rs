//! `takt net stats`: what the evaluation of nets costs. It measures nothing; the controller does, all
//! the time.

use clap::Args;

use super::Server;
use crate::Verdict;
use crate::client::NetFigures;
use crate::output::{complain, say};

/// Show what the evaluation of nets costs.
///
/// Each line is a net: its period, the period of the thread that evaluates it, the cycles it was
/// evaluated in, how many of these ended too late (LATE) or took the net longer than its budget (OVER),
/// the mean and longest time it took, and what its primitives declare to take at most (DECLARED). DECLARED is a sum of
/// figures for admission, not a measurement of this net: of the host of the developers, or of this one if `costs` of the
/// cell names a table, which `takt net calibrate --output costs.toml` writes while the controller is stopped.
/// A net that takes longer than a period of its thread ten times in a row is ended.
#[derive(Debug, Args)]
pub(crate) struct Stats {
    /// One net, such as rpinet0; all without it.
    net: Option<String>,
    /// Print one JSON array; times in ms.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

impl Stats {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let nets = self.server.connect()?.figures(self.net.as_deref())?;
        if self.json {
            let nets: Vec<_> = nets.iter().map(json).collect();
            say(&serde_json::Value::from(nets).to_string())?;
            return Ok(Verdict::Good);
        }
        if let (Some(net), true) = (&self.net, nets.is_empty()) {
            complain(&format!("{net} was rejected and has no figures"));
            return Ok(Verdict::Failed);
        }
        if nets.is_empty() {
            say("no nets")?;
            return Ok(Verdict::Good);
        }
        say(HEAD)?;
        for net in &nets {
            say(&line(net))?;
        }
        if let Some(contradiction) = contradiction(&nets) {
            complain(&contradiction);
        }
        Ok(Verdict::Good)
    }
}

const HEAD: &str =
    "NET          PERIOD  THREAD     CYCLES    LATE    OVER      MEAN       MAX  DECLARED";

/// Says that declared costs are not those of this host, if a net takes longer on average than it declares at most.
fn contradiction(nets: &[NetFigures]) -> Option<String> {
    let exceeds = |net: &&NetFigures| net.get("cycles") > 0.0 && net.get("mean") > net.get("cost");
    let slower: Vec<_> = nets.iter().filter(exceeds).map(|net| &*net.id).collect();
    (!slower.is_empty()).then(|| {
        format!(
            "warning: {} take longer on average than declared: declared costs are not those of this host, and the \
             admission of nets relies on them\nhint: `takt net calibrate`, then name its table as `costs` under [controller]",
            slower.join(", ")
        )
    })
}

fn line(net: &NetFigures) -> String {
    let count = |name| format!("{:.0}", net.get(name));
    // Periods as they are, times to a tenth of a microsecond.
    let [period, thread] = ["period", "thread"].map(|name| format!("{}ms", net.get(name)));
    let [mean, max, cost] = ["mean", "max", "cost"].map(|name| {
        let us = net.get(name) * 1e3;
        format!("{us:.1}us")
    });
    format!(
        "{:<11} {period:>7} {thread:>7} {:>10} {:>7} {:>7} {mean:>9} {max:>9} {cost:>9}",
        net.id,
        count("cycles"),
        count("overruns"),
        count("overbudget"),
    )
}

fn json(net: &NetFigures) -> serde_json::Value {
    let mut figures = serde_json::Map::new();
    figures.insert("net".to_owned(), net.id.as_str().into());
    for (name, figure) in &net.figures {
        figures.insert(name.clone(), (*figure).into());
    }
    figures.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_stand_below_their_heads() {
        let figures = [
            ("period", 1.0),
            ("thread", 0.25),
            ("cycles", 123_456.0),
            ("overruns", 2.0),
            ("overbudget", 1.0),
            ("mean", 0.012_345),
            ("max", 0.9),
            ("cost", 0.04),
        ];
        let figures = figures.map(|(name, figure)| (name.to_owned(), figure));
        let net = NetFigures {
            id: "rpinet12".to_owned(),
            figures: figures.into(),
        };
        let line = line(&net);
        assert_eq!(line.len(), HEAD.len());
        let fields: Vec<_> = line.split_whitespace().collect();
        assert_eq!(contradiction(&[net]), None);
        let expected = "rpinet12 1ms 0.25ms 123456 2 1 12.3us 900.0us 40.0us";
        assert_eq!(fields.join(" "), expected);
    }

    #[test]
    fn mean_above_declared_cost_is_a_contradiction() {
        let net = |id: &str, mean: f64| NetFigures {
            id: id.to_owned(),
            figures: [("cycles", 9.0), ("mean", mean), ("cost", 0.001)]
                .map(|(name, figure)| (name.to_owned(), figure))
                .into(),
        };
        let text = contradiction(&[net("rpinet0", 0.0009), net("rpinet1", 0.002)]).unwrap();
        assert!(text.starts_with("warning: rpinet1 take longer"), "{text}");
        assert!(text.contains("\nhint: `takt net calibrate`"), "{text}");
    }
}
