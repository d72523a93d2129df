//! Findings and measurements of the window's user.

use maud::{Markup, html};

use super::figures::{grouped, image, plain};
use crate::session::PngPicture;

/// A place that the user noted.
#[derive(Clone, Debug, Default)]
pub struct Finding {
    /// The remark.
    pub text: String,
    /// The eye, LPS mm.
    pub eye_mm: [f64; 3],
    /// The wall in the middle of the view, LPS mm.
    pub wall_mm: Option<[f64; 3]>,
    /// Length of the path up to the eye, or to its nearest point, mm.
    pub arc_mm: Option<f64>,
    /// Part of the organ that the path starts in.
    pub start: Option<&'static str>,
    /// Branch or piece that the place lies in.
    pub segment: Option<String>,
    /// What else is said of it: name and value.
    pub said: Vec<(&'static str, String)>,
    /// View from inside.
    pub view: Option<PngPicture>,
    /// Slices through the wall.
    pub slices: Vec<SliceView>,
}

/// A slice of the volume.
#[derive(Clone, Debug)]
pub struct SliceView {
    /// Plane, such as `axial`.
    pub name: &'static str,
    /// The picture.
    pub picture: PngPicture,
}

/// A length or an angle that the user measured.
#[derive(Clone, Debug)]
pub struct MeasuredValue {
    /// Name that the user gave it; empty for none.
    pub name: String,
    /// The value with its unit.
    pub text: String,
    /// Points that were marked, LPS mm.
    pub points_mm: Vec<[f64; 3]>,
    /// Whether it is a length.
    pub is_length: bool,
    /// Number of the finding that it is of, from 1.
    pub finding: Option<usize>,
}

fn shown(p: [f64; 3]) -> String {
    p.map(|v| grouped(v, 1)).join(", ")
}

/// Lengths that were measured of a finding, with their numbers from 1.
fn sizes(
    finding: usize,
    all: &[MeasuredValue],
) -> impl Iterator<Item = (usize, &MeasuredValue)> + use<'_> {
    (1..).zip(all).filter(move |(_, m)| m.is_length && m.finding == Some(finding))
}

pub(super) fn findings(
    findings: &[Finding],
    measurements: &[MeasuredValue],
    category: Option<&str>,
) -> Markup {
    html! { @if !findings.is_empty() {
        section id="findings" {
            h2 { "Findings" }
            @if let Some(category) = category {
                p { "C-RADS " (category) ", by the sizes noted; whether the examination is complete \
                     (C0) is for its reader to say." }
            }
            @for (i, f) in findings.iter().enumerate() { (finding(i + 1, f, measurements)) }
        }
    } }
}

fn finding(number: usize, f: &Finding, measurements: &[MeasuredValue]) -> Markup {
    let text = plain(&f.text);
    html! {
        article class="finding" {
            h3 { (number) ". " (text) }
            p {
                @for (i, size) in sizes(number, measurements) {
                    "Size " (size.text) " (measurement " (i) "). "
                }
                @for (name, value) in &f.said { (name) ": " (value) ". " }
                @if let Some(segment) = &f.segment { (plain(segment)) ". " }
                @if let Some(arc) = f.arc_mm {
                    (grouped(arc, 0)) " mm along the path"
                    @if let Some(start) = f.start { " from the " (start) }
                    ". "
                } @else { "Off the path. " }
                @if let Some(wall) = f.wall_mm { "Wall at " (shown(wall)) " (LPS mm)." }
                @else { "Eye at " (shown(f.eye_mm)) " (LPS mm)." }
            }
            @if f.view.is_some() || !f.slices.is_empty() {
                div class="slices" {
                    @if let Some(view) = &f.view { figure {
                        (image(view, &format!("Finding {number} from inside")))
                        figcaption { "from inside" }
                    } }
                    @for slice in &f.slices { figure {
                        (image(&slice.picture, &format!("Finding {number}, {} slice", slice.name)))
                        figcaption { (slice.name) }
                    } }
                }
            }
        }
    }
}

pub(super) fn measurements(all: &[MeasuredValue]) -> Markup {
    html! { @if !all.is_empty() {
        section id="measurements" {
            h2 { "Measurements" }
            div class="wide" { table {
                thead { tr { th class="n" { "No." } th { "Name" } th class="n" { "Value" } th { "Points, LPS mm" } } }
                tbody { @for (i, m) in all.iter().enumerate() {
                    tr {
                        th scope="row" class="n" { (i + 1) }
                        td { (plain(&m.name)) }
                        td class="n" { (m.text) }
                        td { @for (k, p) in m.points_mm.iter().enumerate() {
                            @if k > 0 { " → " }
                            (shown(*p))
                        } }
                    }
                } }
            } }
        }
    } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_a_finding_are_its_size_and_others_are_not() {
        let of = |is_length, finding| MeasuredValue {
            name: String::new(),
            text: String::new(),
            points_mm: Vec::new(),
            is_length,
            finding,
        };
        let all = [of(false, Some(1)), of(true, None), of(true, Some(1)), of(true, Some(2))];
        let found: Vec<usize> = sizes(1, &all).map(|s| s.0).collect();
        assert_eq!(found, [3]);
    }
}
