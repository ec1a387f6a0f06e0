//! Numbers formatted for readers.

/// Placeholder of a missing value.
pub const NONE: &str = "–";

/// A whole number in groups of three digits.
pub fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() * 4 / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// A number with `places` decimals; a dash if it is absent or not finite.
pub fn decimals(value: impl Into<Option<f64>>, places: usize) -> String {
    match value.into() {
        Some(v) if v.is_finite() => format!("{v:.places$}").replacen('-', "−", 1),
        _ => NONE.to_owned(),
    }
}

/// A number in three digits with a suffix (k, M, ...), without trailing zeros.
pub fn short(value: f64) -> String {
    if !value.is_finite() {
        return NONE.to_owned();
    }
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e15).contains(&size) {
        return format!("{value:.1e}").replace('-', "−");
    }
    let (unit, suffix) = [(1e12, " T"), (1e9, " G"), (1e6, " M"), (1e3, " k")]
        .into_iter()
        .find(|(unit, _)| size >= 0.9995 * unit && size >= 9999.5)
        .unwrap_or((1.0, ""));
    let scaled = value / unit;
    let places = if scaled.abs() >= 99.95 {
        0
    } else if scaled.abs() >= 9.995 {
        1
    } else if scaled.abs() >= 0.9995 {
        2
    } else {
        4
    };
    let text = format!("{scaled:.places$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{suffix}").replacen('-', "−", 1)
}

/// A duration in seconds, minutes or hours.
pub fn seconds(s: f64) -> String {
    if !s.is_finite() {
        return NONE.to_owned();
    }
    let whole = s.round() as u64;
    match whole {
        3600.. => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
        120.. => format!("{} min {:02} s", whole / 60, whole % 60),
        _ if s >= 10.0 || s == 0.0 => format!("{s:.0} s"),
        _ if s >= 1.0 => format!("{s:.1} s"),
        _ if (0.0995..0.9995).contains(&(s * 1e3)) => format!("{:.3} ms", s * 1e3),
        _ => format!("{} ms", short(s * 1e3)),
    }
}

/// Bytes in kB, MB or GB.
pub fn bytes(n: u64) -> String {
    match n {
        10_000_000_000.. => format!("{:.1} GB", n as f64 / 1e9),
        1_000_000.. => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.1} kB", n as f64 / 1e3),
    }
}

/// `part` of `whole` in %; a dash if the whole is zero.
pub fn percent(part: f64, whole: f64) -> String {
    let share = 100.0 * part / whole;
    if share.is_finite() { format!("{} %", decimals(share, 1)) } else { NONE.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_well() {
        assert_eq!([0, 999, 1000, 1234567].map(count), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!(
            [0.0, 1.0, 0.25, 123.4, 9999.0, 10000.0, -1234567.0].map(short),
            ["0", "1", "0.25", "123", "9999", "10 k", "−1.23 M"]
        );
        assert_eq!([1e-9, f64::NAN].map(short), ["1.0e−9", "–"]);
        assert_eq!(
            [0.0, 4.424e-4, 0.012, 3.21, 59.6, 119.0, 125.0, 7300.0, f64::INFINITY].map(seconds),
            ["0 s", "0.442 ms", "12 ms", "3.2 s", "60 s", "119 s", "2 min 05 s", "2 h 01 min", "–"]
        );
        assert_eq!([512, 276_520, 6_100_000, 24_000_000_000].map(bytes), ["0.5 kB", "276.5 kB", "6.1 MB", "24.0 GB"]);
        assert_eq!((decimals(-0.5, 2), decimals(None, 2), percent(1.0, 0.0)), ("−0.50".into(), "–".into(), "–".into()));
    }
}
