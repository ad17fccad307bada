//! The web page: a static text whose script reads the resources and displays them. It loads nothing from other
//! servers.

/// The HTML text.
pub(super) const PAGE: &str = include_str!("page.html");

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::PAGE;

    /// What a page needs of a browser: elements are objects with their class, text and children.
    const BROWSER: &str = r#"
        class Element {
          constructor(tag) { this.tag = tag; this.style = {}; this.children = []; this.className = ""; }
          set textContent(text) { this.children = [String(text)]; }
          append(...children) { this.children.push(...children); }
          replaceChildren(...children) { this.children = children; }
          insertRow() { const row = new Element("tr"); this.append(row); return row; }
          insertCell() { const cell = new Element("td"); this.append(cell); return cell; }
          createTHead() { const head = new Element("thead"); this.append(head); return head; }
          createTBody() { const body = new Element("tbody"); this.append(body); return body; }
          text() { const inner = this.children.map(child => child.text ? child.text() : child);
            return this.tag + "(" + inner.join(" ") + ")"; }
        }
        globalThis.Node = Element;
        const ids = {};
        globalThis.document = { createElement: tag => new Element(tag), hidden: true, addEventListener() {},
          getElementById: id => ids[id] ??= new Element(id) };
        globalThis.location = { hostname: "h" };
        globalThis.setInterval = globalThis.setTimeout = () => 0;
        globalThis.fetch = async path => ({ ok: path in answers, text: async () => "no answer", json: async () => answers[path] });
    "#;

    /// Runs the page's script with these answers to its requests, then a program; returns what that prints.
    fn run(answers: &str, program: &str) -> Option<String> {
        let script = PAGE.split_once("<script>")?.1.split_once("</script>")?.0;
        let text = format!(
            "{BROWSER} const answers = {answers};\n{script}\n(async () => {{ {program} }})();"
        );
        let output = Command::new("node").args(["--eval", &text]).output();
        let output = output.ok()?;
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    }

    #[test]
    fn page_lists_configured_devices_with_whole_numbers() {
        let answers = r#"{ "/devices/left%20arm/robotarm": { joint: [{ measured: "1.23456" }, { measured: -0.5 }] } }"#;
        let program = r#"
            const arm = { name: "left arm", type: "t", state: "op", interface: [{ name: "robotarm" }] };
            await showDevices([{ name: "rcc", type: "rcc", state: "op" }, arm]);
            console.log($("devices").text());"#;
        let Some(shown) = run(answers, program) else {
            takt_tests::skip(
                "page_lists_configured_devices_with_whole_numbers",
                "needs node",
            );
            return;
        };
        assert!(!shown.contains("rcc"), "{shown}");
        assert!(
            shown.ends_with("td(span(1.235) span(-0.500) span(rad))))))"),
            "{shown}"
        );
    }

    #[test]
    fn page_breaks_long_values_between_numbers() {
        let program = r#"console.log(new Element("td").text(), breakable("[0.12345,-7]").map(p => p.text ? "|" : p).join(""));"#;
        let Some(shown) = run("{}", program) else {
            takt_tests::skip("page_breaks_long_values_between_numbers", "needs node");
            return;
        };
        assert_eq!(shown, "td() [0.12345,|-7]|");
    }
}
