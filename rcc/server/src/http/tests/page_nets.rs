//! The graph of rules and the loads of buses, as the page computes them, run by node.

use super::page_cell::prints;

/// Prints the columns of a graph: `key layer` of each box, then its size and how many rules are left out.
const SHOWN: &str = r#"
    const { layout, path } = await import("PAGE/js/rule_graph.js");
    const nets = new Map([["rpinet0", { status: "RUNNING", desc: "approach" }], ["rpinet1", { status: "SCHEDULED", desc: "" }]]);
    const shown = rules => {
      const { nodes, edges, width, height, leftOut } = layout(rules, nets);
      console.log(nodes.map(node => node.key + "@" + node.layer).join(" "), "|", edges.map(edge => edge.kind).join(), "|", leftOut);
      for (const node of nodes) if (node.x < 0 || node.y < 0 || node.x > width || node.y > height) console.log("outside", node.key);
      const places = new Set(nodes.map(node => node.x + " " + node.y));
      if (places.size !== nodes.length) console.log("boxes overlap");
      for (const edge of edges) if (/NaN|undefined/.test(path(edge, height))) console.log("no path");
      return nodes;
    };
    const rule = (id, condition, state, more) => ({ id, condition, state, desc: "", ...more });
"#;

#[test]
fn page_rule_graph_orders_nets_by_rules() {
    let program = format!(
        r#"{SHOWN}
        const first = rule(1, "rpinet0.outTerminate and not rpinet2.outDone", "ACTIVE", {{ start: [{{ net: "rpinet1" }}], stop: [{{ net: "rpinet0" }}] }});
        const second = rule(2, "rpinet1.outTerminate", "FIRED", {{ start: [{{ net: "rpinet3" }}], cancel: [{{ net: "rpinet0" }}] }});
        const nodes = shown([first, second]);
        console.log(nodes[0].name, nodes[0].word, nodes[1].word, nodes[2].title);
        shown([second, first]);
        console.log("|", layout([], nets).nodes.length, "|", layout([], nets).leftOut);"#
    );
    prints(
        "page_rule_graph_orders_nets_by_rules",
        &program,
        &[
            "rpinet0@0 rpinet2@0 rule 1@1 rpinet1@2 rule 2@3 rpinet3@4 | if,if,start,stop,if,start,cancel | 0",
            "rpinet0 approach RUNNING unloaded rpinet0.outTerminate and not rpinet2.outDone",
            "rpinet1@2 rule 2@3 rpinet3@4 rpinet0@0 rpinet2@0 rule 1@1 | if,start,cancel,if,if,start,stop | 0",
            "| 0 | 0",
        ]
        .join("\n"),
    );
}

#[test]
fn page_rule_graph_of_circle_ends() {
    let program = format!(
        r#"{SHOWN}
        const round = [rule(1, "rpinet0.outTerminate", "ACTIVE", {{ start: [{{ net: "rpinet1" }}] }}),
          rule(2, "rpinet1.outTerminate", "ACTIVE", {{ start: [{{ net: "rpinet0" }}] }}), rule(3, "rpinet0.x", "ACTIVE", {{ start: [{{ net: "rpinet0" }}] }})];
        console.log(shown(round).every(node => node.layer < 8));
        const many = Array.from({{ length: 1000 }}, (_, n) => rule(n, "rpinet" + n + ".o", n === 3 ? "ACTIVE" : "FIRED", {{ start: [{{ net: "rpinet" + (n + 1) }}] }}));
        const drawn = layout(many, nets);
        console.log(drawn.leftOut, drawn.nodes.filter(node => node.kind === "rule").length, drawn.nodes.some(node => node.key === "rule 3"));"#
    );
    let expected = "true\n960 40 true";
    let Some(printed) = super::super::page::tests::run(&program) else {
        takt_tests::skip("page_rule_graph_of_circle_ends", "needs node");
        return;
    };
    assert!(
        printed.ends_with(expected) && !printed.contains("outside"),
        "{printed}"
    );
}

#[test]
fn page_bus_load_is_bar_with_number() {
    let program = r#"
        const { loadBar } = await import("PAGE/js/view_buses.js");
        for (const bus of [{ load: 0.125, loadmax: 0.5 }, { load: 0.7, loadmax: 0.7 }, { load: 0.95, loadmax: 1 }, {}])
          console.log(loadBar(bus).text(), loadBar(bus).children.at(-1).className ?? "");"#;
    prints(
        "page_bus_load_is_bar_with_number",
        program,
        "div(div(i() b()) span(12.5 %)) good\n\
         div(div(i() b()) span(70.0 %)) warn\n\
         div(div(i() b()) span(95.0 %)) bad\n\
         span(— (no bit rate))",
    );
}
