//! The flight recorder of a controller: what its files are written from, requests, and the list of files.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::controller::Controller;
use crate::controller::flight_recorder::{
    Answer, Bursts, FlightCounts, FlightInfo, FlightRecorder, FlightSettings, Trigger,
};
use crate::controller::registry::Registry;
use crate::error::Error;
use crate::executor::thread::NetThread;
use crate::ids::NetId;
use crate::record::FlightLog;
use crate::record::flight::{FlightDevice, FlightNet, Sources};

impl Controller {
    /// Writes flight files from now on: on a fault of a device, a failure of a net, a burst of overruns, and by
    /// [`Self::request_flight`]. Returns where lines of the log are kept for them.
    ///
    /// # Errors
    /// If the directory cannot be created or written, its thread cannot be started, or there is a flight recorder already.
    pub fn record_flights(&self, settings: FlightSettings) -> Result<FlightLog, Error> {
        let path = settings.directory.clone();
        let flights = FlightRecorder::new(settings)?;
        let log = flights.log();
        let mut registry = self.inner.lock();
        if registry.flights.is_some() {
            let why = "the controller has a flight recorder already".to_owned();
            return Err(Error::Recording { path, why });
        }
        registry.flights = Some(flights.clone());
        registry.nets.keep_past();
        let threads = registry.threads.iter();
        let mut bursts: Vec<_> = threads
            .map(|thread| (thread.period, thread.stats.clone(), Bursts::default()))
            .collect();
        drop(registry);
        let inner = Arc::clone(&self.inner);
        let poll = {
            let flights = flights.clone();
            move || {
                for (period, stats, bursts) in &mut bursts {
                    if let Some(missed) = bursts.poll(stats.overruns()) {
                        report_burst(&flights, *period, missed);
                    }
                }
            }
        };
        let kept = log.clone();
        self._life.spawn("takt-flight", move || {
            flights.run(
                || inner.lock().flight_sources(kept.clone()),
                |_| inner.lock().flight_texts(),
                poll,
            );
        })?;
        Ok(log)
    }

    /// Writes a flight file of the last ten seconds and the second that follows; returns its path. It is complete a second
    /// later.
    ///
    /// # Errors
    /// If there is no flight recorder.
    pub fn request_flight(&self, by: &str) -> Result<PathBuf, Error> {
        let flights = self.inner.lock().flights.clone();
        let off = || {
            Error::Recording {
            path: "flight recorder".into(),
            why: "it is off\nhint: set flight_recorder under [controller] of cell.toml to a directory".to_owned(),
        }
        };
        match flights
            .ok_or_else(off)?
            .trigger(Trigger::Request, "request", by)
        {
            Answer::Written(path) => Ok(path),
            // Requests have no limit.
            Answer::Limited(_) => Err(off()),
        }
    }

    /// The directory of flight files; `None` if there is no flight recorder.
    #[must_use]
    pub fn flight_directory(&self) -> Option<PathBuf> {
        let flights = self.inner.lock().flights.clone();
        flights.map(|flights| flights.directory().to_owned())
    }

    /// The flight files, oldest first; those of other runs in the same directory included.
    #[must_use]
    pub fn flights(&self) -> Vec<FlightInfo> {
        let flights = self.inner.lock().flights.clone();
        flights.map_or_else(Vec::new, |flights| flights.files())
    }

    /// What became of the triggers of the flight recorder; `None` if there is none.
    #[must_use]
    pub fn flight_counts(&self) -> Option<FlightCounts> {
        let flights = self.inner.lock().flights.clone();
        Some(flights?.counts())
    }

    /// Bytes of memory in which the flight recorder keeps the last seconds.
    #[must_use]
    pub fn flight_memory(&self) -> usize {
        let registry = self.inner.lock();
        let devices = registry.devices.table.all();
        let devices = devices.filter_map(|(_, device)| Some(device.flight.get()?.bytes()));
        let nets = registry.threads.iter().map(|thread| thread.rings().bytes());
        devices.chain(nets).sum()
    }
}

fn report_burst(flights: &FlightRecorder, period: Duration, missed: u64) {
    let cause = format!("the net thread of {period:?} missed {missed} cycles within a second");
    if let answer @ Answer::Written(_) = flights.trigger(Trigger::Overruns, "overruns", &cause) {
        let file = answer.line();
        tracing::warn!("{cause}{file}\nhint: takt doctor; takt jitter");
    }
}

impl Registry {
    fn flight_sources(&self, log: FlightLog) -> Sources {
        let devices = self
            .devices
            .table
            .all()
            .map(|(number, device)| FlightDevice {
                number,
                device: Arc::clone(device),
            });
        let machines = self.machines.that_ran();
        Sources {
            devices: devices.collect(),
            threads: self.threads.iter().map(NetThread::rings).collect(),
            machines: machines
                .map(|(id, program, _)| (id, Arc::clone(program)))
                .collect(),
            nets: self.nets.that_ran(),
            frames: self.devices.frames.clone(),
            log,
        }
    }

    /// Texts of the nets that ran and of the machines, by name.
    fn flight_texts(&self) -> Vec<(String, Arc<str>)> {
        let nets = self.nets.that_ran().into_iter();
        let nets = nets.map(|FlightNet { id, text, .. }| (format!("nets/{}.net", NetId(id)), text));
        nets.chain(self.machines.texts()).collect()
    }
}
