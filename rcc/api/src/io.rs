//! Digital and analogue inputs and outputs of a device: inputs are expressions, outputs are set by activities. Each
//! output is a device of its own, so that outputs do not wait for each other. An output stays as it is set.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use crate::activity::Activity;
use crate::description::{Descriptions, Interface};
use crate::engine::Failure;
use crate::error::{Error, ErrorKind};
use crate::expression::{Condition, Number};
use crate::net::{Net, Port};
use crate::order::{Operation, Ports, Requests, Speed};
use crate::session::Session;

/// How long a device has to report an output as set, s.
const REPORT_S: f64 = 1.0;

/// Longest pulse, s.
const PULSE_MAX_S: f64 = 3600.0;

/// Most ports of a kind that are read: more than any device has.
const PORTS_MAX: u32 = 4096;

/// Ports that are read in one cycle.
const PORTS_READ: usize = 64;

/// States of inputs and outputs, by ports; `None` where the device does not know one, as while it is offline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IoState {
    /// Digital inputs.
    pub digital_inputs: Vec<Option<bool>>,
    /// Digital outputs, whichever client set them.
    pub digital_outputs: Vec<Option<bool>>,
    /// Analogue inputs, in the unit of the device.
    pub analogue_inputs: Vec<Option<f64>>,
    /// Analogue outputs, in the unit of the device, whichever client set them.
    pub analogue_outputs: Vec<Option<f64>>,
}

/// Inputs and outputs of a device. Ports count from 0.
#[derive(Clone, Debug)]
pub struct Io {
    session: Arc<Session>,
    device: String,
    interface: Interface,
}

/// Kind of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    DigitalInput,
    DigitalOutput,
    AnalogueInput,
    AnalogueOutput,
}

impl Kind {
    /// Its name, the parameter that has its number, and the primitive that reads it.
    const fn names(self) -> [&'static str; 3] {
        match self {
            Self::DigitalInput => ["digital input", "digin", "IO::InBool"],
            Self::DigitalOutput => ["digital output", "digout", "IO::OutBoolSensor"],
            Self::AnalogueInput => ["analogue input", "anin", "IO::InReal"],
            Self::AnalogueOutput => ["analogue output", "anout", "IO::OutRealSensor"],
        }
    }

    /// The primitive that reports its values to programs.
    const fn shown(self) -> &'static str {
        match self {
            Self::DigitalInput | Self::DigitalOutput => "Core::BooleanNetcommOut",
            Self::AnalogueInput | Self::AnalogueOutput => "Core::DoubleNetcommOut",
        }
    }
}

impl Io {
    pub(crate) fn find(session: &Arc<Session>, device: &str) -> Result<Self, ErrorKind> {
        let wanted = "device with inputs or outputs";
        let interface = Descriptions::read(session)?.interface(device, wanted, &["io"])?;
        Ok(Self::new(session, device.to_owned(), interface))
    }

    /// All devices of a cell that have inputs or outputs.
    pub(crate) fn all(session: &Arc<Session>) -> Result<Vec<Self>, ErrorKind> {
        let devices = Descriptions::read(session)?.with_interface(&["io"]);
        let devices = devices.into_iter();
        let io = |(name, interface)| Self::new(session, name, interface);
        Ok(devices.map(io).collect())
    }

    fn new(session: &Arc<Session>, device: String, interface: Interface) -> Self {
        Self {
            session: Arc::clone(session),
            device,
            interface,
        }
    }

    /// The name of the device.
    pub fn name(&self) -> &str {
        &self.device
    }

    /// The device type, such as `kuka_lwr_fri`.
    pub fn kind(&self) -> &str {
        &self.interface.kind
    }

    /// The present states of all inputs and outputs.
    ///
    /// # Errors
    /// If the controller rejects to read them, or the connection is lost.
    #[track_caller]
    pub fn state(&self) -> Result<IoState, Error> {
        Ok(IoState {
            digital_inputs: self.read(Kind::DigitalInput)?,
            digital_outputs: self.read(Kind::DigitalOutput)?,
            analogue_inputs: self.read(Kind::AnalogueInput)?,
            analogue_outputs: self.read(Kind::AnalogueOutput)?,
        })
    }

    /// The present values of all ports of a kind.
    fn read<T: FromStr>(&self, kind: Kind) -> Result<Vec<Option<T>>, ErrorKind> {
        let [_, parameter, primitive] = kind.names();
        let count = self.interface.number(parameter);
        let ports = (0..PORTS_MAX).take_while(|port| f64::from(*port) < count);
        let ports: Vec<_> = ports.collect();
        let mut all = Vec::new();
        for ports in ports.chunks(PORTS_READ) {
            let mut net = Net::default();
            for port in ports {
                let at = [
                    ("DeviceID", self.device.as_str().into()),
                    ("Port", port.to_string().into()),
                ];
                let value = net.add(primitive, at).out("outIO");
                let key = port.to_string();
                let shown = [("inValue", (&value).into()), ("Key", key.as_str().into())];
                net.add(kind.shown(), shown);
            }
            let values = self.session.evaluate(&net.finish_once())?;
            let value = |port: &u32| values.get(&format!("out{port}"))?.parse().ok();
            all.extend(ports.iter().map(value));
        }
        Ok(all)
    }

    /// A digital input, as an expression.
    ///
    /// # Errors
    /// [`ErrorKind::NoPort`] if the device has no such input.
    #[track_caller]
    pub fn input(&self, port: u32) -> Result<Condition, Error> {
        Ok(self.condition(Kind::DigitalInput, port)?)
    }

    /// An analogue input in the unit of the device, as an expression.
    ///
    /// # Errors
    /// [`ErrorKind::NoPort`] if the device has no such input.
    #[track_caller]
    pub fn analogue_input(&self, port: u32) -> Result<Number, Error> {
        Ok(self.number(Kind::AnalogueInput, port)?)
    }

    /// The present state of a digital output, whichever client set it, as an expression.
    ///
    /// # Errors
    /// [`ErrorKind::NoPort`] if the device has no such output.
    #[track_caller]
    pub fn output(&self, port: u32) -> Result<Condition, Error> {
        Ok(self.condition(Kind::DigitalOutput, port)?)
    }

    /// The present value of an analogue output in the unit of the device, as an expression.
    ///
    /// # Errors
    /// [`ErrorKind::NoPort`] if the device has no such output.
    #[track_caller]
    pub fn analogue_output(&self, port: u32) -> Result<Number, Error> {
        Ok(self.number(Kind::AnalogueOutput, port)?)
    }

    /// Sets a digital output. Completed when the device reports it, at most 1 s later.
    pub fn set(&self, port: u32, state: bool) -> Activity {
        self.write(port, Output::Digital { state, pulse: None })
    }

    /// Sets a digital output to `state` for `duration`, at most an hour, and then to the contrary; at once if it is
    /// cancelled. After an abort the output keeps its state.
    pub fn pulse(&self, port: u32, state: bool, duration: Duration) -> Activity {
        let pulse = Some(duration);
        self.write(port, Output::Digital { state, pulse })
    }

    /// Sets an analogue output to a value in the unit of the device. Completed when the device has reported the output.
    pub fn set_analogue(&self, port: u32, value: f64) -> Activity {
        self.write(port, Output::Analogue(value))
    }

    fn write(&self, port: u32, output: Output) -> Activity {
        let kind = output.kind();
        let write = Write {
            device: self.device.clone(),
            port,
            output,
            unknown: self.check(kind, port).err(),
        };
        Activity::new(&self.session, write, Speed::FULL)
    }

    fn condition(&self, kind: Kind, port: u32) -> Result<Condition, ErrorKind> {
        let [_, _, primitive] = kind.names();
        self.check(kind, port)?;
        Ok(Condition::port(primitive, &self.device, port))
    }

    fn number(&self, kind: Kind, port: u32) -> Result<Number, ErrorKind> {
        let [_, _, primitive] = kind.names();
        self.check(kind, port)?;
        let parameters = vec![
            ("DeviceID", self.device.clone()),
            ("Port", port.to_string()),
        ];
        Ok(Number::sensor(primitive, parameters, "outIO"))
    }

    fn check(&self, kind: Kind, port: u32) -> Result<(), ErrorKind> {
        let [wanted, parameter, _] = kind.names();
        let count = self.interface.number(parameter);
        if f64::from(port) < count {
            return Ok(());
        }
        let all = [
            Kind::DigitalInput,
            Kind::DigitalOutput,
            Kind::AnalogueInput,
            Kind::AnalogueOutput,
        ];
        let known = all.map(|kind| {
            let [name, parameter, _] = kind.names();
            let count = self.interface.number(parameter);
            let plural = if count.to_bits() == 1.0_f64.to_bits() {
                ""
            } else {
                "s"
            };
            format!("{count} {name}{plural}")
        });
        Err(ErrorKind::NoPort {
            device: self.device.clone(),
            wanted,
            port,
            known: known.join(", "),
        })
    }
}

/// What an output is set to.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Output {
    Digital {
        state: bool,
        /// How long; else it stays.
        pulse: Option<Duration>,
    },
    Analogue(f64),
}

impl Output {
    const fn kind(self) -> Kind {
        match self {
            Self::Digital { .. } => Kind::DigitalOutput,
            Self::Analogue(_) => Kind::AnalogueOutput,
        }
    }
}

/// Sets an output.
#[derive(Clone, Debug)]
struct Write {
    device: String,
    port: u32,
    output: Output,
    /// Why there is no such output.
    unknown: Option<ErrorKind>,
}

impl Write {
    /// Its name in errors, and for the succession of activities.
    fn name(&self) -> String {
        let [kind, ..] = self.output.kind().names();
        format!("{} {kind} {}", self.device, self.port)
    }

    /// A primitive with the port of this output.
    fn at_port(&self, net: &mut Net, kind: &str, value: Option<&Port>) -> Port {
        let mut arguments = vec![
            ("DeviceID", self.device.as_str().into()),
            ("Port", self.port.to_string().into()),
        ];
        arguments.extend(value.map(|value| ("inIO", value.into())));
        net.add_with(kind, &arguments).out("outIO")
    }

    /// Sets a digital output; returns when it is as it stays, and for how long it should be so, s.
    fn digital(&self, net: &mut Net, requests: &Requests<'_>, state: bool) -> [Port; 2] {
        let time = net.add("Core::Clock", []).out("outValue");
        let pulse = match self.output {
            Output::Digital { pulse, .. } => pulse,
            Output::Analogue(_) => None,
        };
        let value = [("Value", state.to_string().into())];
        let mut value = net.add("Core::BooleanValue", value).out("outValue");
        let mut stays = None;
        if let Some(pulse) = pulse {
            let over = [
                ("inFirst", (&time).into()),
                ("Second", pulse.as_secs_f64().into()),
            ];
            let over = net.add("Core::DoubleGreater", over).out("outValue");
            let over = net.of_two("Core::BooleanOr", &over, &requests.stop);
            let contrary = net.of("Core::BooleanNot", &value);
            let choice = [
                ("inCondition", (&over).into()),
                ("inTrue", (&contrary).into()),
                ("inFalse", (&value).into()),
            ];
            value = net.add("Core::BooleanConditional", choice).out("outValue");
            stays = Some(over);
        }
        self.at_port(net, "IO::OutBool", Some(&value));
        let reported = self.at_port(net, "IO::OutBoolSensor", None);
        let both = net.of_two("Core::BooleanAnd", &reported, &value);
        let neither = net.of_two("Core::BooleanOr", &reported, &value);
        let neither = net.of("Core::BooleanNot", &neither);
        let equal = net.of_two("Core::BooleanOr", &both, &neither);
        let equal = net.known(&equal);
        let Some(over) = stays else {
            return [net.of_two("Core::BooleanOr", &equal, &requests.stop), time];
        };
        let since = net.add("Core::Clock", [("inActive", (&over).into())]);
        let done = net.of_two("Core::BooleanAnd", &equal, &over);
        [done, since.out("outValue")]
    }

    /// Sets an analogue output; returns when the device has reported it.
    fn analogue(&self, net: &mut Net, requests: &Requests<'_>, value: f64) -> [Port; 2] {
        let time = net.add("Core::Clock", []).out("outValue");
        let value = [("Value", value.into())];
        let value = net.add("Core::DoubleValue", value).out("outValue");
        self.at_port(net, "IO::OutReal", Some(&value));
        let reported = self.at_port(net, "IO::OutRealSensor", None);
        let unknown = net.of("Core::DoubleIsNull", &reported);
        let known = net.of("Core::BooleanNot", &unknown);
        // What is reported in the first cycle is older than the net.
        let first = net.add("Core::CycleTime", []).out("outValue");
        let later = [("inFirst", (&time).into()), ("inSecond", (&first).into())];
        let later = net.add("Core::DoubleGreater", later).out("outValue");
        let reported = net.of_two("Core::BooleanAnd", &known, &later);
        [
            net.of_two("Core::BooleanOr", &reported, &requests.stop),
            time,
        ]
    }
}

impl Operation for Write {
    fn devices(&self) -> Vec<String> {
        vec![self.name()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let invalid = |what: String| Err(ErrorKind::Invalid(format!("{}: {what}", self.name())));
        match (&self.unknown, self.output) {
            (Some(error), _) => Err(error.clone()),
            (None, Output::Analogue(value)) if !value.is_finite() => {
                invalid(format!("the value is {value}; it is a finite number"))
            }
            (
                None,
                Output::Digital {
                    pulse: Some(pulse), ..
                },
            ) if pulse.is_zero() || pulse.as_secs_f64() > PULSE_MAX_S => invalid(format!(
                "the pulse lasts {pulse:?}; it lasts above 0 s, at most 3600 s"
            )),
            (None, Output::Analogue(_) | Output::Digital { .. }) => Ok(()),
        }
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let [done, time] = match self.output {
            Output::Digital { state, .. } => self.digital(net, requests, state),
            Output::Analogue(value) => self.analogue(net, requests, value),
        };
        let late = [("inFirst", (&time).into()), ("Second", REPORT_S.into())];
        let late = net.add("Core::DoubleGreater", late).out("outValue");
        let late = net.known(&late);
        let cause = "the device did not report the output as set within 1 s\nhint: `takt run` and the page say whether it \
                     is online";
        let error = ErrorKind::DeviceFailed {
            device: self.name(),
            cause: cause.to_owned(),
        };
        let failure = Failure {
            key: "late".to_owned(),
            error,
        };
        Ok(Ports {
            done,
            progress: None,
            failures: vec![(failure, late)],
            results: Vec::new(),
            fault: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::text_of;

    fn write(output: Output) -> Write {
        Write {
            device: "plant".to_owned(),
            port: 3,
            output,
            unknown: None,
        }
    }

    #[test]
    fn digital_output_is_set_and_compared() {
        let (state, pulse) = (true, None);
        let text = text_of(write(Output::Digital { state, pulse })).unwrap();
        assert!(
            text.contains("=IO::OutBool(DeviceID='plant', Port='3', inIO=p"),
            "{text}"
        );
        assert!(
            text.contains("=IO::OutBoolSensor(DeviceID='plant', Port='3')"),
            "{text}"
        );
        assert!(text.contains("Key='late'"), "{text}");
    }

    #[test]
    fn pulse_ends_after_its_duration_or_a_cancel() {
        let pulse = Some(Duration::from_millis(250));
        let text = text_of(write(Output::Digital { state: true, pulse })).unwrap();
        assert!(text.contains("Second='0.25'"), "{text}");
        assert!(text.contains("=Core::Clock(inActive=p"), "{text}");
    }

    #[test]
    fn output_out_of_bounds_is_invalid() {
        let pulse = |pulse| Output::Digital {
            state: true,
            pulse: Some(pulse),
        };
        let wrong = [
            Output::Analogue(f64::NAN),
            Output::Analogue(f64::INFINITY),
            pulse(Duration::ZERO),
            pulse(Duration::from_secs(3601)),
        ];
        for output in wrong {
            let error = text_of(write(output)).unwrap_err();
            assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
        }
    }
}
