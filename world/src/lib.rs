#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod body;
mod builder;
mod dock;
mod event;
mod geometry;
mod grasp;
mod handle;
mod hole;
mod motion;
mod random;
mod scene;
mod screw;
mod solver;
mod station;
mod surface;
mod touch;
mod truth;

pub use body::BodyConfig;
pub use builder::{BuildError, Builder};
pub use dock::DockConfig;
pub use event::{Event, EventKind};
pub use geometry::{Pose, Twist, Wrench};
pub use grasp::GraspConfig;
pub use handle::{Base, Fingers, Hand, Screwdriver, Stopped, World};
pub use hole::{HoleConfig, PegConfig};
pub use scene::Knobs;
pub use screw::{ScrewConfig, ThreadConfig};
pub use station::{assembly, assembly_unloaded};
pub use surface::SurfaceConfig;
pub use truth::{BodyTruth, HandTruth, PegTruth, ScrewTruth, Truth};
