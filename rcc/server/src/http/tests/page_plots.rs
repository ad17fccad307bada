//! The modules of the plots, run by node.

use super::page_cell::prints;

#[test]
fn page_ring_keeps_latest_samples_and_losses() {
    let program = r#"
        const { Ring } = await import("PAGE/js/samples.js");
        const ring = new Ring(1, 5);
        const push = (from, rows, lost = 0) => ring.push({ group: 0, rows, columns: 1, lost,
          data: Float64Array.from({ length: 2 * rows }, (_, n) => n % 2 ? 10 * (from + (n >> 1)) : from + (n >> 1)) });
        push(0, 3);
        console.log(ring.length, ring.first, ring.last, ring.at(0, 1.5), ring.at(0, -1), ring.rowAt(1.5), ring.rowAt(9));
        push(3, 4, 2);
        console.log(ring.length, ring.first, ring.last, ring.at(0, 2), ring.value(0, 4), JSON.stringify(ring.losses));
        push(7, 12);
        console.log(ring.length, ring.first, ring.last, ring.value(0, 0));
        // An earlier time is another record.
        push(1, 2);
        console.log(ring.length, ring.first, ring.last, ring.losses.length);
        // A capture has losses between its rows too.
        ring.push({ group: 0, rows: 4, columns: 1, lost: 5, data: Float64Array.of(9, 0, 9.001, 0, 9.006, 0, 9.008, 0) });
        console.log(JSON.stringify(ring.losses));
        for (let n = 0; n < 1000; n++) ring.lose(n, 1);
        console.log(ring.losses.length);"#;
    prints(
        "page_ring_keeps_latest_samples_and_losses",
        program,
        "3 0 2 10 NaN 2 3\n5 2 6 20 60 [{\"time\":3,\"count\":2}]\n5 14 18 140\n2 1 2 0\n\
         [{\"time\":9.006,\"count\":4},{\"time\":9.008,\"count\":1}]\n500",
    );
}

#[test]
fn page_decimation_keeps_every_peak() {
    // Against the plain definition, for random samples with nulls, and rings that have begun again.
    let program = r#"
        const { Ring, decimate, range } = await import("PAGE/js/samples.js");
        let seed = 1;
        const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
        for (let round = 0; round < 60; round++) {
          const ring = new Ring(1, 200 + Math.floor(300 * random())), rows = [];
          for (let time = 0, n = 0; n < 700; n++) {
            time += 0.001 + 0.002 * random();
            const value = random() < 0.1 ? NaN : random() - 0.5 + (random() < 0.01 ? 100 : 0);
            ring.push({ group: 0, rows: 1, columns: 1, lost: 0, data: Float64Array.of(time, value) });
            rows.push([time, value]);
          }
          const shown = rows.slice(-ring.capacity), from = shown[0][0] + 0.2 * random(), to = from + 0.3 * random() + 0.01, width = 1 + Math.floor(80 * random());
          const found = decimate(ring, 0, from, to, width);
          let low = Infinity, high = -Infinity;
          for (let pixel = 0; pixel < width; pixel++) {
            const all = shown.filter(([time]) => time >= from && time < to && Math.min(width - 1, Math.floor((time - from) * (width / (to - from)))) === pixel).map(([, value]) => value);
            const known = all.filter(value => value === value), f32 = Math.fround;
            const expected = known.length ? [known[0], Math.min(...known), Math.max(...known), known.at(-1)].map(f32) : [all.length ? Infinity : NaN, NaN, NaN, NaN];
            const got = [...found.slice(4 * pixel, 4 * pixel + 4)];
            if (!expected.every((value, n) => Object.is(value, got[n]) || value === got[n])) throw new Error([round, pixel, expected, got].join(" | "));
            known.forEach(value => { low = Math.min(low, f32(value)); high = Math.max(high, f32(value)); });
          }
          const whole = range(found, width);
          if (low <= high ? whole[0] !== low || whole[1] !== high : whole !== null) throw new Error("range " + whole);
        }
        console.log("equal");"#;
    prints("page_decimation_keeps_every_peak", program, "equal");
}

#[test]
fn page_trigger_form_requests_what_it_shows() {
    let program = r#"
        const { DEFAULTS, KINDS, settingsOf } = await import("PAGE/js/trigger.js");
        const of = change => { try { return JSON.stringify(settingsOf({ ...DEFAULTS, probe: "a.b", ...change })); } catch (error) { return error.message; } };
        console.log(of({}));
        console.log(of({ on: "rising", level: "-0.5", pre: "0", post: "2", mode: "single" }));
        console.log(of({ on: "outside", low: "-1e-3", high: "0.001" }));
        console.log(of({ on: "state", equals: " RUNNING " }));
        console.log(of({ on: "fault", source: "left" }));
        console.log(of({ on: "event", source: " machine:cell " }));
        console.log(of({ on: "overrun" }));
        for (const change of [{ on: "odd" }, { on: "rising", level: "" }, { on: "above", level: "nan" }, { on: "inside", low: "2", high: "1" }, { on: "falling", probe: "" },
          { on: "state", equals: " " }, { on: "event", source: " " }, { on: "fault", pre: "-1" }, { on: "fault", post: "0" }, { on: "fault", post: "61" }, { on: "fault", pre: "inf" }])
          console.log(of(change).split("\n")[0]);
        console.log(KINDS.length);"#;
    prints(
        "page_trigger_form_requests_what_it_shows",
        program,
        r#"{"trigger":null,"pre_s":0.5,"post_s":1.5,"mode":"normal"}
{"trigger":{"on":"rising","probe":"a.b","level":-0.5},"pre_s":0,"post_s":2,"mode":"single"}
{"trigger":{"on":"outside","probe":"a.b","low":-0.001,"high":0.001},"pre_s":0.5,"post_s":1.5,"mode":"normal"}
{"trigger":{"on":"state","probe":"a.b","equals":"RUNNING"},"pre_s":0.5,"post_s":1.5,"mode":"normal"}
{"trigger":{"on":"fault","probe":"left"},"pre_s":0.5,"post_s":1.5,"mode":"normal"}
{"trigger":{"on":"event","probe":"machine:cell"},"pre_s":0.5,"post_s":1.5,"mode":"normal"}
{"trigger":{"on":"overrun"},"pre_s":0.5,"post_s":1.5,"mode":"normal"}
trigger "odd" is unknown
level is ""; a number is expected
level is "nan"; a number is expected
the window from 2 to 1 is empty
the trigger has no probe
the state is empty
the trigger has no source
time before is -1 s; 0 to 60 s are possible
time after is 0 s; 0.01 to 60 s are possible
time after is 61 s; 0.01 to 60 s are possible
time before is "inf"; a number is expected
11"#,
    );
}

#[test]
fn page_plots_export_all_rates_by_time() {
    let program = r#"
        const { Ring, toCsv } = await import("PAGE/js/samples.js");
        const fast = new Ring(2, 9), slow = new Ring(1, 9);
        fast.push({ rows: 4, columns: 2, lost: 0, data: Float64Array.of(1, 0.5, -1, 2, NaN, 1e-7, 3, 4, 5, 4, 6, 7) });
        slow.push({ rows: 2, columns: 1, lost: 0, data: Float64Array.of(1.5, 8, 3, 9) });
        const series = [{ name: "a", unit: "rad", ring: fast, column: 0 }, { name: "b,c", unit: "", ring: slow, column: 0 }, { name: "d", unit: "N", ring: fast, column: 1 }];
        console.log(toCsv(series, 1, 3));"#;
    prints(
        "page_plots_export_all_rates_by_time",
        program,
        "time [s],a [rad],\"b,c\",d [N]\n1,0.5,,-1\n1.5,,8,\n2,,,1e-7\n3,4,9,5",
    );
}

#[test]
fn page_axes_have_round_numbers() {
    let program = r#"
        const { format, ticks } = await import("PAGE/js/samples.js");
        const { around } = await import("PAGE/js/plot.js");
        const shown = (low, high, most) => { const { step, ticks: all } = ticks(low, high, most); return all.map(value => format(value, step)).join(" "); };
        console.log(shown(-1, 1, 4));
        console.log(shown(0.00001, 0.00005, 4));
        console.log(shown(1234567.25, 1234567.5, 3));
        console.log(shown(3, 3, 5) + "|" + shown(0, Infinity, 5) + "|" + shown(NaN, 1, 5));
        console.log(JSON.stringify([around([]), around([null, [1, 1]]), around([[0, 10], [-10, 0]])]));"#;
    prints(
        "page_axes_have_round_numbers",
        program,
        "-1.0 -0.5 0 0.5 1.0\n1e-5 2e-5 3e-5 4e-5 5e-5\n1.2345673e6 1.2345674e6 1.2345675e6\n||\n\
         [[-1,1],[0.9,1.1],[-11.2,11.2]]",
    );
}

#[test]
fn page_finds_probes_and_presets() {
    let program = r#"
        const { PRESETS, search } = await import("PAGE/js/probe_picker.js");
        const names = ["right.joint.0.measured", "left.joint.0.following_error", "left.joint.1.following_error", "left.force.x", "left.force.rx",
          "thread:nets.latency", "net:left/swing.outValue"];
        const probes = names.map(name => ({ name, unit: "" }));
        console.log(search(probes, "LEFT following").map(probe => probe.name).join());
        console.log(search(probes, "left out").map(probe => probe.name).join(), search(probes, "").length, search(probes, "odd").length);
        for (const preset of PRESETS) console.log(preset.id, JSON.stringify(preset.plots(probes)));"#;
    prints(
        "page_finds_probes_and_presets",
        program,
        r#"left.joint.0.following_error,left.joint.1.following_error
net:left/swing.outValue 7 0
following [["left.joint.0.following_error","left.joint.1.following_error"]]
positions [["right.joint.0.measured"]]
velocities []
force [["left.force.x"],["left.force.rx"]]
latency [["thread:nets.latency"]]"#,
    );
}

#[test]
fn page_plot_keys_move_time_values_and_cursors() {
    let program = r#"
        const { key, zoomTime } = await import("PAGE/js/plot_input.js");
        const axis = { from: 0, to: 10, cursors: [null, null], trigger: null };
        const plot = { width: 100, height: 50, pan: by => log.push("pan " + by), zoom: (by, y) => log.push("zoom " + by.toFixed(2) + " " + y) };
        const log = [], board = { axis, isPaused: false, pause(is) { this.isPaused = is; }, all: () => log.push("all"), changed() {}, showValues() {} };
        const press = (name, isShifted = false) => key(name, isShifted, plot, board, 4, () => board.pause(true));
        press("ArrowRight"); console.log(axis.from, axis.to, board.isPaused);
        press(" "); console.log(board.isPaused);
        press("a"); press("b"); press("]"); press("{", true); console.log(axis.cursors.map(time => time.toFixed(2)).join());
        press("Escape"); console.log(axis.cursors.join(), press("]"), press("x"));
        press("ArrowUp"); press("V"); press("0"); console.log(log.join("; "));
        zoomTime(axis, 0.5, 1); console.log(axis.from, axis.to);
        for (let n = 0; n < 99; n++) zoomTime(axis, 0.5, 1);
        console.log((axis.to - axis.from).toExponential(2));"#;
    prints(
        "page_plot_keys_move_time_values_and_cursors",
        program,
        "1 11 true\nfalse\n3.90,4.10\n, false false\npan 5; zoom 1.10 25; all\n1 6\n1.00e-5",
    );
}

#[test]
fn page_plots_name_what_lines_share() {
    let program = r#"
        const { causes, shorten } = await import("PAGE/js/probe_picker.js");
        const show = (...names) => { const { common, rest } = shorten(names); console.log(common, rest.join()); };
        show("left.joint.0.measured", "left.joint.1.measured");
        show("left.force.x", "left.force.y");
        show("left.joint.0.measured", "right.joint.0.measured");
        show("a.x", "a.x");
        show("left.status"); show("left.status", "thread:nets.latency"); show();
        console.log(causes([{ probe: "a", cause: "c", hint: "h" }, { probe: "b", cause: "d" }, ...["e", "f", "g", "i"].map(probe => ({ probe, cause: "j" }))]));"#;
    prints(
        "page_plots_name_what_lines_share",
        program,
        "left.joint.*.measured 0,1\nleft.force.* x,y\n*.joint.0.measured left,right\na.* x,x\n left.status\n \
         left.status,thread:nets.latency\n \na: c\nhint: h\nb: d\n4 probes: j",
    );
}
