//! Spans of time as people write them.

use std::time::Duration;

/// Reads `10s`, `500ms`, `1.5m` or plain seconds; must be above zero.
///
/// # Errors
/// Says what is wrong.
pub(super) fn parse(text: &str) -> Result<Duration, String> {
    let text = text.trim();
    let (number, unit_s) = if let Some(number) = text.strip_suffix("ms") {
        (number, 1e-3)
    } else if let Some(number) = text.strip_suffix('s') {
        (number, 1.0)
    } else if let Some(number) = text.strip_suffix('m') {
        (number, 60.0)
    } else {
        (text, 1.0)
    };
    let value: f64 = number.trim().parse().map_err(|_| "give a span such as 10s, 500ms or 2m".to_owned())?;
    match Duration::try_from_secs_f64(value * unit_s) {
        Ok(span) if !span.is_zero() => Ok(span),
        _ => Err("give a span above zero".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_read_in_their_units() {
        assert_eq!(parse("10s"), Ok(Duration::from_secs(10)));
        assert_eq!(parse(" 500 ms "), Ok(Duration::from_millis(500)));
        assert_eq!(parse("1.5m"), Ok(Duration::from_secs(90)));
        assert_eq!(parse("0.25"), Ok(Duration::from_millis(250)));
        for bad in ["", "s", "-1s", "0", "NaN", "inf", "1h", "1e300m"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
