//! `takt ros2`: the arms, grippers and outputs of a running controller as a node of ROS 2, without an installation of ROS. It is a
//! client like any program: nets, limits and succession are those of the Robotics API, messages those of `takt-fleet`.

mod diagnostics;
mod follow;
mod frames;
mod grip;
mod names;
mod outputs;
mod server;
mod states;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_api::Cell;
use takt_fleet::ros::keys::Qos;
use takt_fleet::ros::messages;
use takt_fleet::ros::node::{Node, NodeConfig, Publisher, ROUTER, Router, now};
use takt_fleet::ros::types::{STRING, TF_MESSAGE};
use takt_motion::urdf::Urdf;

use crate::Verdict;
use crate::http::Site;
use crate::output::{complain, say};
use crate::signal::Stop;
use frames::Frames;
use names::{Chain, RosArm};
use server::Refusals;

/// How long the controller may take to answer.
const TIMEOUT: Duration = Duration::from_secs(5);
/// How often the end of the command is looked for.
const TICK: Duration = Duration::from_millis(100);

/// Offer the robots of a running controller to ROS 2: joint states, frames, wrenches, diagnostics, FollowJointTrajectory, grippers, outputs.
///
/// Nodes of ROS must use rmw_zenoh (RMW_IMPLEMENTATION=rmw_zenoh_cpp, 0.2.4 or later) and reach the same router. For arm `left`:
/// /joint_states, /left/wrench, the action /left/follow_joint_trajectory, the topic /left/joint_trajectory; for several arms at once
/// the action /arms/follow_joint_trajectory; for gripper `hand` /hand/gripper_cmd and /hand/parallel_gripper_cmd; for outputs of
/// `plant` the services /plant/output_0 and so on; /tf, /tf_static, /diagnostics, /robot_description. A goal that comes while an arm moves takes over
/// without a jump. An arm brakes when this command ends.
///
/// Exit status: 0 ended by a signal; 2 no controller or no session.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ros2 --with-router
  takt ros2 --description ur5e.urdf --namespace /cell_a
  takt ros2 --description two_arms.urdf --chain left=base_l:tool_l --chain right=base_r:tool_r --domain 7")]
pub(crate) struct Ros2 {
    /// Where the controller listens for programs: `tcp` of its cell.toml, or its Unix socket; else the controller of this host.
    #[arg(long, value_name = "ADDRESS")]
    program: Option<String>,
    /// Address of the router of ROS 2 (rmw_zenohd).
    #[arg(long, value_name = "ADDRESS", default_value = ROUTER)]
    router: String,
    /// Be that router, too, if no other one is running.
    #[arg(long)]
    with_router: bool,
    /// ROS_DOMAIN_ID of the nodes, 0 to 232.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=232))]
    domain: u32,
    /// Namespace of all names, such as /cell_a.
    #[arg(long, default_value = "")]
    namespace: String,
    /// Joint states a second, 1 to 500.
    #[arg(long, value_name = "HZ", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=500))]
    rate: u32,
    /// URDF that is published as /robot_description; joints have the names that it gives them.
    #[arg(long, value_name = "FILE")]
    description: Option<PathBuf>,
    /// First and last link of an arm in the description; not needed if it has one arm only.
    #[arg(long = "chain", value_name = "ARM=BASE:TIP", requires = "description")]
    chains: Vec<Chain>,
    /// Publish no /tf and /tf_static, since robot_state_publisher does.
    #[arg(long)]
    no_tf: bool,
    /// Largest deviation from a trajectory on its way where a goal names none, rad; 0 for any.
    #[arg(long, value_name = "RAD", default_value_t = 0.0)]
    path_tolerance: f64,
    /// The same at its end, where an arm has a second more to get there.
    #[arg(long, value_name = "RAD", default_value_t = 0.01)]
    goal_tolerance: f64,
    /// Publish only: nothing of ROS moves a robot.
    #[arg(long)]
    read_only: bool,
    #[command(flatten)]
    site: Site,
}

impl Ros2 {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let stop = Stop::listen()?;
        let http = self.site.client(TIMEOUT)?;
        let token = http.token();
        let cell = match &self.program {
            Some(address) => Cell::connect_with(address, token)?,
            None => Cell::connect_here(token)?,
        };
        let text = self.description.as_ref().map(|path| {
            let text = std::fs::read_to_string(path);
            text.with_context(|| format!("cannot read {}", path.display()))
        });
        let text = text.transpose()?;
        let urdf = text.as_deref().map(Urdf::parse).transpose();
        let urdf = urdf.with_context(|| {
            let path = self.description.clone().unwrap_or_default();
            format!("cannot use {}", path.display())
        })?;
        let described = self.description.as_deref().zip(urdf.as_ref());
        let arms = names::arms(&cell, described, &self.chains)?;
        let router = self.open_router()?;
        let node = Node::open(&NodeConfig {
            domain: self.domain,
            namespace: self.namespace.clone(),
            name: "takt".to_owned(),
            router: self.router.clone(),
        })?;
        let node = Arc::new(node);
        let mut latched = Vec::new();
        if let Some(text) = &text {
            let publisher = node.publisher("robot_description", &STRING, Qos::LATCHED)?;
            publisher.publish(messages::string(text))?;
            latched.push(publisher);
        }
        let mut frames = Frames::read(&cell, &arms, urdf.as_ref())?;
        if self.no_tf {
            frames.of_arms.clear();
            frames.bases.clear();
        } else {
            latched.push(publish_fixed(&node, &frames)?);
        }
        let states = states::start(&node, &http, &arms, &frames, self.rate)?;
        diagnostics::start(&node, &http, &stop)?;
        let servers = if self.read_only {
            Vec::new()
        } else {
            self.offer(&node, &cell, &arms, &states, &stop)?
        };
        self.say_what_is_offered(&arms)?;
        while !stop.is_requested() && servers.iter().all(|server| !server.is_finished()) {
            std::thread::sleep(TICK);
        }
        let is_ended = stop.is_requested();
        stop.request();
        for server in servers {
            if server.join().is_err() {
                complain("takt: a thread ended by a panic");
            }
        }
        drop((latched, router));
        // Brakes what still moves, and waits for it.
        cell.close()?;
        anyhow::ensure!(is_ended, "the connection to the controller was lost");
        Ok(Verdict::Good)
    }

    fn open_router(&self) -> anyhow::Result<Option<Router>> {
        if !self.with_router {
            return Ok(None);
        }
        match Router::open(&self.router) {
            Ok(router) => Ok(Some(router)),
            Err(why) => {
                complain(&format!(
                    "takt: no router of its own at {}: {why}\nhint: another one may be running, which is used then",
                    self.router
                ));
                Ok(None)
            }
        }
    }

    fn offer(
        &self,
        node: &Arc<Node>,
        cell: &Cell,
        arms: &[RosArm],
        states: &states::Latest,
        stop: &Stop,
    ) -> anyhow::Result<Vec<std::thread::JoinHandle<()>>> {
        let refusals = Refusals::default();
        let tolerances = [self.path_tolerance, self.goal_tolerance];
        for tolerance in tolerances {
            anyhow::ensure!(
                tolerance >= 0.0 && tolerance.is_finite(),
                "a tolerance is {tolerance}; it is at least 0 rad"
            );
        }
        let mut servers = Vec::new();
        let mut groups: Vec<(String, Vec<RosArm>)> = arms
            .iter()
            .map(|arm| (arm.name.clone(), vec![arm.clone()]))
            .collect();
        if arms.len() > 1 && arms.iter().all(|arm| arm.name != "arms") {
            groups.push(("arms".to_owned(), arms.to_vec()));
        }
        for (name, group) in groups {
            let follow = follow::Follow::new(group, tolerances, states.clone());
            servers.push(follow.start(node, &name, &refusals, stop)?);
        }
        for gripper in cell.grippers()? {
            servers.extend(grip::start(node, (cell, &gripper), &refusals, stop)?);
        }
        servers.extend(outputs::start(node, cell, &refusals, stop)?);
        Ok(servers)
    }

    fn say_what_is_offered(&self, arms: &[RosArm]) -> anyhow::Result<()> {
        let prefix = &self.namespace;
        for arm in arms {
            let name = &arm.name;
            let motion = if self.read_only {
                String::new()
            } else {
                format!(", action {prefix}/{name}/follow_joint_trajectory")
            };
            let joints = arm.joints.join(" ");
            say(&format!(
                "{name}: {prefix}/joint_states{motion}; joints {joints}"
            ))?;
        }
        say(&format!(
            "domain {}, router {}{}",
            self.domain,
            self.router,
            if self.read_only { ", read only" } else { "" }
        ))
    }
}

/// Frames that do not move, for all that come later too.
fn publish_fixed(node: &Node, frames: &Frames) -> anyhow::Result<Publisher> {
    if !frames.unmoved.is_empty() {
        complain(&format!(
            "takt: no arm has the joints {} of the description: links behind them have no place in /tf",
            frames.unmoved.join(", ")
        ));
    }
    let publisher = node.publisher("/tf_static", &TF_MESSAGE, Qos::LATCHED)?;
    publisher.publish(messages::transforms(now(), &frames.fixed))?;
    Ok(publisher)
}
