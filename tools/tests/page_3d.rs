//! The 3-D view and the plots in a real browser: pictures change while a robot moves, and numbers are those of the controller.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on ends"
)]

#[path = "common/browser.rs"]
mod browser;
mod common;

use std::collections::BTreeMap;

use browser::Browser;
use common::{Cell, Process, alone};
use takt_tests::steady;

/// Keeps what a page offers for saving, as texts by their names.
const KEEP_SAVED: &str = "window.saved = null; URL.createObjectURL = blob => { blob.text().then(text => { window.saved = text; }); return '#plots'; }; \
    HTMLAnchorElement.prototype.click = () => {}; true";
/// A number that changes with the pixels of the next picture of the 3-D view; 0 without a picture within a second.
const PIXELS: &str = "new Promise(done => { const end = performance.now() + 1000; const before = document.querySelector('canvas.space')?.dataset.frames; \
    const look = () => { const canvas = document.querySelector('canvas.space'); if (performance.now() > end) return done(0); \
    if (!canvas || canvas.dataset.frames === before) return requestAnimationFrame(look); \
    let sum = 1; for (const letter of canvas.toDataURL()) sum = (sum * 31 + letter.charCodeAt(0)) % 1000003; done(sum); }; requestAnimationFrame(look); })";

/// What the last picture of the 3-D view has.
const CONTENTS: &str =
    "JSON.parse(document.querySelector('canvas.space')?.dataset.contents ?? '{}')";

/// A browser; notes the skip of `test` without one.
fn browser(test: &str) -> Option<Browser> {
    Browser::start()
        .map_err(|why| takt_tests::skip(test, &why))
        .ok()
}

/// A slow motion of the arm of a cell.
fn motion(cell: &Cell) -> Process {
    let goal = ["0", "30deg", "0", "-70deg", "0", "45deg", "0"];
    let end = ["--yes", "--speed", "0.05", "--connect", &cell.tcp];
    Process::start(&[&["move", "left", "ptp"][..], &goal, &end].concat())
}

/// Waits until an expression is true.
#[track_caller]
fn wait(browser: &mut Browser, expression: &str) {
    for _ in 0..900 {
        if browser.value(expression) == true {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
    }
    panic!(
        "{expression} stays false: {}\n{:?}",
        browser.text(""),
        browser.errors
    );
}

#[test]
fn cell_view_moves_with_its_robot() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("cell_view_moves_with_its_robot") else {
            return;
        };
        let mut cell = Cell::start();
        let _arm = cell.arm();
        browser.open(&format!("http://{}/#cell", cell.http));
        wait(
            &mut browser,
            "/^left\\tflange\\t-?\\d/m.test(document.body.innerText)",
        );
        // The flange as the page computes it is that of the controller.
        let shown = browser.value(
            "(async () => { const at = [...document.querySelectorAll('td')].slice(2, 5).map(td => Number(td.textContent)); \
             const { x, y, z } = (await (await fetch('/devices/left/armkinematics?format=json')).json()).data[0].value.pos; return [at, [x, y, z].map(Number)]; })()",
        );
        for axis in 0..3 {
            let [page, controller] = [0, 1].map(|side| shown[side][axis].as_f64().unwrap());
            assert!((page - controller).abs() < 2e-4, "{shown}");
        }
        let has_picture =
            browser.value("!!document.querySelector('canvas.space')?.dataset.frames") == true;
        assert!(has_picture, "{}", browser.text(""));
        let (still, before) = (browser.value(PIXELS), browser.text("view"));
        assert_ne!(still, 0, "no picture is drawn");
        let moving = motion(&cell);
        wait(
            &mut browser,
            &format!("{PIXELS}.then(sum => sum !== 0 && sum !== {still})"),
        );
        wait(
            &mut browser,
            "Number(document.querySelector('canvas.space').dataset.frames) > 5",
        );
        // The table follows four times a second.
        let shown = "document.getElementById('view').innerText";
        wait(
            &mut browser,
            &format!("{shown} !== {}", serde_json::Value::from(before)),
        );
        for (name, width, is_dark) in [
            ("cell-light-1280", 1280, false),
            ("cell-dark-390", 390, true),
        ] {
            browser.resize(width, 900, is_dark);
            browser.picture(name);
        }
        drop(moving);
        assert_eq!(browser.errors, [""; 0]);
    });
}

#[test]
fn cell_view_of_factory_shows_all_that_it_has() {
    let _alone = alone();
    let Some(mut browser) = browser("cell_view_of_factory_shows_all_that_it_has") else {
        return;
    };
    let mut command = common::takt(&["demo", "--open", "--robots", "factory", "--duration", "5s"]);
    command.env("PATH", "/nonexistent");
    let mut demo = Process::spawn(command);
    let line = demo.wait_for("http://127.0.0.1:");
    browser.resize(1280, 900, false);
    browser.open(&format!("{}#cell", line.rsplit(' ').next().unwrap()));
    wait(
        &mut browser,
        "/^right\\tscrewdriver\\t-?\\d/m.test(document.body.innerText) && /^hand\\t/m.test(document.body.innerText)",
    );
    // The arm of the youBot stands on its base, and so on the floor of the cell.
    wait(
        &mut browser,
        "/^arm\\tflange\\t-?\\d/m.test(document.body.innerText)",
    );
    let labels = "[...document.querySelectorAll('.space-labels span')].map(it => it.className + ' ' + it.textContent)";
    wait(&mut browser, &format!("{labels}.length > 12"));
    let labels = browser.value(labels);
    let has = |label: &str| labels.as_array().unwrap().iter().any(|it| it == label);
    for label in [
        "device left",
        "device right",
        "device tx90",
        "device base",
        "device arm",
        "device hand",
        "frame world",
        "frame bench",
        "object table",
        "object pedestal",
        "object supply",
        "object column",
        "object screws",
    ] {
        assert!(has(label), "{label} is missing in {labels}");
    }
    let objects = browser.value(&format!("{CONTENTS}.objects.sort().join()"));
    assert_eq!(objects, "column,pedestal,screws,supply,table");
    // Trails of the tools grow while the arms move, and end when they are cleared.
    let trails = format!("Object.values({CONTENTS}.trails).filter(it => it > 20).length >= 2");
    wait(&mut browser, &trails);
    // A ghost stands beside its arm: the arms follow their set-points late.
    browser.value(&format!(
        "window.ghosts = {{}}; window.watching = setInterval(() => {{ for (const [name, it] of Object.entries({CONTENTS}.ghosts ?? {{}})) \
           window.ghosts[name] = Math.hypot(...it.at.map((v, n) => v - it.measured[n])); }}, 20); true"
    ));
    wait(
        &mut browser,
        "Object.values(window.ghosts).some(apart => apart > 1e-4 && apart < 0.3)",
    );
    browser.picture("factory-light-1280");
    assert_switch_hides(
        &mut browser,
        "commanded ghost",
        "Object.keys(it.ghosts).length === 0",
    );
    assert_switch_hides(&mut browser, "trail", "Object.keys(it.trails).length === 0");
    for (name, width, height, is_dark) in [
        ("factory-dark-1280", 1280, 900, true),
        ("factory-light-390", 390, 844, false),
        ("factory-dark-390", 390, 844, true),
    ] {
        browser.resize(width, height, is_dark);
        std::thread::sleep(std::time::Duration::from_secs(1));
        browser.picture(name);
    }
    assert_eq!(browser.errors, [""; 0]);
}

/// Switches a part of the picture off, waits for a picture without it, and switches it on again.
#[track_caller]
fn assert_switch_hides(browser: &mut Browser, label: &str, is_hidden: &str) {
    let press = format!(
        "[...document.querySelectorAll('.row label')].find(it => it.textContent.trim() === '{label}').querySelector('input').click(); true"
    );
    browser.value(&press);
    wait(browser, &format!("(it => {is_hidden})({CONTENTS})"));
    browser.value(&press);
}

/// The force at the arm's tool as a scope samples it, N.
fn sampled_force(cell: &Cell) -> f64 {
    let folder = common::Folder::new();
    let file = folder.file("force.csv");
    let probes = ["left.force.x", "left.force.y", "left.force.z"];
    let to = ["--duration", "300ms", "--csv", &file, "--connect"];
    let scope = [&["scope", "--probe"][..], &probes, &to, &[&cell.http]];
    common::expect_status(&common::run(&scope.concat()), 0);
    let text = std::fs::read_to_string(&file).unwrap();
    let last = text.lines().last().unwrap().split(',').skip(1);
    let squares = last.map(|it| it.parse::<f64>().unwrap().powi(2));
    squares.sum::<f64>().sqrt()
}

#[test]
fn cell_view_shows_contact_force_as_arrow() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("cell_view_shows_contact_force_as_arrow") else {
            return;
        };
        let mut cell = Cell::start();
        // An obstacle against which the arm rests.
        let args = ["emulate", "lwr", "--connect", &cell.udp, "--contact"];
        let _arm = Process::start(&[&args[..], &["spring:0.02"]].concat());
        cell.process.wait_for("now=operational");
        browser.open(&format!("http://{}/#cell", cell.http));
        wait(&mut browser, &format!("{CONTENTS}.forces?.left > 0.5"));
        let label = "document.querySelector('.space-labels .force')?.textContent ?? ''";
        wait(&mut browser, &format!("/^\\d.* N$/.test({label})"));
        let shown = browser.value(&format!("{CONTENTS}.forces.left"));
        let (shown, sampled) = (shown.as_f64().unwrap(), sampled_force(&cell));
        assert!(
            (shown - sampled).abs() < 0.2 * sampled,
            "{shown} N shown, {sampled} N sampled"
        );
        browser.picture("force-light-1280");
        assert_switch_hides(
            &mut browser,
            "forces",
            "Object.keys(it.forces).length === 0",
        );
        assert_eq!(browser.errors, [""; 0]);
    });
}

/// An arm of two joints: a box as its base, a good mesh, and one that is cut off beside a sphere.
const URDF: &str = r#"<robot name="two">
  <link name="base"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
  <link name="one"><visual><origin xyz="0 0 0.2"/><geometry><mesh filename="good.stl" scale="0.2 0.2 0.4"/></geometry></visual></link>
  <link name="two"><visual><geometry><mesh filename="cut.stl"/></geometry></visual><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
</robot>"#;

/// A tetrahedron as binary STL.
fn tetrahedron() -> Vec<u8> {
    let corners = [
        [-0.5, -0.5, -0.5],
        [0.5, -0.5, -0.5],
        [0.0, 0.5, -0.5],
        [0.0, 0.0, 0.5_f32],
    ];
    let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let mut bytes = vec![0; 80];
    bytes.extend(4_u32.to_le_bytes());
    for face in faces {
        bytes.extend([0; 12]);
        let values = face.into_iter().flat_map(|corner: usize| corners[corner]);
        bytes.extend(values.flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

#[test]
fn cell_view_draws_meshes_that_urdf_names() {
    let _alone = alone();
    let Some(mut browser) = browser("cell_view_draws_meshes_that_urdf_names") else {
        return;
    };
    let folder = common::Folder::new();
    let urdf = folder.write("two.urdf", URDF);
    let mesh = tetrahedron();
    std::fs::write(folder.file("good.stl"), &mesh).unwrap();
    std::fs::write(folder.file("cut.stl"), &mesh[..200]).unwrap();
    let mut cell = Cell::start_with(&format!(
        "[[device]]\nname = \"two arm\"\ntype = \"arm_sim\"\nmodel = \"urdf:{urdf}\"\n"
    ));
    browser.open(&format!("http://{}/#cell", cell.http));
    wait(
        &mut browser,
        "document.querySelector('canvas.space')?.dataset.meshes === '1'",
    );
    let shown = browser.wait_for("view", "Drawn as simple solids:");
    assert!(
        shown.contains("cut.stl: it is no STL file, or cut off"),
        "{shown}"
    );
    cell.process.wait_for("cut.stl is drawn as a simple solid");
    // The box and the mesh replace the simple solids of their links.
    let drawn = browser.value(
        "fetch('/geometry/?format=json').then(it => it.json()).then(it => it.device.find(it => it.name === 'two arm').solid.filter(it => it.role === 'visual').map(it => it.kind + it.link).join())",
    );
    assert_eq!(drawn, "box0,mesh1,mesh2,capsule2");
    let good = "/geometry/meshes/two%20arm/1";
    let got = browser.value(&format!(
        "fetch('{good}').then(it => it.arrayBuffer()).then(it => it.byteLength)"
    ));
    assert_eq!(got, mesh.len());
    // No other file, whatever the path is.
    for path in [
        "two%20arm/0",
        "two%20arm/2",
        "two%20arm/9",
        "two%20arm/-1",
        "two%20arm/..%2f..%2fgood.stl",
        "left/1",
        "two%20arm",
        "none/1",
    ] {
        let status = browser.value(&format!(
            "fetch('/geometry/meshes/{path}').then(it => it.status)"
        ));
        let expected = if path == "two%20arm/2" { 409 } else { 404 };
        assert_eq!(status, expected, "{path}");
    }
    browser.resize(1280, 900, false);
    std::thread::sleep(std::time::Duration::from_secs(1));
    browser.picture("meshes-light-1280");
}

#[test]
fn cell_view_without_webgl_shows_numbers() {
    let Some(mut browser) = browser("cell_view_without_webgl_shows_numbers") else {
        return;
    };
    let cell = Cell::start();
    browser.open(&format!("http://{}/", cell.http));
    browser.wait_for("live", "live");
    browser.value(
        "HTMLCanvasElement.prototype.getContext = () => null; location.hash = '#cell'; true",
    );
    browser.wait_for("view", "This browser has no WebGL.");
    browser.wait_for("view", "left\tflange");
    assert_eq!(browser.errors, [""; 0]);
}

#[test]
fn plots_show_values_that_controller_recorded() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("plots_show_values_that_controller_recorded") else {
            return;
        };
        let mut cell = Cell::start();
        let _arm = cell.arm();
        browser.open(&format!("http://{}/#plots", cell.http));
        wait(
            &mut browser,
            "!!document.querySelector('input[type=search]')",
        );
        browser.value(KEEP_SAVED);
        // The list of probes is there when a search finds some.
        let search = "(() => { const box = document.querySelector('input[type=search]'); box.value = 'left.joint.1.measured'; box.oninput(); \
            return document.querySelectorAll('.found input').length === 1; })()";
        wait(&mut browser, search);
        let moving = motion(&cell);
        browser.value(
            "document.querySelector('input[type=search]').onkeydown(new KeyboardEvent('keydown', { key: 'Enter' })); true",
        );
        wait(
            &mut browser,
            "document.querySelectorAll('canvas.plot').length === 1",
        );
        wait(
            &mut browser,
            "Number(document.querySelector('.plots').dataset.pictures) > 20",
        );
        let recorded = browser.value("(async () => (await fetch('/devices/left/last')).text())()");
        browser.value("[...document.querySelectorAll('button')].find(it => it.textContent === 'CSV').click(); true");
        wait(&mut browser, "window.saved !== null");
        let saved = browser.value("window.saved");
        for (name, width, is_dark) in [
            ("plots-dark-1280", 1280, true),
            ("plots-light-390", 390, false),
        ] {
            browser.resize(width, 900, is_dark);
            browser.picture(name);
        }
        drop(moving);

        let plotted = column(saved.as_str().unwrap(), "left.joint.1.measured [rad]");
        let recorded = column(recorded.as_str().unwrap(), "left j1 measured");
        assert_recorded(&plotted, &recorded);
        assert_eq!(browser.errors, [""; 0]);
    });
}

/// Times, s, and values of a column of a CSV text.
fn column(text: &str, name: &str) -> Vec<(f64, f64)> {
    let mut lines = text.lines();
    let head = lines.next().unwrap();
    let column = head.split(',').position(|it| it == name);
    let column = column.unwrap_or_else(|| panic!("{name} is not in {head}"));
    let row = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        Some((fields[0].parse().ok()?, fields[column].parse().ok()?))
    };
    lines.filter_map(row).collect()
}

/// Most values that were recorded once only were plotted at the same distance in time, rounded as the record is.
#[track_caller]
fn assert_recorded(plotted: &[(f64, f64)], recorded: &[(f64, f64)]) {
    let rounded = |value: f64| format!("{value:.6}");
    let mut once: BTreeMap<String, Option<f64>> = BTreeMap::new();
    for (time, value) in plotted {
        let entry = once.entry(rounded(*value));
        entry.and_modify(|time| *time = None).or_insert(Some(*time));
    }
    let matched = recorded.iter().filter_map(|(time, value)| {
        let plotted = once.get(&rounded(*value)).copied().flatten()?;
        Some(plotted - time)
    });
    let mut offsets: Vec<f64> = matched.collect();
    offsets.sort_by(f64::total_cmp);
    assert!(offsets.len() > 100, "{} values are in both", offsets.len());
    let middle = offsets[offsets.len() / 2];
    let same = offsets.iter().filter(|it| (*it - middle).abs() < 1e-5);
    let share = same.count() as f64 / offsets.len() as f64;
    assert!(share > 0.9, "{share} of {} at one distance", offsets.len());
}
