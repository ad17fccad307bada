//! The web page: static files whose scripts read the resources and display them. They are part of this program, load nothing
//! from other servers, and need no build step.

use super::Response;

/// A table of the files of `rcc/server/page/`, by their paths below `/page/`.
macro_rules! files {
    ($($path:literal),+ $(,)?) => {
        &[$(($path, include_str!(concat!("../../page/", $path)))),+]
    };
}

/// The page itself, served at `/`.
const INDEX: &str = include_str!("../../page/index.html");

/// All that it loads. A new file needs a line here; views are listed in `js/main.js`.
const FILES: &[(&str, &str)] = files![
    "style.css",
    "css/cell.css",
    "css/nets.css",
    "js/api.js",
    "js/camera.js",
    "js/directio.js",
    "js/dom.js",
    "js/geometry.js",
    "js/jog.js",
    "js/live.js",
    "js/main.js",
    "js/math3.js",
    "js/meshes.js",
    "js/net_graph.js",
    "js/plot.js",
    "js/plot_input.js",
    "js/probe_picker.js",
    "js/rule_graph.js",
    "js/samples.js",
    "js/scene.js",
    "js/scope.js",
    "js/scopes.js",
    "js/solids.js",
    "js/stl.js",
    "js/stop.js",
    "js/svg.js",
    "js/trigger.js",
    "js/view_3d.js",
    "js/view_buses.js",
    "js/view_devices.js",
    "js/view_fleet.js",
    "js/view_flights.js",
    "js/view_jog.js",
    "js/view_log.js",
    "js/view_machines.js",
    "js/view_nets.js",
    "js/view_overview.js",
    "js/view_plots.js",
    "js/view_threads.js",
    "js/webgl.js",
];

/// The page.
pub(super) fn index(stop_port: Option<u16>) -> Response {
    Response::page(INDEX, stop_port)
}

/// A file below `/page/`.
pub(super) fn file(path: &[&str]) -> Option<Response> {
    let path = path.join("/");
    let (_, text) = FILES.iter().find(|(name, _)| *name == path)?;
    Some(Response::of_kind(kind(&path), (*text).to_owned()))
}

/// The content type of a file.
fn kind(path: &str) -> &'static str {
    match path.rsplit_once('.') {
        Some((_, "js")) => "text/javascript; charset=utf-8",
        Some((_, "css")) => "text/css; charset=utf-8",
        Some((_, "svg")) => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::path::{Path, PathBuf};
    use std::process::Command;

    use super::{FILES, INDEX};

    /// Most bytes of the whole page.
    const BYTES_MAX: usize = 300_000;
    /// Most lines of a module.
    const LINES_MAX: usize = 400;

    fn folder() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("page")
    }

    #[test]
    fn page_files_are_all_embedded_and_small() {
        let mut found: Vec<String> = Vec::new();
        for part in ["", "js", "css"] {
            let Ok(entries) = std::fs::read_dir(folder().join(part)) else {
                continue;
            };
            let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
            let loaded = names.filter(|name| name.ends_with(".js") || name.ends_with(".css"));
            found.extend(loaded.map(|name| Path::new(part).join(name).display().to_string()));
        }
        found.sort();
        let mut known: Vec<_> = FILES.iter().map(|(path, _)| (*path).to_owned()).collect();
        known.sort();
        assert_eq!(
            found, known,
            "files of rcc/server/page and the table of page.rs"
        );
        let bytes = INDEX.len() + FILES.iter().map(|(_, text)| text.len()).sum::<usize>();
        assert!(bytes <= BYTES_MAX, "the page has {bytes} bytes");
        for (path, text) in FILES {
            let lines = text.lines().count();
            assert!(lines <= LINES_MAX, "{path} has {lines} lines");
        }
    }

    /// The modules that one imports, and that these import.
    fn imported(module: &str, all: &mut std::collections::BTreeSet<String>) {
        let path = format!("js/{module}.js");
        let (_, text) = FILES.iter().find(|(name, _)| *name == path).unwrap();
        let imports = text.lines().filter(|line| line.starts_with("import "));
        for line in imports {
            let (_, of) = line.split_once("\"./").unwrap();
            let name = of.split(".js").next().unwrap();
            if all.insert(name.to_owned()) {
                imported(name, all);
            }
        }
    }

    #[test]
    fn page_modules_are_preloaded_with_all_that_they_import() {
        let mut of_main = std::collections::BTreeSet::new();
        imported("main", &mut of_main);
        for name in &of_main {
            let link = format!("<link rel=\"modulepreload\" href=\"/page/js/{name}.js\">");
            assert!(INDEX.contains(&link), "index.html lacks {link}");
        }
        let (_, main) = FILES
            .iter()
            .find(|(name, _)| *name == "js/main.js")
            .unwrap();
        let views = main
            .lines()
            .filter(|line| line.contains("load: () => import(\"./"));
        let mut count = 0;
        for line in views {
            let (_, of) = line.split_once("import(\"./").unwrap();
            let view = of.split(".js").next().unwrap();
            let mut all = std::collections::BTreeSet::new();
            imported(view, &mut all);
            let needs = all.difference(&of_main).map(|name| format!("\"{name}\""));
            let needs = format!("needs: [{}]", needs.collect::<Vec<_>>().join(", "));
            assert!(line.contains(&needs), "main.js: {view} {needs}");
            count += 1;
        }
        assert!(count > 5, "{count} views");
    }

    #[test]
    fn page_loads_nothing_from_other_hosts() {
        let files = FILES.iter().map(|(_, text)| *text).chain([INDEX]);
        for text in files {
            let foreign = text.replace("http://www.w3.org/", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"));
        }
        // The policy of the page permits no script in it.
        assert!(
            !INDEX.contains("<script>") && !INDEX.contains("style=") && !INDEX.contains("onclick")
        );
    }

    /// What a module needs of a browser: elements are objects with their class, text and children.
    const BROWSER: &str = r#"
        class Element {
          constructor(tag) { this.tag = tag; this.style = {}; this.children = []; this.className = ""; }
          set textContent(text) { this.children = [String(text)]; }
          append(...children) { this.children.push(...children); }
          replaceChildren(...children) { this.children = children; }
          setAttribute() {}
          insertRow() { const row = new Element("tr"); this.append(row); return row; }
          insertCell() { const cell = new Element("td"); this.append(cell); return cell; }
          createTHead() { const head = new Element("thead"); this.append(head); return head; }
          createTBody() { const body = new Element("tbody"); this.append(body); return body; }
          text() { const inner = this.children.map(child => child.text ? child.text() : child);
            return this.tag + "(" + inner.join(" ") + ")"; }
        }
        globalThis.Node = Element;
        globalThis.document = { createElement: tag => new Element(tag) };
    "#;

    /// What a program prints that may import modules of the page from `PAGE`; `None` without node.
    pub(in super::super) fn run(program: &str) -> Option<String> {
        let program = program.replace("PAGE", &format!("file://{}", folder().display()));
        let text = format!("{BROWSER}\n{program}");
        let output = Command::new("node")
            .args(["--input-type=module", "--eval", &text])
            .output()
            .ok()?;
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    }

    #[test]
    fn page_lists_configured_devices_with_whole_numbers() {
        let program = r#"
            const { deviceRows } = await import("PAGE/js/view_overview.js");
            const { table } = await import("PAGE/js/dom.js");
            const answers = { "/devices/left%20arm/robotarm": { joint: [{ measured: "1.23456" }, { measured: -0.5 }, {}] } };
            const arm = { name: "left arm", type: "t", state: "op", interface: [{ name: "robotarm" }] };
            const devices = { device: [{ name: "rcc", type: "rcc", state: "op" }, arm] };
            const { rows } = await deviceRows(devices, { get: async path => answers[path] });
            console.log(table(["name", "type", "state", "joints"], rows, "no devices").text());"#;
        let Some(shown) = run(program) else {
            takt_tests::skip(
                "page_lists_configured_devices_with_whole_numbers",
                "needs node",
            );
            return;
        };
        assert!(!shown.contains("rcc"), "{shown}");
        assert!(
            shown.ends_with("td(span(1.235) span(-0.500) span(—) span(rad)))))"),
            "{shown}"
        );
    }

    #[test]
    fn page_breaks_long_values_between_numbers() {
        let program = r#"
            const { breakable } = await import("PAGE/js/dom.js");
            console.log(breakable("[0.12345,-7]").map(p => p.text ? "|" : p).join(""));"#;
        let Some(shown) = run(program) else {
            takt_tests::skip("page_breaks_long_values_between_numbers", "needs node");
            return;
        };
        assert_eq!(shown, "[0.12345,|-7]|");
    }

    #[test]
    fn page_times_have_readable_units() {
        let program = r#"
            const { span, ago } = await import("PAGE/js/dom.js");
            console.log([span("0.0015"), span(2), span(2500), span(undefined), ago(90), ago(7200)].join(" "));"#;
        let Some(shown) = run(program) else {
            takt_tests::skip("page_times_have_readable_units", "needs node");
            return;
        };
        assert_eq!(shown, "1.50 µs 2.00 ms 2.50 s — 90 s 2 h");
    }
}
