//! Numbers and texts as the page shows them. Each number of the report is an element `data` whose
//! value is the number in full, so that a program can compare it with `report.json`.

use base64::Engine as _;
use maud::{Markup, PreEscaped, html};

use crate::session::PngPicture;

/// A number with so many digits behind the point.
pub(super) fn decimal(value: f64, digits: usize) -> Markup {
    html! { data value=(value) { (grouped(value, digits)) } }
}

/// A count.
pub(super) fn count(value: impl TryInto<u64>) -> Markup {
    let value = value.try_into().unwrap_or(u64::MAX);
    html! { data value=(value) { (grouped(value as f64, 0)) } }
}

/// A share, 0 to 1, in per cent.
pub(super) fn percent(share: f64) -> Markup {
    html! { data value=(share) { (grouped(100.0 * share, 1)) } "\u{a0}%" }
}

/// Lengths along x, y and z or other groups of three.
pub(super) fn triple(values: [f64; 3], digits: usize) -> Markup {
    html! { (decimal(values[0], digits)) " × " (decimal(values[1], digits)) " × " (decimal(values[2], digits)) }
}

/// A point.
pub(super) fn place(p: [f64; 3]) -> Markup {
    html! { (decimal(p[0], 1)) ", " (decimal(p[1], 1)) ", " (decimal(p[2], 1)) }
}

/// A number as text: no zero with a sign, a true minus, groups of three digits from 10,000 on.
pub(super) fn grouped(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let text = format!("{:.digits$}", value.abs());
    let is_zero = text.bytes().all(|b| matches!(b, b'0' | b'.'));
    let (whole, rest) = text.split_at(text.find('.').unwrap_or(text.len()));
    let mut out = String::from(if value < 0.0 && !is_zero { "\u{2212}" } else { "" });
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && whole.len() > 4 && (whole.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out + rest
}

/// A text without characters that HTML does not allow.
pub(super) fn plain(text: &str) -> String {
    let is_allowed = |c: char| {
        let is_noncharacter =
            matches!(c, '\u{fdd0}'..='\u{fdef}') || u32::from(c) & 0xfffe == 0xfffe;
        !c.is_control() && !is_noncharacter
    };
    text.chars().map(|c| if is_allowed(c) { c } else { ' ' }).collect()
}

/// A picture within the page.
pub(super) fn image(picture: &PngPicture, alt: &str) -> Markup {
    let [width, height] = picture.size;
    let data = base64::engine::general_purpose::STANDARD.encode(&picture.png);
    // Nothing in base64 needs to be escaped, and it is long.
    let src = PreEscaped(format!("data:image/png;base64,{data}"));
    html! { img width=(width) height=(height) alt=(alt) src=(src); }
}

/// A row of a table of two columns.
pub(super) fn row(name: &str, value: Markup) -> Markup {
    html! { tr { th scope="row" { (name) } td { (value) } } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_and_rounded_and_zero_has_no_sign() {
        let shown = [(1234.5, 1), (12345.678, 2), (-0.04, 1), (-7.25, 1), (1e7, 0), (f64::NAN, 1)];
        let texts = shown.map(|(v, digits)| grouped(v, digits));
        let wanted =
            ["1234.5", "12\u{202f}345.68", "0.0", "\u{2212}7.2", "10\u{202f}000\u{202f}000", "–"];
        assert_eq!(texts, wanted);
        assert_eq!(percent(0.98765).0, "<data value=\"0.98765\">98.8</data>\u{a0}%");
        assert_eq!(count(3usize).0, "<data value=\"3\">3</data>");
    }

    #[test]
    fn characters_that_html_forbids_become_spaces() {
        assert_eq!(plain("a\0b\u{7f}c\u{fdd0}d\u{1ffff}ü<"), "a b c d ü<");
    }
}
