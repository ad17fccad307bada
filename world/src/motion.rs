//! Motion of what others drive (hands, bases): poses at posted times, and in between. It checks no limits of robots.

use crate::geometry::{Pose, Twist, finite_pose, moved};
use std::time::Duration;

/// A hand that posts nothing goes on for this long, s; then it stands still.
const EXTRAPOLATION_MAX_S: f64 = 0.02;
/// The same of a base, which is slower, and whose thread has less priority.
const BASE_EXTRAPOLATION_MAX_S: f64 = 0.1;
/// A faster move between two posts is a jump: the hand stands at the new pose at once, without a speed, m/s.
const SPEED_MAX: f64 = 20.0;

/// A pose at a time.
#[derive(Debug, Clone, Copy)]
struct Post {
    at: Duration,
    pose: Pose,
    twist: Twist,
}

/// Motion of a hand or base, interpolated between posts and extrapolated beyond the last.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    posts: Option<[Post; 2]>,
    /// How long it goes on beyond the last post, s.
    beyond_max_s: f64,
    /// Posts that were refused: not finite, or of a time before the last.
    pub(crate) refused: u64,
}

impl Motion {
    pub(crate) const fn new() -> Self {
        Self {
            posts: None,
            beyond_max_s: EXTRAPOLATION_MAX_S,
            refused: 0,
        }
    }

    pub(crate) const fn of_base() -> Self {
        Self {
            beyond_max_s: BASE_EXTRAPOLATION_MAX_S,
            ..Self::new()
        }
    }

    /// Takes a post; false if it is refused.
    pub(crate) fn post(&mut self, at: Duration, pose: &Pose, twist: Option<Twist>) -> bool {
        let is_sound = finite_pose(pose) && twist.is_none_or(|twist| twist.is_finite());
        let is_old = self.posts.is_some_and(|[_, last]| at < last.at);
        if !is_sound || is_old {
            self.refused += 1;
            return false;
        }
        let start = Post {
            at,
            pose: *pose,
            twist: Twist::default(),
        };
        let last = match self.posts {
            Some([first, last]) if at == last.at => first,
            Some([_, last]) => last,
            None => start,
        };
        let span = at.saturating_sub(last.at).as_secs_f64();
        let way = (pose.translation.vector - last.pose.translation.vector).norm();
        let jumps = span > 0.0 && way / span > SPEED_MAX;
        let mean = Twist::between(&last.pose, pose, span);
        let new = Post {
            at,
            pose: *pose,
            twist: match twist {
                _ if jumps => Twist::default(),
                Some(twist) => bounded(&twist),
                None => mean,
            },
        };
        self.posts = Some([if jumps { new } else { last }, new]);
        true
    }

    /// Pose and twist at a time; `None` before the first post.
    pub(crate) fn at(&self, at: Duration) -> Option<(Pose, Twist)> {
        let [first, last] = self.posts?;
        if at >= last.at || first.at >= last.at {
            let beyond = at.saturating_sub(last.at).as_secs_f64();
            let pose = moved(&last.pose, &last.twist, beyond.min(self.beyond_max_s));
            let twist = if beyond > self.beyond_max_s {
                Twist::default()
            } else {
                last.twist
            };
            return Some((pose, twist));
        }
        let span = (last.at - first.at).as_secs_f64();
        let twist = Twist::between(&first.pose, &last.pose, span);
        let since = at.saturating_sub(first.at).as_secs_f64();
        Some((moved(&first.pose, &twist, since), twist))
    }
}

fn bounded(twist: &Twist) -> Twist {
    Twist {
        linear: twist.linear.cap_magnitude(SPEED_MAX),
        angular: twist.angular.cap_magnitude(SPEED_MAX),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn motion_between_posts_is_interpolated() {
        let mut motion = Motion::new();
        assert!(motion.at(MS).is_none());
        assert!(motion.post(MS, &Pose::translation(0.0, 0.0, 0.0), None));
        assert!(motion.post(3 * MS, &Pose::translation(0.002, 0.0, 0.0), None));
        let (pose, twist) = motion.at(2 * MS).unwrap();
        assert!((pose.translation.x - 0.001).abs() < 1e-12);
        assert!((twist.linear.x - 1.0).abs() < 1e-9);
        let (pose, _) = motion.at(13 * MS).unwrap();
        assert!((pose.translation.x - 0.012).abs() < 1e-12, "extrapolated");
        let (pose, twist) = motion.at(1000 * MS).unwrap();
        assert!((pose.translation.x - 0.022).abs() < 1e-12, "stands still");
        assert_eq!(twist, Twist::default());
    }

    #[test]
    fn motion_unsound_posts_are_refused() {
        let mut motion = Motion::new();
        assert!(!motion.post(MS, &Pose::translation(f64::NAN, 0.0, 0.0), None));
        assert!(motion.post(2 * MS, &Pose::identity(), None));
        assert!(!motion.post(MS, &Pose::identity(), None), "old");
        assert_eq!(motion.refused, 2);
        assert!(motion.post(3 * MS, &Pose::translation(5.0, 0.0, 0.0), None));
        let (pose, twist) = motion.at(3 * MS).unwrap();
        assert!((pose.translation.x - 5.0).abs() < 1e-12 && twist == Twist::default());
    }
}
