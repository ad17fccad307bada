//! The part of Markdown that the rules need: lines outside code blocks, code spans, link targets, table rows.

/// The lines outside fenced code, with their numbers from 1.
pub(super) fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut fenced = false;
    text.lines().enumerate().filter_map(move |(index, line)| {
        let fence = line.trim_start().starts_with("```");
        let inside = fenced || fence;
        fenced ^= fence;
        (!inside).then_some((index + 1, line))
    })
}

/// Text between backticks.
pub(super) fn code_spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// Targets of `[text](target)`, also where the text is an image. Code spans hold no links.
pub(super) fn link_targets(line: &str) -> Vec<String> {
    let plain: String = line.split('`').step_by(2).collect::<Vec<_>>().join("code");
    let ends = plain.split("](").skip(1);
    ends.filter_map(|rest| rest.split_once(')'))
        .map(|(target, _)| target.to_owned())
        .collect()
}

/// The body rows of every table below a heading that `wanted` accepts, with line numbers.
pub(super) fn table_rows(text: &str, wanted: impl Fn(&str) -> bool) -> Vec<(usize, &str)> {
    let mut under = wanted("");
    let mut row_of_table = 0;
    let mut rows = Vec::new();
    for (number, line) in prose(text) {
        if line.starts_with('#') {
            under = wanted(line.trim_start_matches('#').trim());
        }
        row_of_table = if line.starts_with('|') {
            row_of_table + 1
        } else {
            0
        };
        // The first two rows are the header and its rule.
        if under && row_of_table > 2 {
            rows.push((number, line));
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "# A\n| h |\n|--|\n| no |\n```\n| code |\n```\n## What works\n\n| h |\n|---|\n| one |\n| two |\n\nend\n";

    #[test]
    fn table_rows_below_wanted_heading_only() {
        let rows = table_rows(PAGE, |heading| heading == "What works");
        assert_eq!(rows, [(12, "| one |"), (13, "| two |")]);
        assert_eq!(table_rows(PAGE, |_| true).len(), 3);
    }

    #[test]
    fn prose_leaves_fenced_code_out() {
        assert!(prose(PAGE).all(|(_, line)| !line.contains("code")));
        assert_eq!(prose(PAGE).last(), Some((15, "end")));
    }

    #[test]
    fn code_spans_and_links_of_line() {
        let line = "`a` [b](c.md) `[no](link)` [![img](d.svg)](e#f)";
        assert_eq!(code_spans(line).collect::<Vec<_>>(), ["a", "[no](link)"]);
        assert_eq!(link_targets(line), ["c.md", "d.svg", "e#f"]);
    }
}
