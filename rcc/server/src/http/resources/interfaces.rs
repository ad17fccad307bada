//! `/devices/<d>/<interface>`: live values of a device. All but the joints are read by evaluating a net of the
//! primitives that programs use, and outputs are set by a net that runs for one cycle: programs and HTTP clients have
//! the same permissions, and no driver is known here.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use takt_core::controller::{DeviceInfo, LoadRequest, NetState};
use takt_core::{NetId, SessionId};

use super::super::Response;
use super::super::element::{Element, NetValue};
use super::devices::uri;
use super::{Handler, Outcome};

/// Most ports shown per kind.
const PORTS_MAX: u32 = 256;

/// Most joints of an arm in a query.
const JOINTS_MAX: usize = 8;

/// Timeout for setting an output.
const SET_OUTPUT_TIMEOUT: Duration = Duration::from_secs(2);

/// Kinds of ports: interface parameter with their number, name here, primitive that reads one.
const PORTS: [(&str, &str, &str); 4] = [
    ("digin", "digin", "IO::InBool"),
    ("digout", "digout", "IO::OutBoolSensor"),
    ("anin", "anin", "IO::InReal"),
    ("anout", "anout", "IO::OutRealSensor"),
];

/// A device name as the value of a parameter in net text, in quotes.
fn in_net(name: &str) -> String {
    let name = name.replace('\\', r"\\").replace('\'', r"\'");
    format!("'{name}'")
}

impl Handler<'_> {
    pub(super) fn interface(&self, name: &str, interface: &str, post: bool) -> Outcome {
        let device = self.find_device(name)?;
        let has = |interface: &str| device.interfaces.contains_key(interface);
        match (interface, post) {
            ("robotarm", false) => self.robot_arm(name),
            ("parameters", false) => Ok(self.parameters(&device)),
            ("parameters", true) => Err(Response::conflict(
                "the parameters of an existing device cannot be changed\nhint: remove the device and create it again",
            )),
            ("armkinematics" | "kinematics", false) if has("armkinematics") => {
                self.arm_kinematics(&device)
            }
            ("io", false) if has("io") => self.io(&device),
            ("io", true) if has("io") => self.set_output(name),
            ("cartesianposition", false) if has("cartesianposition") => {
                self.monitor(name, interface, "CartesianPosition::CartesianMonitor")
            }
            ("robotbase", false) if has("robotbase") => {
                self.monitor(name, interface, "RobotBase::BaseMonitor")
            }
            (_, false) if has(interface) => Ok(self.show(&described(&device, interface))),
            (_, true) if has(interface) => Err(Response::text(
                "405 Method Not Allowed",
                "Only io accepts values.\n",
            )),
            _ => {
                let known: Vec<_> = device.interfaces.keys().map(String::as_str).collect();
                let known = known.join(", ");
                Err(Response::not_found(format!(
                    "{name} has parameters and these interfaces: {known}"
                )))
            }
        }
    }

    /// The parameters of all interfaces of the device.
    fn parameters(&self, device: &DeviceInfo) -> Response {
        let interfaces = device.interfaces.keys();
        let interfaces = interfaces.map(|interface| described(device, interface));
        let element = Element::new("parameters").with("name", &device.name);
        self.show(&element.with("type", &device.kind).containing(interfaces))
    }

    /// The flange frame at the joint positions `j1`… of the query, or at the present ones; or the joint positions for
    /// the frame `x`, `y`, `z`, `a`, `b`, `c`, near `j1`….
    fn arm_kinematics(&self, device: &DeviceInfo) -> Outcome {
        let name = &device.name;
        let robot = in_net(name);
        let joints = self.joints(device)?;
        let list: Vec<_> = joints.iter().map(ToString::to_string).collect();
        let list = list.join(",");
        let hint = format!("j=Core::DoubleArrayNetcommIn(Key='j',Value='[{list}]')");
        let frame_keys = ["x", "y", "z", "a", "b", "c"];
        let net = if frame_keys.iter().any(|key| self.query(key).is_some()) {
            let mut frame = [0.0; 6];
            for (key, value) in frame_keys.iter().zip(&mut frame) {
                *value = self.number(key)?.unwrap_or(0.0);
            }
            let [x, y, z, a, b, c] = frame;
            format!(
                "{hint},f=World::FrameNetcommIn(Key='f',Value='{{pos:{{x:{x},y:{y},z:{z}}},\
                 rot:{{a:{a},b:{b},c:{c}}}}}'),k=ArmKinematics::InvKin(Robot={robot},\
                 inFrame=f.outValue,inHintJoints=j.outValue),outJoints=k.outJoints"
            )
        } else {
            format!(
                "{hint},k=ArmKinematics::Kin(Robot={robot},inJoints=j.outValue),outFrame=k.outFrame"
            )
        };
        let values = self.evaluated(&net)?;
        if values.is_empty() {
            return Err(Response::conflict("the arm cannot reach that frame"));
        }
        Ok(self.show(&data("armkinematics", name, values)))
    }

    /// The joint positions of the query, with the present ones for those missing, rad.
    fn joints(&self, device: &DeviceInfo) -> Result<Vec<f64>, Response> {
        let arm = device.interfaces.get("robotarm");
        let count = arm.and_then(|p| p.get("jointcount")?.parse().ok());
        let count: usize = count.unwrap_or(0).min(JOINTS_MAX);
        let state = self.controller.arm_state(&device.name);
        let present = |number: usize| {
            let joint = state.as_ref()?.joints.get(number)?;
            joint.measured_position.or(joint.commanded_position)
        };
        let joint = |number: usize| {
            let given = self.number(&format!("j{}", number + 1))?;
            Ok(given.or_else(|| present(number)).unwrap_or(0.0))
        };
        (0..count).map(joint).collect()
    }

    /// A number in the query.
    fn number(&self, key: &str) -> Result<Option<f64>, Response> {
        let Some(text) = self.query(key) else {
            return Ok(None);
        };
        let number = text.parse().ok().filter(|n: &f64| n.is_finite());
        let wrong = || Response::bad_request(format!("{key}: a number is expected, in m or rad"));
        number.map(Some).ok_or_else(wrong)
    }

    /// All ports with their values.
    fn io(&self, device: &DeviceInfo) -> Outcome {
        let name = &device.name;
        let device_id = in_net(name);
        let mut io = Element::new("io").with("name", name);
        for (parameter, kind, primitive) in PORTS {
            let count = device.interfaces.get("io").and_then(|io| io.get(parameter));
            let count: u32 = count.and_then(|n| n.parse().ok()).unwrap_or(0);
            let mut net = String::new();
            for port in 0..count.min(PORTS_MAX) {
                let separator = if port == 0 { "" } else { "," };
                // Writing to a String cannot fail.
                let _ = write!(
                    net,
                    "{separator}p{port}={primitive}(DeviceID={device_id},Port='{port}'),out{port}=p{port}.outIO"
                );
            }
            let values = if count == 0 {
                Vec::new()
            } else {
                self.evaluated(&net)?
            };
            let ports = values.into_iter().map(|(key, value)| {
                let id = key.trim_start_matches("out").to_owned();
                let port = Element::new("port")
                    .with("id", NetValue(id))
                    .with("type", kind);
                port.with("value", NetValue(value))
            });
            io = io.containing(ports);
        }
        Ok(self.show(&io))
    }

    /// Sets an output with a net that runs for one cycle.
    fn set_output(&self, name: &str) -> Outcome {
        let field = |key: &str| {
            let missing = || Response::bad_request(format!("{key} is missing"));
            self.field(key).map(str::trim).ok_or_else(missing)
        };
        let id: u32 = field("id")?
            .parse()
            .map_err(|_| Response::bad_request("id: the number of an output is expected"))?;
        let (value, kind) = (field("value")?, field("type")?);
        let output = match (kind, value, value.parse::<f64>()) {
            ("digout", "true" | "1", _) => "OutBool(IO='true'".to_owned(),
            ("digout", "false" | "0", _) => "OutBool(IO='false'".to_owned(),
            ("anout", _, Ok(value)) if value.is_finite() => format!("OutReal(IO='{value}'"),
            ("digout" | "anout", _, _) => {
                let text = "value: true or false for a digout, a number for an anout is expected";
                return Err(Response::bad_request(text));
            }
            _ => return Err(Response::bad_request("type: digout or anout is expected")),
        };
        let device = in_net(name);
        let text = format!(
            "{{o=IO::{output},DeviceID={device},Port='{id}'),e=Core::BooleanValue(Value='true'),\
             outTerminate=e.outValue}}"
        );
        let request = LoadRequest {
            text,
            session: SessionId::NONE,
            description: format!("output {kind} {id} of {name}"),
            period: None,
        };
        let net = self.controller.load(request).map_err(Response::conflict)?;
        let outcome = self.run_once(net);
        // The net is not needed any more, whatever its outcome.
        if let Err(error) = self
            .controller
            .abort(net)
            .and_then(|()| self.controller.unload(net))
        {
            tracing::warn!(%net, %error, "cannot unload the net that set an output");
        }
        outcome?;
        Ok(Response::redirect(
            "303 See Other",
            &format!("{}io", uri(name)),
        ))
    }

    fn run_once(&self, net: NetId) -> Result<(), Response> {
        if let Some(rejection) = self.controller.net(net).and_then(|info| info.rejection) {
            return Err(Response::conflict(rejection));
        }
        self.controller.start_net(net).map_err(Response::conflict)?;
        let until = Instant::now() + SET_OUTPUT_TIMEOUT;
        let ended = || {
            let state = self.controller.net(net).map(|info| info.state());
            matches!(state, None | Some(NetState::Terminated))
        };
        while !ended() {
            if Instant::now() > until {
                return Err(Response::conflict("the output was not set in time"));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// All outputs of a monitor primitive of the device.
    fn monitor(&self, name: &str, interface: &str, primitive: &str) -> Outcome {
        let registry = self.controller.registry();
        let definition = registry.find(primitive);
        let outputs = definition.map_or(&[][..], |definition| &definition.outputs);
        let ports = outputs.iter().map(|port| format!(",{0}=m.{0}", port.name));
        let ports: String = ports.collect();
        let robot = in_net(name);
        let values = self.evaluated(&format!("m={primitive}(Robot={robot}){ports}"))?;
        let element = match interface {
            "robotbase" => "robotbase",
            _ => "cartesianposition",
        };
        Ok(self.show(&data(element, name, values)))
    }

    /// The out values of a net, evaluated for one cycle.
    fn evaluated(&self, children: &str) -> Result<Vec<(String, String)>, Response> {
        let net = format!("{{{children},e=Core::BooleanValue(),outTerminate=e.outValue}}");
        let values = self.controller.evaluate(&net).map_err(Response::conflict)?;
        let own = |key: &str| key == "outTerminate";
        Ok(values.into_iter().filter(|(key, _)| !own(key)).collect())
    }
}

fn data(element: &'static str, name: &str, values: Vec<(String, String)>) -> Element {
    let value = |(key, text): (String, String)| Element::new("data").with("key", key).value(text);
    let values = values.into_iter().map(value);
    Element::new(element).with("name", name).containing(values)
}

fn described(device: &DeviceInfo, interface: &str) -> Element {
    let parameters = device.interfaces.get(interface).into_iter().flatten();
    let parameters = parameters.map(|(key, value)| {
        let parameter = Element::new("parameter").with("name", key);
        parameter.with("value", NetValue(value.clone()))
    });
    let element = Element::new("interface").with("name", interface);
    element.containing(parameters)
}
