//! Time of day in the names of files, UTC: such names sort by time.

use std::time::Duration;

/// A Unix time as `20261123T215501.250Z`.
pub(crate) fn text(unix: Duration) -> String {
    let (seconds, ms) = (unix.as_secs(), unix.subsec_millis());
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = date(days);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}.{ms:03}Z")
}

/// Whether a text has that form.
pub(crate) fn is_text(text: &str) -> bool {
    let form = b"00000000T000000.000Z";
    let is_like = |(byte, like): (u8, &u8)| match like {
        b'0' => byte.is_ascii_digit(),
        like => byte == *like,
    };
    text.len() == form.len() && text.bytes().zip(form).all(is_like)
}

/// Year, month and day of the Gregorian calendar, so many days after 1970-01-01.
const fn date(days: u64) -> (u64, u64, u64) {
    // Years from March on, in eras of 400 years: the leap day is the last of its year.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 {
        shifted + 3
    } else {
        shifted - 9
    };
    let first = if month <= 2 { 1 } else { 0 };
    (year + era * 400 + first, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unix_time_has_date_and_time_of_day() {
        for (seconds, wanted) in [
            (0, "19700101T000000.000Z"),
            (951_782_399, "20000228T235959.000Z"),
            (951_782_400, "20000229T000000.000Z"),
            (1_709_164_800, "20240229T000000.000Z"),
            (1_795_478_400, "20261124T000000.000Z"),
        ] {
            assert_eq!(text(Duration::from_secs(seconds)), wanted);
            assert!(is_text(wanted));
        }
        for wrong in ["", "20261124T000000Z", "2026112xT000000.000Z"] {
            assert!(!is_text(wrong), "{wrong}");
        }
    }
}
