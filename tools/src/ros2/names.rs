//! Names of ROS for what a controller has. Names of ROS have letters, digits and `_` only.

use std::path::Path;
use std::str::FromStr;

use anyhow::Context as _;
use takt_api::{Arm, Cell};
use takt_motion::urdf::Urdf;

/// An arm with the names that ROS knows it by.
#[derive(Clone, Debug)]
pub(super) struct RosArm {
    pub(super) name: String,
    /// Names of its joints, from the base.
    pub(super) joints: Vec<String>,
    /// Its first and last link in the description.
    pub(super) links: Option<[String; 2]>,
    pub(super) arm: Arm,
}

/// Links between which an arm is in a description: `ARM=BASE:TIP`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Chain {
    arm: String,
    base: String,
    tip: String,
}

impl FromStr for Chain {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').and_then(|(arm, links)| {
            let (base, tip) = links.split_once(':')?;
            Some([arm, base, tip].map(str::to_owned))
        });
        match parts {
            Some([arm, base, tip]) if ![&arm, &base, &tip].iter().any(|it| it.is_empty()) => {
                Ok(Self { arm, base, tip })
            }
            _ => Err("write ARM=BASE:TIP, such as left=base_link:tool0".to_owned()),
        }
    }
}

/// A name as ROS permits it.
pub(super) fn ros_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = name.chars().map(plain).collect();
    if name.starts_with(|c: char| c.is_ascii_digit()) {
        format!("_{name}")
    } else {
        name
    }
}

/// The arms of a cell, with a description by its file and content. Without one their joints are called as in recordings: `left.joint_1`.
pub(super) fn arms(
    cell: &Cell,
    description: Option<(&Path, &Urdf)>,
    chains: &[Chain],
) -> anyhow::Result<Vec<RosArm>> {
    let all = cell.arms()?;
    let known: Vec<_> = all
        .iter()
        .map(|arm| arm.description().name.clone())
        .collect();
    if let Some(chain) = chains.iter().find(|chain| !known.contains(&chain.arm)) {
        anyhow::bail!(
            "--chain {}: the controller has no such arm\nhint: it has {}",
            chain.arm,
            known.join(", ")
        );
    }
    let is_one = all.len() == 1;
    let named = |arm: Arm| {
        let described = arm.description();
        let (device, count) = (described.name.clone(), described.joints.len());
        let chain = chains.iter().find(|chain| chain.arm == device);
        let links = chain.map(|chain| (Some(chain.base.as_str()), Some(chain.tip.as_str())));
        let links = links.or_else(|| is_one.then_some((None, None)));
        let (joints, links) = match description.zip(links) {
            Some(((path, urdf), (base, tip))) => {
                let model = urdf
                    .arm(base, tip)
                    .with_context(|| format!("{}: no arm for `{device}`", path.display()))?;
                let names: Vec<_> = model.joints.iter().map(|it| it.name.clone()).collect();
                anyhow::ensure!(
                    names.len() == count,
                    "{}: {} joints ({}) where `{device}` has {count}\nhint: --chain {device}=BASE:TIP names other links",
                    path.display(),
                    names.len(),
                    names.join(", ")
                );
                (names, Some([model.base, model.tip]))
            }
            None => {
                let names = (1..=count).map(|n| format!("{device}.joint_{n}"));
                (names.collect(), None)
            }
        };
        Ok(RosArm {
            name: ros_name(&device),
            joints,
            links,
            arm,
        })
    };
    let arms: Vec<RosArm> = all.into_iter().map(named).collect::<anyhow::Result<_>>()?;
    for (number, arm) in arms.iter().enumerate() {
        let before = arms.get(..number).unwrap_or_default();
        anyhow::ensure!(
            before.iter().all(|other| other.name != arm.name),
            "two arms are called `{}` in ROS\nhint: names differ in more than signs that ROS does not permit",
            arm.name
        );
    }
    Ok(arms)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ros_have_letters_digits_and_underscores() {
        for (name, wanted) in [("left", "left"), ("arm-2.b", "arm_2_b"), ("7th", "_7th")] {
            assert_eq!(ros_name(name), wanted);
        }
    }

    #[test]
    fn chain_is_arm_base_and_tip() {
        let chain = |text: &str| text.parse::<Chain>();
        let left = Chain {
            arm: "left".to_owned(),
            base: "base_l".to_owned(),
            tip: "tool0".to_owned(),
        };
        assert_eq!(chain("left=base_l:tool0"), Ok(left));
        for wrong in ["left", "left=base", "=a:b", "left=:b", "left=a:"] {
            assert!(chain(wrong).is_err(), "{wrong}");
        }
    }
}
