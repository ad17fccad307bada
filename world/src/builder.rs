//! Describes a world part by part and checks it: unknown names and impossible figures are errors with the name in them.

use crate::body::{Body, BodyConfig, Carrier};
use crate::dock::{Dock, DockConfig};
use crate::geometry::{Pose, finite_pose};
use crate::grasp::GraspConfig;
use crate::handle::World;
use crate::hole::{Hole, HoleConfig};
use crate::scene::{BaseState, HandState, Scene, Tool};
use crate::screw::{Screw, ScrewConfig, Thread, ThreadConfig};
use crate::surface::{STIFFNESS_MAX, Surface, SurfaceConfig};

/// Stiffest hole, N/m.
const HOLE_STIFFNESS_MAX: f64 = 200_000.0;
/// Bounds the cost of a step.
const BODIES_MAX: usize = 64;

/// Why a world cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// Two parts of one kind have the same name.
    #[error("{kind} `{name}` exists twice\nhint: give each {kind} its own name")]
    Twice {
        /// Such as body.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// A part names another that does not exist.
    #[error(
        "`{part}` refers to `{name}`, which does not exist\nhint: add it before what refers to it"
    )]
    Unknown {
        /// The part that refers.
        part: String,
        /// The missing name.
        name: String,
    },
    /// A figure is out of its range or not finite.
    #[error(
        "{what} of `{part}` is out of range: {range}\nhint: see the documentation of the field"
    )]
    Range {
        /// The part.
        part: String,
        /// The figure.
        what: &'static str,
        /// Its range.
        range: &'static str,
    },
    /// More bodies than a step can bear.
    #[error("{count} bodies, at most 64 are possible\nhint: leave out what no robot touches")]
    Bodies {
        /// How many.
        count: usize,
    },
}

/// Builds a [`World`]; made by [`World::builder`].
#[derive(Debug, Clone, Default)]
pub struct Builder {
    bases: Vec<(String, Pose)>,
    docks: Vec<DockConfig>,
    surfaces: Vec<SurfaceConfig>,
    bodies: Vec<BodyConfig>,
    holes: Vec<HoleConfig>,
    screws: Vec<ScrewConfig>,
    threads: Vec<ThreadConfig>,
    hands: Vec<(String, Pose, Tool)>,
}

impl World {
    /// An empty world to fill.
    #[must_use]
    pub fn builder() -> Builder {
        Builder::default()
    }
}

impl Builder {
    /// Adds a mobile base that stands there at the beginning.
    #[must_use]
    pub fn base(mut self, name: &str, pose: Pose) -> Self {
        self.bases.push((name.into(), pose));
        self
    }

    /// Adds a place where a base docks.
    #[must_use]
    pub fn dock(mut self, dock: DockConfig) -> Self {
        self.docks.push(dock);
        self
    }

    /// Adds a surface.
    #[must_use]
    pub fn surface(mut self, surface: SurfaceConfig) -> Self {
        self.surfaces.push(surface);
        self
    }

    /// Adds a body; what it rests on comes before it.
    #[must_use]
    pub fn body(mut self, body: BodyConfig) -> Self {
        self.bodies.push(body);
        self
    }

    /// Adds a hole.
    #[must_use]
    pub fn hole(mut self, hole: HoleConfig) -> Self {
        self.holes.push(hole);
        self
    }

    /// Adds a screw in its magazine.
    #[must_use]
    pub fn screw(mut self, screw: ScrewConfig) -> Self {
        self.screws.push(screw);
        self
    }

    /// Adds a threaded hole.
    #[must_use]
    pub fn thread(mut self, thread: ThreadConfig) -> Self {
        self.threads.push(thread);
        self
    }

    /// Adds a hand with nothing but a tip at the tool centre point, which is given in the frame of the flange.
    #[must_use]
    pub fn probe(mut self, name: &str, tool: Pose) -> Self {
        self.hands.push((name.into(), tool, Tool::Tip));
        self
    }

    /// Adds a hand with fingers: at the tool centre point, closing along its y, reaching along its z.
    #[must_use]
    pub fn gripper(mut self, name: &str, tool: Pose, grasp: GraspConfig) -> Self {
        self.hands.push((name.into(), tool, Tool::fingers(grasp)));
        self
    }

    /// Adds a hand with a screwdriver: the end of its bit at the tool centre point, z into the screw.
    #[must_use]
    pub fn driver(mut self, name: &str, tool: Pose) -> Self {
        self.hands.push((name.into(), tool, Tool::bit()));
        self
    }

    /// Checks and builds.
    ///
    /// # Errors
    /// If names are not unique or unknown, or figures out of range.
    pub fn build(self) -> Result<World, BuildError> {
        self.check_names()?;
        self.check_figures()?;
        let bases: Vec<_> = self.bases.clone();
        let base = |part: &str, name: &str| index(part, name, bases.iter().map(|it| &*it.0));
        let mut docks = Vec::new();
        for config in self.docks {
            let base = base(&config.name, &config.base)?;
            docks.push(Dock { config, base });
        }
        let mut surfaces = Vec::new();
        for config in self.surfaces {
            let carrier = match &config.on_base {
                Some(name) => Carrier::Base(base(&config.name, name)?),
                None => Carrier::World,
            };
            surfaces.push(Surface { config, carrier });
        }
        let mut bodies: Vec<Body> = Vec::new();
        for config in self.bodies {
            let rest = rest(&config, &bodies, &surfaces)?;
            let pose = config.pose;
            bodies.push(Body::new(config, pose, rest));
        }
        let inside = |part: &str, body: &Option<String>| match body {
            Some(name) => {
                let names = bodies.iter().map(|body| &*body.config.name);
                index(part, name, names).map(Carrier::Body)
            }
            None => Ok(Carrier::World),
        };
        let mut holes = Vec::new();
        for config in self.holes {
            let carrier = inside(&config.name, &config.in_body)?;
            holes.push(Hole { config, carrier });
        }
        let mut threads = Vec::new();
        for config in self.threads {
            let carrier = inside(&config.name, &config.in_body)?;
            threads.push(Thread {
                pose: config.pose,
                config,
                carrier,
                is_taken: false,
            });
        }
        let hands = self.hands.into_iter();
        let hands = hands.map(|(name, tool, kind)| HandState::new(name, tool, kind));
        let bases = self.bases.into_iter();
        let scene = Scene::new(
            (
                bases
                    .map(|(name, pose)| BaseState::new(name, pose))
                    .collect(),
                docks,
            ),
            surfaces,
            bodies,
            holes,
            (self.screws.into_iter().map(Screw::new).collect(), threads),
            hands.collect(),
        );
        Ok(World::new(scene))
    }

    fn check_names(&self) -> Result<(), BuildError> {
        let hands = self.hands.iter().map(|it| &*it.0);
        unique("hand", hands)?;
        unique("base", self.bases.iter().map(|it| &*it.0))?;
        unique("dock", self.docks.iter().map(|it| &*it.name))?;
        unique("surface", self.surfaces.iter().map(|it| &*it.name))?;
        unique("body", self.bodies.iter().map(|it| &*it.name))?;
        unique("hole", self.holes.iter().map(|it| &*it.name))?;
        unique("screw", self.screws.iter().map(|it| &*it.name))?;
        unique("thread", self.threads.iter().map(|it| &*it.name))?;
        let count = self.bodies.len();
        if count > BODIES_MAX {
            return Err(BuildError::Bodies { count });
        }
        Ok(())
    }

    #[expect(clippy::too_many_lines, reason = "one line a figure")]
    fn check_figures(&self) -> Result<(), BuildError> {
        for (name, pose) in &self.bases {
            check_pose(name, pose)?;
        }
        for it in &self.docks {
            check_pose(&it.name, &it.pose)?;
            for (what, value) in [
                ("guides", it.guides_m),
                ("tolerance", it.tolerance_m),
                ("angular tolerance", it.tolerance_rad),
            ] {
                within(&it.name, what, value, [0.0, 10.0], "0 to 10 m and rad")?;
            }
        }
        for it in &self.surfaces {
            check_pose(&it.name, &it.pose)?;
            let [x, y] = it.half_m;
            within(&it.name, "size", x.min(y), [1e-4, 100.0], "0.1 mm to 100 m")?;
            within(
                &it.name,
                "stiffness",
                it.stiffness,
                [1.0, STIFFNESS_MAX],
                "1 to 50,000 N/m",
            )?;
            within(&it.name, "friction", it.friction, [0.0, 10.0], "0 to 10")?;
        }
        for it in &self.bodies {
            check_pose(&it.name, &it.pose)?;
            within(
                &it.name,
                "mass",
                it.mass_kg,
                [1e-3, 1e4],
                "0.001 to 10,000 kg",
            )?;
            within(
                &it.name,
                "size",
                it.size_m.min(),
                [1e-3, 100.0],
                "1 mm to 100 m",
            )?;
            within(
                &it.name,
                "size",
                it.size_m.max(),
                [1e-3, 100.0],
                "1 mm to 100 m",
            )?;
            for (pose, width) in &it.grips {
                check_pose(&it.name, pose)?;
                within(
                    &it.name,
                    "width of a grip",
                    *width,
                    [1e-4, 1.0],
                    "0.1 mm to 1 m",
                )?;
            }
            if let Some(wall) = it.wall_m {
                let most = it.size_m.min() / 2.0;
                let range = "0.1 mm to half of the least length";
                within(&it.name, "wall", wall, [1e-4, most], range)?;
            }
            if let Some(peg) = &it.peg {
                check_pose(&it.name, &peg.tip)?;
                within(
                    &it.name,
                    "radius",
                    peg.radius_m,
                    [1e-4, 1.0],
                    "0.1 mm to 1 m",
                )?;
            }
        }
        self.check_holes()?;
        self.check_screws()?;
        self.check_hands()
    }

    fn check_holes(&self) -> Result<(), BuildError> {
        for it in &self.holes {
            check_pose(&it.name, &it.pose)?;
            within(
                &it.name,
                "radius",
                it.radius_m,
                [1e-4, 1.0],
                "0.1 mm to 1 m",
            )?;
            within(&it.name, "depth", it.depth_m, [1e-4, 1.0], "0.1 mm to 1 m")?;
            within(
                &it.name,
                "chamfer",
                it.chamfer_m,
                [0.0, it.depth_m],
                "0 to the depth",
            )?;
            let face = [it.radius_m + it.chamfer_m, 10.0];
            within(
                &it.name,
                "face",
                it.face_radius_m,
                face,
                "from the chamfer to 10 m",
            )?;
            let stiffest = [1.0, HOLE_STIFFNESS_MAX];
            within(
                &it.name,
                "stiffness",
                it.stiffness,
                stiffest,
                "1 to 200,000 N/m",
            )?;
            within(&it.name, "friction", it.friction, [0.0, 10.0], "0 to 10")?;
        }
        Ok(())
    }

    fn check_screws(&self) -> Result<(), BuildError> {
        for it in &self.screws {
            check_pose(&it.name, &it.pose)?;
            within(&it.name, "length", it.length_m, [1e-3, 1.0], "1 mm to 1 m")?;
        }
        for it in &self.threads {
            check_pose(&it.name, &it.pose)?;
            within(
                &it.name,
                "pitch",
                it.pitch_m,
                [1e-5, 0.1],
                "0.01 mm to 100 mm",
            )?;
            within(&it.name, "depth", it.depth_m, [1e-4, 1.0], "0.1 mm to 1 m")?;
            let torques = [it.running_nm, it.seating_nm_per_rad, it.strip_nm];
            for torque in torques {
                within(&it.name, "torque", torque, [0.0, 1e4], "0 to 10,000 Nm")?;
            }
            within(
                &it.name,
                "axial force",
                it.axial_n,
                [0.0, 1e4],
                "0 to 10,000 N",
            )?;
            within(&it.name, "capture", it.capture_m, [0.0, 0.1], "0 to 100 mm")?;
            within(&it.name, "tilt", it.tilt_rad, [0.0, 1.0], "0 to 1 rad")?;
        }
        Ok(())
    }

    fn check_hands(&self) -> Result<(), BuildError> {
        for (name, tool, kind) in &self.hands {
            check_pose(name, tool)?;
            if let Tool::Fingers(fingers) = kind {
                let it = &fingers.config;
                within(
                    name,
                    "stiffness",
                    it.stiffness,
                    [1.0, STIFFNESS_MAX],
                    "1 to 50,000 N/m",
                )?;
                let turn = [0.01, 500.0];
                within(
                    name,
                    "turn stiffness",
                    it.turn_stiffness,
                    turn,
                    "0.01 to 500 Nm/rad",
                )?;
                within(name, "friction", it.friction, [0.0, 10.0], "0 to 10")?;
                within(name, "pad", it.pad_m, [1e-4, 1.0], "0.1 mm to 1 m")?;
                for reach in it.reach_m {
                    within(name, "reach", reach, [1e-4, 1.0], "0.1 mm to 1 m")?;
                }
            }
        }
        Ok(())
    }
}

fn rest(
    config: &BodyConfig,
    bodies: &[Body],
    surfaces: &[Surface],
) -> Result<Option<(Carrier, Pose)>, BuildError> {
    let Some(name) = &config.rests_on else {
        return Ok(None);
    };
    if let Some(surface) = surfaces.iter().find(|it| it.config.name == *name) {
        // Surfaces do not move on their carriers.
        return Ok(Some((surface.carrier, surface.config.pose * config.pose)));
    }
    let names = bodies.iter().map(|body| &*body.config.name);
    let body = index(&config.name, name, names)?;
    Ok(Some((Carrier::Body(body), config.pose)))
}

fn index<'a>(
    part: &str,
    name: &str,
    mut names: impl Iterator<Item = &'a str>,
) -> Result<usize, BuildError> {
    names
        .position(|it| it == name)
        .ok_or_else(|| BuildError::Unknown {
            part: part.into(),
            name: name.into(),
        })
}

fn unique<'a>(kind: &'static str, names: impl Iterator<Item = &'a str>) -> Result<(), BuildError> {
    let mut seen: Vec<&str> = Vec::new();
    for name in names {
        if seen.contains(&name) {
            return Err(BuildError::Twice {
                kind,
                name: name.into(),
            });
        }
        seen.push(name);
    }
    Ok(())
}

fn check_pose(part: &str, pose: &Pose) -> Result<(), BuildError> {
    if finite_pose(pose) {
        return Ok(());
    }
    Err(range(part, "pose", "finite"))
}

fn within(
    part: &str,
    what: &'static str,
    value: f64,
    [least, most]: [f64; 2],
    text: &'static str,
) -> Result<(), BuildError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(range(part, what, text))
}

fn range(part: &str, what: &'static str, range: &'static str) -> BuildError {
    BuildError::Range {
        part: part.into(),
        what,
        range,
    }
}
