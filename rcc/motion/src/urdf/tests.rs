//! A whole arm from a file, and everything that can be wrong with one.

use takt_net::device::Kinematics;
use takt_tests::Random;

use super::*;
use crate::kinematics::{Structure, named};

const TX90: &str = include_str!("../../tests/arms/tx90.urdf");

fn refused(text: &str) -> String {
    let arm = Urdf::parse(text).and_then(|urdf| urdf.arm(None, None));
    arm.expect_err("refused").to_string()
}

/// The file with one text in place of another.
fn with(from: &str, to: &str) -> String {
    assert!(TX90.contains(from), "{from}");
    TX90.replace(from, to)
}

#[test]
fn urdf_of_known_arm_matches_its_model() {
    let arm = Urdf::parse(TX90).unwrap().arm(None, None).unwrap();
    assert_eq!((&*arm.base, &*arm.tip), ("base_link", "tool0"));
    assert_eq!(arm.serial.structure(), Structure::Opw);
    let known = named("staubli_tx90").unwrap();
    let mut random = Random::new(1);
    for _ in 0..100 {
        let joints: Vec<_> = (0..6).map(|_| random.between(-2.0, 2.0)).collect();
        let (own, wanted) = (arm.serial.forward(&joints), known.forward(&joints));
        assert!((own.translation.vector - wanted.translation.vector).norm() < 1e-12);
        assert!(own.rotation.angle_to(&wanted.rotation) < 1e-7);
    }
    assert_eq!(arm.joints[3].name, "joint_4");
    assert_eq!(arm.joints[1].velocity_max, Some(6.98));
    assert!((arm.dynamics.unwrap().mass() - 82.4).abs() < 1e-12);
    let meshes: Vec<_> = arm
        .visuals
        .iter()
        .filter(|it| matches!(it.shape, Shape::Mesh(..)))
        .collect();
    assert_eq!(meshes.len(), 1);
    assert_eq!(meshes[0].joint, 6, "the last joint moves it");
}

#[test]
fn urdf_with_named_links_gives_part_of_arm() {
    let urdf = Urdf::parse(TX90).unwrap();
    let arm = urdf.arm(Some("link_1"), Some("link_3")).unwrap();
    let names: Vec<_> = arm.joints.iter().map(|joint| &*joint.name).collect();
    assert_eq!(names, ["joint_2", "joint_3"]);
    let error = urdf
        .arm(Some("link_3"), Some("link_1"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("`link_1` is not behind link `link_3`"),
        "{error}"
    );
    let error = urdf.arm(None, Some("hand")).unwrap_err().to_string();
    assert!(
        error.contains("no link `hand`") && error.contains("tool0"),
        "{error}"
    );
}

/// Faults of a file: a text of it, the one in its place, and what the error names.
const FAULTS: &[(&str, &str, &str)] = &[
    (
        "type=\"revolute\"><parent link=\"link_2\"",
        "type=\"floating\"><parent link=\"link_2\"",
        "line 24: joint `joint_3` of the arm moves in more than one direction",
    ),
    (
        "lower=\"-2.5307\" upper=\"2.5307\" ",
        "",
        "line 24: joint `joint_3` has no limits",
    ),
    (
        "lower=\"-2.5307\" upper=\"2.5307\"",
        "lower=\"-145\" upper=\"145\"",
        "line 25: joint `joint_3` may turn to 145 rad",
    ),
    (
        "lower=\"-2.5307\" upper=\"2.5307\"",
        "lower=\"1\" upper=\"-1\"",
        "line 25: the range of joint `joint_3` is 1 to -1",
    ),
    (
        "0 0.05 0.425",
        "0 50 425",
        "line 24: joint `joint_3` is 428 m from the one before it",
    ),
    (
        "0 0.05 0.425",
        "0 0.05 x",
        "line 25: `xyz` of `origin` is \"0 0.05 x\", not 3 numbers",
    ),
    (
        "0 0.05 0.425",
        "0 0.05",
        "line 25: `xyz` of `origin` is \"0 0.05\", not 3 numbers",
    ),
    (
        "0 0.05 0.425",
        "0 NaN 1",
        "line 25: `xyz` of `origin` is \"0 NaN 1\"",
    ),
    (
        "<child link=\"link_3\"/>",
        "<child link=\"link_2\"/>",
        "line 24: link `link_2` is behind joint `joint_3` and behind joint `joint_2` (line 22): a loop",
    ),
    (
        "<parent link=\"base_link\"/>",
        "<parent link=\"tool0\"/>",
        "is behind itself: a loop",
    ),
    (
        "<link name=\"tool0\"/>",
        "<link name=\"tool0\"/><link name=\"floor\"/>",
        "2 links are behind no joint: `base_link`, `floor`",
    ),
    (
        "<link name=\"tool0\"/>",
        "",
        "names the link `tool0`, which is not there",
    ),
    (
        "<link name=\"tool0\"/>",
        "<link name=\"link_6\"/>",
        "link `link_6` is there twice, first in line 15",
    ),
    (
        "name=\"joint_2\"",
        "name=\"joint_1\"",
        "joint `joint_1` is there twice",
    ),
    (
        "type=\"fixed\"",
        "type=\"weld\"",
        "joint `flange` has the type \"weld\"",
    ),
    (
        "<axis xyz=\"0 0 1\"/><limit lower=\"-3.14159265\"",
        "<axis xyz=\"0 0 0\"/><limit lower=\"-3.14159265\"",
        "the axis of joint `joint_1` has no direction",
    ),
    ("<robot name", "<sdf name", "this is no XML"),
    (
        "effort=\"76\" velocity=\"7.5\"/>",
        "effort=\"76\" velocity=\"7.5\"/><mimic joint=\"joint_2\"/>",
        "joint `joint_3` of the arm follows joint `joint_2`",
    ),
    (
        "0.05 0 0.478",
        "${x} 0 0.478",
        "line 23: this is a file of macros (xacro)\nhint: expand it first",
    ),
    ("<link name=\"tool0\"/>", "<xacro:arm/>", "this is no XML"),
];

#[test]
fn urdf_with_fault_names_line_and_cause() {
    for (from, to, wanted) in FAULTS {
        let error = refused(&with(from, to));
        assert!(error.contains(wanted), "{from} -> {to}: {error}");
    }
    assert!(refused(&with("<link name=\"tool0\"/>", "<xacro:arm/>")).contains("expand it first"));
    assert!(refused("<sdf/>").contains("describes a `sdf`, not a `robot`"));
    assert!(refused("<robot/>").contains("has no links"));
    assert!(refused("").contains("this is no XML"));
}

#[test]
fn urdf_with_several_faults_names_all() {
    let text = with("0 0.05 0.425", "0 0.05 x").replace("type=\"fixed\"", "type=\"weld\"");
    let error = Urdf::parse(&text).unwrap_err();
    assert!(error.findings.len() >= 2, "{error}");
}

#[test]
fn urdf_with_two_arms_asks_for_tip() {
    let mut text = with("</robot>", "");
    for number in 1..=6 {
        text += &format!("<link name=\"r{number}\"/>");
        let parent = if number == 1 {
            "base_link".to_owned()
        } else {
            format!("r{}", number - 1)
        };
        text += &format!(
            "<joint name=\"right_{number}\" type=\"continuous\"><parent link=\"{parent}\"/><child link=\"r{number}\"/></joint>"
        );
    }
    text += "</robot>";
    let error = refused(&text);
    assert!(
        error.contains("several arms: the joints `joint_1`, `right_1` part at link `base_link`"),
        "{error}"
    );
    let urdf = Urdf::parse(&text).unwrap();
    let arm = urdf.arm(None, Some("tool0")).unwrap();
    assert_eq!(arm.joints.len(), 6);
    assert!(
        arm.warnings
            .iter()
            .any(|it| it.cause.contains("`right_1` is not one of the arm"))
    );
}

#[test]
fn urdf_with_gripper_ends_at_hand() {
    let finger = |name: &str, more: &str| {
        format!(
            "<link name=\"{name}\"/><joint name=\"{name}_joint\" type=\"prismatic\"><parent link=\"hand\"/><child link=\"{name}\"/>\
            <limit lower=\"0\" upper=\"0.04\"/>{more}</joint>"
        )
    };
    let mut text = with("\"tool0\"", "\"hand\"").replace("</robot>", "");
    text += &(finger("left", "") + &finger("right", "<mimic joint=\"left_joint\"/>") + "</robot>");
    let arm = Urdf::parse(&text).unwrap().arm(None, None).unwrap();
    assert_eq!((&*arm.tip, arm.joints.len()), ("hand", 6));
    assert_eq!(arm.warnings.len(), 2, "both fingers are taken as fixed");
}

#[test]
fn urdf_that_nests_or_grows_without_bound_is_refused() {
    let deep = format!("<robot>{}", "<link>".repeat(1_000_000));
    assert!(refused(&deep).contains("nested more than"));
    let large = format!("<robot>{}</robot>", " ".repeat(FILE_MAX));
    assert!(refused(&large).contains("bytes"));
    let entities = "<!DOCTYPE a [<!ENTITY b \"x\">]><robot>&b;</robot>";
    assert!(refused(entities).contains("no XML"));
    let loops = "<robot><link name=\"a\"/><link name=\"b\"/><link name=\"c\"/>\
        <joint name=\"p\" type=\"fixed\"><parent link=\"b\"/><child link=\"c\"/></joint>\
        <joint name=\"q\" type=\"fixed\"><parent link=\"c\"/><child link=\"b\"/></joint></robot>";
    assert!(refused(loops).contains("a loop"));
}

#[test]
fn urdf_with_impossible_inertia_warns() {
    let text = with(
        "iyy=\"0.6\" iyz=\"0\" izz=\"0.4\"",
        "iyy=\"0.6\" iyz=\"0\" izz=\"9\"",
    );
    let arm = Urdf::parse(&text).unwrap().arm(None, None).unwrap();
    assert!(
        arm.warnings[0]
            .to_string()
            .starts_with("line 7: no body has the mass")
    );
}

#[test]
fn urdf_meshes_are_found_or_named_with_line() {
    let folder = std::env::temp_dir().join(format!("takt-urdf-{}", std::process::id()));
    let meshes = folder.join("arm_description/meshes");
    let urdf = folder.join("arm_description/urdf");
    for folder in [&meshes, &urdf] {
        std::fs::create_dir_all(folder).unwrap();
    }
    std::fs::write(meshes.join("tool.stl"), "solid").unwrap();
    let name = TX90.split("filename=\"").nth(1).unwrap();
    let name = name.split('"').next().unwrap();
    let path = urdf.join("arm.urdf");
    for (mesh, is_found) in [
        ("package://arm_description/meshes/tool.stl", true),
        ("../meshes/tool.stl", true),
        ("package://arm_description/meshes/other.stl", false),
        ("package://arm_description/../../../etc/passwd", false),
        ("package://nowhere/tool.stl", false),
        ("../meshes", false),
    ] {
        std::fs::write(&path, with(name, mesh)).unwrap();
        let arm = read_arm(&path, None, None).unwrap();
        assert_eq!(arm.file, "arm.urdf");
        let shapes = arm.visuals.iter().map(|it| &it.shape);
        let found = shapes.filter_map(|shape| match shape {
            Shape::Mesh(file, _) => Some(&**file),
            Shape::Box(_) | Shape::Cylinder(..) | Shape::Sphere(_) => None,
        });
        let found = found.collect::<Vec<_>>()[0];
        if is_found {
            assert!(arm.warnings.is_empty(), "{mesh}: {:?}", arm.warnings);
            assert_eq!(std::fs::read_to_string(found).unwrap(), "solid");
        } else {
            assert_eq!(found, mesh);
            let warning = arm.warnings[0].to_string();
            let named = format!("the mesh `{mesh}` of link");
            assert!(
                warning.starts_with("line ") && warning.contains(&named),
                "{warning}"
            );
        }
    }
    let error = read_arm(&folder.join("none.urdf"), None, None).unwrap_err();
    assert!(error.to_string().contains("No such file"), "{error}");
    let error = read_arm(&folder, None, None).unwrap_err().to_string();
    assert!(error.contains("it is no file"), "{error}");
    std::fs::remove_dir_all(folder).unwrap();
}
