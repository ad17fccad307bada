//! An excerpt of two lines: the text at a location, and carets below. Programs write nets of many
//! kilobytes in one line, and the libraries for this show whole lines; so this shows a window. The
//! message of the fault itself is not printed here.

use std::ops::Range;

/// Characters of the line shown before the location.
const BEFORE: usize = 60;
/// Characters shown from the location on.
const BEHIND: usize = 60;

/// Line and column (both from 1, columns in characters) of a byte of `text`.
pub fn location(text: &str, start: usize) -> (usize, usize) {
    let before = &text[..text.floor_char_boundary(start)];
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    (
        before.matches('\n').count() + 1,
        before[line_start..].chars().count() + 1,
    )
}

/// Appends the line of `text` that contains the start of `at`, and carets with `note` below.
pub fn append(text: &str, at: &Range<usize>, note: &str, out: &mut String) {
    let start = text.floor_char_boundary(at.start);
    let end = text.floor_char_boundary(at.end).max(start);
    let (before, behind) = text.split_at(start);
    let line = before.rsplit('\n').next().unwrap_or_default();
    let rest = behind.split('\n').next().unwrap_or_default();
    let number = before.matches('\n').count() + 1;

    let shown_from = line.char_indices().rev().nth(BEFORE - 1);
    let shown_from = shown_from.map_or(0, |(i, _)| i);
    let shown_to = rest.char_indices().nth(BEHIND);
    let shown_to = shown_to.map_or(rest.len(), |(i, _)| i);
    let dots = |hidden: bool| if hidden { "…" } else { "" };
    let left = dots(shown_from > 0).to_owned() + &line[shown_from..];
    let right = &rest[..shown_to];

    let marked = &right[..right.floor_char_boundary(end - start)];
    let carets = "^".repeat(marked.chars().count().max(1));
    let blank = " ".repeat(left.chars().count());
    let below = format!("{blank}{carets} {note}");
    let plain = |text: &str| text.replace(|c: char| c.is_control(), " ");
    let more = dots(shown_to < rest.len());
    let lines = [
        format!("{number:5} | {}{}{more}", plain(&left), plain(right)),
        format!("      | {}", below.trim_end()),
    ];
    for line in lines {
        out.push_str(line.trim_end());
        out.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::append;

    fn shown(text: &str, at: std::ops::Range<usize>) -> String {
        let mut out = String::new();
        append(text, &at, "note", &mut out);
        out
    }

    #[test]
    fn short_line_is_shown_whole() {
        assert_eq!(
            shown("ab\n\tcö=d\ne", 5..7),
            "    2 |  cö=d\n      |   ^ note\n"
        );
        assert_eq!(shown("", 0..0), "    1 |\n      | ^ note\n");
        assert_eq!(shown("ab", 7..9), "    1 | ab\n      |   ^ note\n");
    }

    #[test]
    fn long_line_is_shown_as_window() {
        let text = format!("{}xyz{}", "a".repeat(5000), "ö".repeat(5000));
        let out = shown(&text, 5000..9000);
        let (a, b) = ("a".repeat(60), "ö".repeat(57));
        let carets = "^".repeat(60);
        let blank = " ".repeat(61);
        assert_eq!(
            out,
            format!("    1 | …{a}xyz{b}…\n      | {blank}{carets} note\n")
        );
    }
}
