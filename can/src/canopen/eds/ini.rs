//! The INI syntax of data sheets: sections, keys, values, comments.

use super::EdsError;

/// A section with its keys, verbatim.
#[derive(Clone, Debug)]
pub(super) struct Section {
    pub(super) name: String,
    pub(super) keys: Vec<(String, String)>,
}

impl Section {
    /// The value of a key, if present and not empty.
    pub(super) fn get(&self, key: &str) -> Option<&str> {
        let found = self.keys.iter().find(|(k, _)| k.eq_ignore_ascii_case(key));
        found
            .map(|(_, value)| value.as_str())
            .filter(|value| !value.is_empty())
    }
}

/// All sections in their order. Comments start with a semicolon, at the start of a line or after
/// white space; names may be quoted.
pub(super) fn parse(text: &str) -> Result<Vec<Section>, EdsError> {
    let text = text.strip_prefix('\u{FEFF}').unwrap_or(text);
    let mut sections: Vec<Section> = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let text = text.trim();
        if text.is_empty() || text.starts_with([';', '#']) {
            continue;
        }
        let wrong = || EdsError::Line {
            line,
            text: text.chars().take(40).collect(),
        };
        if let Some(rest) = text.strip_prefix('[') {
            let (name, _) = rest.split_once(']').ok_or_else(wrong)?;
            sections.push(Section {
                name: name.trim().to_owned(),
                keys: Vec::new(),
            });
        } else {
            let (key, value) = text.split_once('=').ok_or_else(wrong)?;
            let section = sections.last_mut().ok_or_else(wrong)?;
            section
                .keys
                .push((key.trim().to_owned(), without_comment(value).to_owned()));
        }
    }
    Ok(sections)
}

fn without_comment(value: &str) -> &str {
    let begins = |at: &usize| value[..*at].ends_with(char::is_whitespace) || *at == 0;
    let comment = value.match_indices(';').map(|(at, _)| at).find(begins);
    value[..comment.unwrap_or(value.len())].trim()
}
