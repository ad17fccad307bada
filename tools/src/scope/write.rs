//! A scope without a screen: samples go to files, figures and what is lost are printed at the end.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context as _;

use super::csv::Csv;
use super::figures::Figures;
use super::mcap::Mcap;
use super::source::Source;
use super::store::Store;
use super::wire::{Event, Mode, Request, Setup};
use super::{Scope, names, svg};
use crate::Verdict;
use crate::http::Http;
use crate::output::{complain, save, say};
use crate::signal::Stop;

/// How often the end is looked for while nothing comes.
const TICK: Duration = Duration::from_millis(100);

/// After the post-trigger time of a single capture it is complete within this time.
const CAPTURE_TIMEOUT: Duration = Duration::from_secs(5);

/// The files.
#[derive(Default)]
struct Files {
    csv: Option<Csv<Box<dyn Write>>>,
    mcap: Option<Mcap<BufWriter<File>>>,
}

impl Files {
    fn open(scope: &Scope, setup: &Setup) -> anyhow::Result<Self> {
        let named = |path: &Path| format!("cannot write {}", path.display());
        let csv = match &scope.csv {
            None => None,
            Some(path) => {
                let out: Box<dyn Write> = if path.as_os_str() == "-" {
                    Box::new(Output)
                } else {
                    let file = File::create(path).with_context(|| named(path))?;
                    Box::new(BufWriter::new(file))
                };
                Some(Csv::begin(out, setup, scope.trigger.is_some())?)
            }
        };
        let mcap = match &scope.mcap {
            None => None,
            Some(path) => {
                let file = File::create(path).with_context(|| named(path))?;
                Some(Mcap::begin(BufWriter::new(file), setup)?)
            }
        };
        Ok(Self { csv, mcap })
    }

    fn handle(&mut self, event: &Event) -> anyhow::Result<()> {
        match (event, &mut self.csv) {
            (Event::Frame(frame), Some(csv)) => csv.add(frame)?,
            (Event::Triggered(triggered), Some(csv)) => csv.trigger(triggered)?,
            _ => {}
        }
        if let (Event::Frame(frame), Some(mcap)) = (event, &mut self.mcap) {
            mcap.add(frame)?;
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        if let Some(mut csv) = self.csv {
            csv.flush()?;
        }
        match self.mcap {
            Some(mcap) => mcap.finish(),
            None => Ok(()),
        }
    }
}

/// Standard output; that nothing reads it is an error of its own.
struct Output;

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        io::stdout().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stdout().flush()
    }
}

/// What a run gave.
#[derive(Default)]
struct Run {
    figures: Figures,
    store: Store,
    files: Option<Files>,
}

/// Why a run is over.
enum End {
    /// By its time, its capture or a signal.
    Done,
    /// The controller cannot do it.
    Refused(String),
    /// No controller, or none any more.
    Closed(String),
}

pub(super) fn write(
    scope: &Scope,
    address: &str,
    http: Http,
    request: Request,
) -> anyhow::Result<Verdict> {
    let stop = Stop::listen()?;
    let begin = Instant::now();
    let mut run = Run::default();
    let is_single = request.trigger.is_some() && request.mode == Mode::Single;
    let source = Source::start(http.clone(), request, false);
    let mut capture_until: Option<Instant> = None;
    let end = loop {
        let is_over = scope.duration.is_some_and(|span| begin.elapsed() >= span);
        let is_late = capture_until.is_some_and(|until| Instant::now() >= until);
        if stop.is_requested() || is_over || is_late {
            break End::Done;
        }
        let Some(event) = source.next(TICK) else {
            continue;
        };
        if let Event::Triggered(_) = &event {
            capture_until = is_single.then(|| Instant::now() + scope.post + CAPTURE_TIMEOUT);
        }
        if let Some(end) = run.handle(scope, &http, event)? {
            break end;
        }
    };
    drop(source);
    run.report(scope, address, end)
}

impl Run {
    /// Takes an event; gives why nothing follows, if nothing does.
    fn handle(&mut self, scope: &Scope, http: &Http, event: Event) -> anyhow::Result<Option<End>> {
        match &event {
            Event::Setup(setup) => {
                for rejected in &setup.rejected {
                    complain(&names::explain(http, rejected));
                }
                if !setup.rejected.is_empty() {
                    return Ok(Some(End::Refused(String::new())));
                }
                self.figures.begin(setup);
                self.files = Some(Files::open(scope, setup)?);
            }
            Event::Triggered(triggered) => {
                self.figures.captures += 1;
                let time = triggered.time_s;
                complain(&format!("triggered at {time:.6} s: {}", triggered.cause));
            }
            Event::Ended(ended) => complain(&format!("{}: {}", ended.probe, ended.cause)),
            Event::Lost { samples, .. } => {
                self.figures.lost = self.figures.lost.saturating_add(*samples);
            }
            Event::Done => return Ok(Some(End::Done)),
            Event::Refused(why) => return Ok(Some(End::Refused(why.clone()))),
            Event::Closed(why) => return Ok(Some(End::Closed(why.clone()))),
            Event::Frame(frame) => self.figures.add(frame),
        }
        if scope.svg.is_some() {
            self.store.handle(&event);
        }
        if let Some(files) = &mut self.files {
            files.handle(&event)?;
        }
        Ok(None)
    }

    /// Completes the files and prints the figures, whatever the end was.
    fn report(mut self, scope: &Scope, address: &str, end: End) -> anyhow::Result<Verdict> {
        let is_begun = self.files.is_some();
        if let Some(files) = self.files.take() {
            files.finish()?;
        }
        if let (Some(path), true) = (&scope.svg, is_begun) {
            save(path, svg::svg(&self.store)?)?;
        }
        let is_output = scope.csv.as_ref().is_some_and(|it| it.as_os_str() == "-");
        if is_begun && scope.json {
            say(&self.figures.json().to_string())?;
        } else if is_begun && !is_output {
            let (span, lost) = (self.figures.span_s(), self.figures.lost);
            say(&format!("{address}: {span:.3} s, {lost} samples lost"))?;
            say(self.figures.text().trim_end())?;
        }
        if self.figures.lost > 0 {
            let lost = self.figures.lost;
            complain(&format!(
                "WARN  {lost} samples were lost: this program or its disk was slow\nhint: fewer probes, or a larger --every"
            ));
        }
        match end {
            End::Refused(why) => {
                if !why.is_empty() {
                    complain(&why);
                }
                Ok(Verdict::Failed)
            }
            End::Closed(why) => Err(anyhow::anyhow!("{why}")),
            End::Done if scope.trigger.is_some() && self.figures.captures == 0 => {
                complain("no trigger was found\nhint: see the values without --trigger");
                Ok(Verdict::Failed)
            }
            End::Done => Ok(Verdict::Good),
        }
    }
}
