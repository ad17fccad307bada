//! Screws, threads and the bit of a screwdriver: feed per turn, torque, seat, cross-threading, cam-out. A screw has no
//! inertia: it lies in the magazine, hangs at the bit, or is in a thread.

use crate::body::Carrier;
use crate::event::EventKind;
use crate::geometry::{Pose, local, origin};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Spring between bit and screw along the axis, N/m.
pub(crate) const BIT_STIFFNESS: f64 = 20_000.0;
/// Spring across the axis in the recess of the head, N/m.
pub(crate) const RECESS_STIFFNESS: f64 = 5_000.0;
/// Damping of both, Ns/m.
pub(crate) const BIT_DAMPING: f64 = 60.0;
/// The bit takes a screw whose head is this near, m.
const TAKES: f64 = 0.003;
/// The bit has left the head when it is this far, m.
const LEAVES: f64 = 0.004;
/// A screw askew jams after this many turns more than needed to bite, rad.
const CROSS_FREE: f64 = TAU * 0.75;
/// Torque of a screw askew per angle, Nm/rad.
const CROSS_RATE: f64 = 0.35;

/// A screw, for [`Builder::screw`](crate::Builder::screw).
#[derive(Debug, Clone, PartialEq)]
pub struct ScrewConfig {
    /// Its name, unique among screws.
    pub name: String,
    /// Middle of its head in the magazine, z outwards, where the bit comes from.
    pub pose: Pose,
    /// From the head to the tip, m.
    pub length_m: f64,
}

/// A threaded hole, for [`Builder::thread`](crate::Builder::thread).
#[derive(Debug, Clone, PartialEq)]
pub struct ThreadConfig {
    /// Its name, unique among threads.
    pub name: String,
    /// Its mouth, z outwards; in the frame of the body, or in the world.
    pub pose: Pose,
    /// Body in which it is; `None` for the world.
    pub in_body: Option<String>,
    /// Feed per turn, m.
    pub pitch_m: f64,
    /// Depth at which the head seats, m.
    pub depth_m: f64,
    /// Torque on the way, Nm.
    pub running_nm: f64,
    /// Rise of the torque once the head is seated, Nm/rad.
    pub seating_nm_per_rad: f64,
    /// Torque at which the thread gives way, Nm.
    pub strip_nm: f64,
    /// Axial force below which the bit turns without the screw, N.
    pub axial_n: f64,
    /// The screw finds the mouth from this far, m; from half of it without being askew.
    pub capture_m: f64,
    /// Tilt beyond which it bites askew, rad.
    pub tilt_rad: f64,
}

impl ThreadConfig {
    /// An M4 thread of 8 mm in aluminium: 0.7 mm pitch, 0.05 Nm on the way, 0.6 Nm/rad, strips at 4 Nm.
    #[must_use]
    pub fn m4(name: &str, pose: Pose, in_body: Option<&str>) -> Self {
        Self {
            name: name.into(),
            pose,
            in_body: in_body.map(Into::into),
            pitch_m: 0.000_7,
            depth_m: 0.008,
            running_nm: 0.05,
            seating_nm_per_rad: 0.6,
            strip_nm: 4.0,
            axial_n: 5.0,
            capture_m: 0.001_5,
            tilt_rad: 0.05,
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Thread {
    pub(crate) config: ThreadConfig,
    pub(crate) carrier: Carrier,
    /// As of this step.
    pub(crate) pose: Pose,
    pub(crate) is_taken: bool,
}

/// Where a screw is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    Magazine,
    /// At the bit of this hand.
    Bit(usize),
    /// In this thread.
    Thread(usize),
    /// Removed from the world.
    Missing,
}

#[derive(Debug, Clone)]
pub(crate) struct Screw {
    pub(crate) config: ScrewConfig,
    pub(crate) place: Place,
    /// Turned into the thread, rad.
    pub(crate) turned: f64,
    pub(crate) is_cross: bool,
    pub(crate) is_seated: bool,
    pub(crate) is_stripped: bool,
    pub(crate) torque: f64,
    pub(crate) torque_max: f64,
    pub(crate) bit_slips: bool,
}

impl Screw {
    pub(crate) const fn new(config: ScrewConfig) -> Self {
        Self {
            config,
            place: Place::Magazine,
            turned: 0.0,
            is_cross: false,
            is_seated: false,
            is_stripped: false,
            torque: 0.0,
            torque_max: 0.0,
            bit_slips: false,
        }
    }

    /// How deep it is, m.
    pub(crate) fn depth(&self, thread: &ThreadConfig) -> f64 {
        let feed = if self.is_cross { 0.5 } else { 1.0 };
        (self.turned / TAU * thread.pitch_m * feed).min(thread.depth_m)
    }

    /// Whether the bit at this pose takes it out of the magazine.
    pub(crate) fn is_taken_by(&self, bit: &Pose) -> bool {
        let off = local(&self.config.pose, &origin(bit));
        self.place == Place::Magazine && off.xy().norm() < TAKES && (-TAKES..0.001).contains(&off.z)
    }

    /// Turns it by `angle` with this axial force; the torque against it, Nm.
    pub(crate) fn turn(
        &mut self,
        thread: &ThreadConfig,
        angle: f64,
        axial_n: f64,
        mut report: impl FnMut(EventKind),
    ) -> f64 {
        if angle.abs() <= 0.0 {
            return self.torque;
        }
        // Backwards, the thread itself pushes the screw against the bit.
        let slips = axial_n < thread.axial_n && angle > 0.0 && !self.is_stripped;
        if slips {
            if !self.bit_slips {
                report(EventKind::BitSlipped {
                    screw: self.config.name.clone(),
                });
            }
            self.bit_slips = true;
            self.torque = thread.running_nm.copysign(angle) * 0.5;
            return self.torque;
        }
        self.bit_slips = false;
        self.turned = (self.turned + angle).max(0.0);
        let seat = thread.depth_m / thread.pitch_m * TAU;
        self.is_seated &= self.turned >= seat;
        let (free, rate) = if self.is_cross {
            (CROSS_FREE, CROSS_RATE)
        } else {
            (seat, thread.seating_nm_per_rad)
        };
        let beyond = (self.turned - free).max(0.0);
        let torque = if self.is_stripped {
            thread.running_nm
        } else {
            thread.running_nm + rate * beyond
        };
        if beyond > 0.0 && !self.is_cross && !self.is_seated {
            self.is_seated = true;
            report(EventKind::ScrewSeated {
                screw: self.config.name.clone(),
            });
        }
        if torque > thread.strip_nm && !self.is_stripped {
            self.is_stripped = true;
            report(EventKind::Stripped {
                screw: self.config.name.clone(),
            });
        }
        self.torque = if angle > 0.0 {
            torque
        } else {
            -thread.running_nm
        };
        self.torque_max = self.torque_max.max(self.torque);
        if self.turned <= 0.0 {
            (self.is_cross, self.torque) = (false, 0.0);
        }
        self.torque
    }
}

/// Bit of a hand at run time.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Bit {
    /// Angle of the last post, rad.
    pub(crate) angle: Option<f64>,
    /// Axial force on the screw in this step, N.
    pub(crate) axial: f64,
    /// Torque on the screw, Nm.
    pub(crate) torque: f64,
    pub(crate) screw: Option<usize>,
}

/// Whether the bit has left a head that is `beyond` it, m.
pub(crate) fn has_left(beyond: f64) -> bool {
    beyond < -LEAVES
}

/// A turning screw bites where its tip presses on a mouth.
pub(crate) fn engage(
    screw: &mut Screw,
    threads: &mut [Thread],
    (tcp, axial): (&Pose, f64),
    cross: bool,
    mut report: impl FnMut(EventKind),
) {
    let way = tcp.rotation * Vector3::z();
    let tip = origin(tcp) + way * screw.config.length_m;
    for (index, thread) in threads.iter_mut().enumerate() {
        let off = local(&thread.pose, &tip).xy().norm();
        let tilt = -way.dot(&(thread.pose.rotation * Vector3::z()));
        let presses = axial >= thread.config.axial_n;
        if thread.is_taken || off > thread.config.capture_m || !presses || tilt < 0.5 {
            continue;
        }
        let askew =
            off > thread.config.capture_m / 2.0 || tilt.min(1.0).acos() > thread.config.tilt_rad;
        screw.is_cross = cross || askew;
        screw.place = Place::Thread(index);
        thread.is_taken = true;
        let (screw, thread) = (screw.config.name.clone(), thread.config.name.clone());
        report(if cross || askew {
            EventKind::CrossThreaded { screw, thread }
        } else {
            EventKind::ScrewEngaged { screw, thread }
        });
        return;
    }
}
