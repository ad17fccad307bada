//! Lines and dates, which the text formats share. No format is known here.

/// Lines of a text with their numbers from 1; the text need not be valid UTF-8.
pub(super) fn lines(
    bytes: &[u8],
) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> + Clone {
    bytes
        .split(|byte| *byte == b'\n')
        .enumerate()
        .map(|(number, line)| (number + 1, String::from_utf8_lossy(line)))
}

/// Days from 1970-01-01 to a Gregorian date, 1970 to 9999.
pub(super) fn days_since_1970(year: u32, month: u32, day: u32) -> Option<u64> {
    const BEFORE: [u32; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    if !(1970..=9999).contains(&year) || !(1..=31).contains(&day) {
        return None;
    }
    let leaps = |year: u32| year / 4 - year / 100 + year / 400;
    let is_leap = leaps(year) > leaps(year - 1);
    let before = BEFORE.get(usize::try_from(month.checked_sub(1)?).ok()?)?;
    let past_february = u32::from(month > 2 && is_leap);
    let days = (year - 1970) * 365 + leaps(year - 1) - leaps(1969);
    Some(u64::from(days + before + past_february + day - 1))
}
