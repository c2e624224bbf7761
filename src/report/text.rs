//! Numbers and text for a page.

/// Text made safe for HTML and SVG, in content and in quoted attributes. Control characters, which XML forbids, vanish.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            c if c.is_control() && !c.is_whitespace() => {}
            c => safe.push(c),
        }
    }
    safe
}

/// A number with so many significant digits; powers of ten beyond 1e-3 and 1e5. A dash if it is not finite.
pub fn number(x: f64, digits: usize) -> String {
    if !x.is_finite() {
        return "–".into();
    }
    if x == 0.0 {
        return "0".into();
    }
    let scientific = format!("{:.*e}", digits.saturating_sub(1), x.abs());
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let magnitude = if (-3..5).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        format!("{:.decimals$}", mantissa.parse::<f64>().unwrap_or(0.0) * 10f64.powi(exponent))
    } else {
        format!("{mantissa}·{}", power_of_ten(exponent))
    };
    if x < 0.0 { format!("−{magnitude}") } else { magnitude }
}

/// 10 with a raised exponent.
pub fn power_of_ten(exponent: i32) -> String {
    const RAISED: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digits = exponent.unsigned_abs().to_string();
    let raised = digits.bytes().map(|d| RAISED[usize::from(d - b'0')]);
    let sign = if exponent < 0 { "⁻" } else { "" };
    format!("10{sign}{}", raised.collect::<String>())
}

/// A ratio in percent with two or three digits.
pub fn percent(ratio: f64) -> String {
    let x = 100.0 * ratio;
    let digits = if x.abs() < 100.0 { 2 } else { 3 };
    format!("{} %", number(x, digits))
}

/// A ratio in percent with its sign, two digits.
pub fn signed_percent(ratio: f64) -> String {
    let sign = if ratio > 0.0 { "+" } else { "" };
    format!("{sign}{}", percent(ratio))
}

/// An angle to a hundredth of a degree, without the sign of the unit.
pub fn degrees(x: f64) -> String {
    if x.is_finite() { format!("{}", (100.0 * x).round() / 100.0) } else { "–".into() }
}

/// A time in seconds, below one in milliseconds, from minutes on in minutes and seconds too.
pub fn seconds(s: f64) -> String {
    if s >= 120.0 && s.is_finite() {
        let whole = s.round();
        format!("{} s ({:.0} min {:.0} s)", number(whole, 3), (whole / 60.0).floor(), whole % 60.0)
    } else if s != 0.0 && s.abs() < 1.0 {
        format!("{} ms", number(1e3 * s, 3))
    } else {
        format!("{} s", number(s, 3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        for (x, digits, want) in [
            (0.123_456, 2, "0.12"),
            (99.96, 3, "100"),
            (-1234.0, 2, "−1200"),
            (1.1e9, 2, "1.1·10⁹"),
            (4e-5, 1, "4·10⁻⁵"),
            (0.0, 3, "0"),
            (f64::NAN, 3, "–"),
            (f64::MAX, 2, "1.8·10³⁰⁸"),
        ] {
            assert_eq!(number(x, digits), want);
        }
        assert_eq!((percent(0.0123).as_str(), percent(638.0).as_str()), ("1.2 %", "63800 %"));
        assert_eq!((signed_percent(0.02).as_str(), signed_percent(-0.02).as_str()), ("+2.0 %", "−2.0 %"));
        assert_eq!((seconds(20.0).as_str(), seconds(0.004).as_str()), ("20.0 s", "4.00 ms"));
        assert_eq!((degrees(57.0).as_str(), degrees(9.154).as_str()), ("57", "9.15"));
        assert_eq!(seconds(300.0), "300 s (5 min 0 s)");
    }

    #[test]
    fn text_is_escaped() {
        assert_eq!(escape("<a b=\"c\">'&\u{0}\u{1b}"), "&lt;a b=&quot;c&quot;&gt;&#39;&amp;");
    }
}
