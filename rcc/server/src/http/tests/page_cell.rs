//! The modules of the 3-D view and of the scope's client, run by node.

use super::super::page::tests::run;

/// Compares what a program prints; notes the skip of `test` without node.
#[track_caller]
pub(super) fn prints(test: &str, program: &str, expected: &str) {
    match run(program) {
        Some(printed) => assert_eq!(printed, expected),
        None => takt_tests::skip(test, "needs node"),
    }
}

#[test]
fn page_decodes_scope_messages_and_rejects_others() {
    let program = r#"
        const { readSamples, scopeUrl } = await import("PAGE/js/scope.js");
        const bytes = new ArrayBuffer(16 + 8 * 6), view = new DataView(bytes);
        [3, 2, 2, 7].forEach((value, at) => view.setUint32(4 * at, value, true));
        [1.5, -0.25, NaN, 1.501, 1e-300, 2].forEach((value, at) => view.setFloat64(16 + 8 * at, value, true));
        const { group, rows, columns, lost, data } = readSamples(bytes);
        console.log(group, rows, columns, lost, [...data].join());
        const failed = bytes => { try { readSamples(bytes); return "read"; } catch (error) { return error.message; } };
        console.log(failed(bytes.slice(0, 60)));
        console.log(failed(bytes.slice(0, 8)));
        // A head that promises more than memory has.
        view.setUint32(4, 0xffffffff, true);
        console.log(failed(bytes));
        console.log(scopeUrl({ protocol: "https:", host: "h:1" }), scopeUrl({ protocol: "http:", host: "h" }));"#;
    prints(
        "page_decodes_scope_messages_and_rejects_others",
        program,
        "3 2 2 7 1.5,-0.25,NaN,1.501,1e-300,2\n\
         a message of 60 bytes has 2 rows of 2 probes in its head\n\
         a message of 8 bytes is shorter than its head\n\
         a message of 64 bytes has 4294967295 rows of 2 probes in its head\n\
         wss://h:1/scope ws://h/scope",
    );
}

#[test]
fn page_scope_survives_bad_messages_and_reconnects() {
    let program = r#"
        const sockets = [], log = [], timers = [];
        globalThis.WebSocket = class {
          static OPEN = 1;
          constructor(url) { this.url = url; this.readyState = 0; this.sent = []; sockets.push(this); }
          send(text) { this.sent.push(text); }
          close() { this.readyState = 3; }
        };
        globalThis.setTimeout = (work, ms) => { timers.push([work, ms]); return timers.length; };
        const { Scope } = await import("PAGE/js/scope.js");
        const scope = new Scope({
          groups: (groups, rejected) => log.push("groups " + groups.length + " " + rejected.length),
          samples: samples => log.push("samples " + samples.data.join("/")),
          triggered: (time, cause) => log.push("triggered " + time + " " + cause),
          ended: (probe, cause) => log.push("ended " + probe + " " + cause),
          lost: (group, samples) => log.push("lost " + group + " " + samples),
          state: (text, isGood) => log.push((isGood ? "+" : "-") + text),
        }, "ws://h/scope");
        const text = value => sockets.at(-1).onmessage({ data: JSON.stringify(value) });
        const frame = (group, columns) => {
          const bytes = new ArrayBuffer(16 + 8 * (columns + 1)), view = new DataView(bytes);
          [group, 1, columns, 0].forEach((value, at) => view.setUint32(4 * at, value, true));
          sockets.at(-1).onmessage({ data: bytes });
        };
        scope.ask({ probes: ["a"] });
        sockets[0].readyState = 1; sockets[0].onopen();
        log.push(sockets[0].sent.join());
        text({ scope: { version: 1, groups: [{ thread: "nets", period_s: 0.001, probes: [{ name: "a", unit: "rad" }] }], rejected: [{ probe: "b", cause: "c" }] } });
        frame(0, 1); frame(0, 2); frame(7, 1);
        sockets[0].onmessage({ data: "{" });
        text({ triggered: { time_s: 2, cause: "rising" } });
        text({ ended: { probe: "a", cause: "its net ended" } });
        text({ lost: { group: 0, samples: 4 } });
        text({ scope: { version: 9, groups: [] } }); text({ error: { cause: "no level", hint: "give one" } });
        sockets[0].onclose({ reason: "" });
        timers[0][0]();
        sockets[1].onclose({ reason: "full" });
        log.push(sockets.length + " sockets, retries " + timers.map(timer => timer[1]).join());
        scope.close(); timers.at(-1)[0]();
        log.push(sockets.length + " sockets");
        console.log(log.join("\n"));"#;
    let expected = [
        r#"{"probes":["a"]}"#,
        "+live",
        "groups 1 1",
        "samples 0/0",
        "-scope: samples of 2 probes of group 0, which was not announced",
        "-scope: samples of 1 probes of group 7, which was not announced",
    ];
    match run(program) {
        None => takt_tests::skip(
            "page_scope_survives_bad_messages_and_reconnects",
            "needs node",
        ),
        Some(printed) => {
            assert!(printed.starts_with(&expected.join("\n")), "{printed}");
            for part in [
                "triggered 2 rising",
                "ended a its net ended",
                "lost 0 4",
                "-no level\ngroups 0 1",
                "-scope: the controller has version 9; this page reads 1: reload it",
                "-full; the next attempt follows",
                "2 sockets, retries 500,1000",
            ] {
                assert!(printed.contains(part), "{part}: {printed}");
            }
            assert!(printed.ends_with("\n2 sockets"), "{printed}");
        }
    }
}

#[test]
fn page_splits_many_probes_among_connections() {
    let program = r#"
        globalThis.WebSocket = class { static OPEN = 1; constructor() { all.push(this); } send() {} close() {} };
        const all = [], log = [];
        const { Scopes, parts } = await import("PAGE/js/scopes.js");
        console.log(JSON.stringify(parts(["a", "b", "c"], 2)), JSON.stringify(parts([], 2)));
        const names = Array.from({ length: 600 }, (_, n) => "p" + n);
        const scopes = new Scopes({
          groups: (groups, rejected) => log.push("groups " + groups.map(group => group.probes.length) + " rejected " + rejected.length),
          samples: ({ group }) => log.push("samples of " + group), state: () => {},
        }, "ws://h/scope");
        scopes.ask({ probes: names });
        const answer = (socket, probes) => socket.onmessage({ data: JSON.stringify({ scope: { version: 1, groups: [{ thread: "t", period_s: 1, probes }] } }) });
        const probes = count => Array.from({ length: count }, (_, n) => ({ name: "p" + n, unit: "" }));
        all.forEach(socket => answer(socket, probes(64)));
        const bytes = new ArrayBuffer(16 + 8 * 65), view = new DataView(bytes);
        [0, 1, 64, 0].forEach((value, at) => view.setUint32(4 * at, value, true));
        all[5].onmessage({ data: bytes });
        scopes.ask({ probes: names.slice(0, 3) });
        console.log(all.length, log.join("; "), scopes.all.length);"#;
    prints(
        "page_splits_many_probes_among_connections",
        program,
        "[[\"a\",\"b\"],[\"c\"]] []\n8 groups 64,64,64,64,64,64,64,64 rejected 88; samples of 5 1",
    );
}

#[test]
fn page_chooses_probes_of_cell_by_period() {
    let program = r#"
        const { divisor, periods, readProbe } = await import("PAGE/js/live.js");
        const { atRest, differs } = await import("PAGE/js/geometry.js");
        const probe = (name, period_s = 0.001) => ({ name, period_s });
        const probes = [probe("left.joint.0.measured"), probe("left.joint.0.set_point"), probe("left.joint.0.commanded"), probe("left.joint.0.velocity"),
          probe("base.base.pose.x", 0.05), probe("other.joint.0.measured"), probe("left.force.z"), probe("left.force.rz"), probe("hand.gripper.distance")];
        const geometry = { frames: [], devices: [{ name: "left" }, { name: "base" }, { name: "hand" }] };
        for (const { probes: names, every } of periods(probes, geometry, 60)) console.log(every, names.join());
        console.log([0.00025, 0.002, 0.05, 0, NaN].map(period => divisor(period, 60)).join());
        const live = new Map(["left", "base", "hand"].map(name => [name, atRest()]));
        const set = (name, value) => readProbe(name, live)(value);
        set("left.joint.0.measured", 0.5); set("left.joint.0.set_point", 0.501);
        console.log(differs(live.get("left")));
        set("left.joint.0.set_point", 0.6); set("base.base.pose.qw", 0.5); set("left.force.z", -3); set("hand.gripper.distance", NaN); set("none.joint.0.measured", 1);
        console.log(differs(live.get("left")), live.get("base").base.join(), live.get("left").force.join(), live.get("hand").opening);"#;
    prints(
        "page_chooses_probes_of_cell_by_period",
        program,
        "16 left.joint.0.measured,left.joint.0.set_point,left.force.z,hand.gripper.distance\n1 base.base.pose.x\n\
         66,8,1,1,1\nfalse\ntrue 0,0,0,0,0,0,0.5 0,0,-3 0.05",
    );
}

#[test]
fn page_solids_are_closed_and_face_outwards() {
    // The volume that triangles enclose is positive and that of the solid only if each of them faces outwards.
    let program = r#"
        const { Mesh, arrow } = await import("PAGE/js/solids.js");
        const { pose, shift, cross, dot, subtract } = await import("PAGE/js/math3.js");
        const volume = mesh => {
          let six = 0, turned = 0;
          const at = (list, corner) => list.slice(3 * corner, 3 * corner + 3);
          for (let n = 0; n < mesh.indices.length; n += 3) {
            const [a, b, c] = mesh.indices.slice(n, n + 3), [p, q, r] = [a, b, c].map(corner => at(mesh.positions, corner));
            six += dot(p, cross(q, r));
            const out = cross(subtract(q, p), subtract(r, p));
            if (Math.hypot(...out) > 1e-9 && [a, b, c].some(corner => dot(out, at(mesh.normals, corner)) < -1e-9)) turned++;
          }
          return (six / 6).toFixed(3) + " " + turned;
        };
        const solid = work => { const mesh = new Mesh(); work(mesh); return volume(mesh); };
        console.log(solid(m => m.box(pose([1, 2, 3], [0, 0, Math.SQRT1_2, Math.SQRT1_2]), [1, 2, 3])));
        console.log(solid(m => m.cone([1, 0, 0], [1, 0, 2], 1)));
        console.log(solid(m => m.capsule([0, 1, 0], [2, 1, 0], 1)));
        console.log(solid(m => m.cone([0, 0, 0], [0, 3, 0], 1, 0)));
        console.log(arrow().corners < 65536);"#;
    // Of 20 sides and 5 rings: a little less than the round solids.
    prints(
        "page_solids_are_closed_and_face_outwards",
        program,
        "6.000 0\n6.180 0\n10.200 0\n3.090 0\ntrue",
    );
}

#[test]
fn page_camera_fits_and_projects() {
    let program = r#"
        const { Camera } = await import("PAGE/js/camera.js");
        const { project, about, apply } = await import("PAGE/js/math3.js");
        const camera = new Camera(), low = [-1, -3, 0], high = [1, 3, 2];
        for (const aspect of [0.6, 1, 2]) {
          camera.fit(low, high, aspect);
          let most = 0;
          for (let bits = 0; bits < 8; bits++) {
            const at = project(camera.matrix(aspect), low.map((v, axis) => bits >> axis & 1 ? high[axis] : v));
            most = Math.max(most, Math.abs(at[0]), Math.abs(at[1]));
          }
          console.log(most.toFixed(2));
        }
        console.log(project(camera.matrix(1), camera.eye.map((v, axis) => 2 * v - camera.target[axis])));
        const before = camera.distance;
        for (let n = 0; n < 1000; n++) camera.key("+", false, () => {});
        camera.orbit(0, 99);
        console.log(camera.distance.toFixed(2), camera.pitch, camera.key("q", false, () => {}));
        console.log(apply(about([0, 0, 1], [1, 0, 5], Math.PI / 2), [2, 0, 1]).map(v => v.toFixed(6)).join());"#;
    prints(
        "page_camera_fits_and_projects",
        program,
        "0.90\n0.90\n0.90\nnull\n0.15 1.55 false\n1.000000,1.000000,1.000000",
    );
}
