//! The organ from in front with marks, beside places from inside.

use maud::{Markup, html};

use super::figures::{grouped, image};
use crate::session::{OverviewPicture, Report, ReportPictures};

/// Most missed patches that are marked in the overview and listed: more marks hide the organ.
pub(super) const MARKED: usize = 20;

/// Letter of a narrow place.
pub(super) fn letter(i: usize) -> char {
    char::from(b'a' + (i as u8).min(25))
}

/// A mark in the overview.
struct Mark {
    label: String,
    class: &'static str,
    at: [f64; 2],
}

pub(super) fn section(report: &Report, pictures: Option<&ReportPictures>) -> Markup {
    let Some(pictures) = pictures else { return html! {} };
    let frames = report.frames.as_ref().map(|f| f.count);
    let views = if pictures.inside.is_empty() { "views alone" } else { "views" };
    html! {
        @if pictures.overview.is_some() || !pictures.inside.is_empty() {
            section id="pictures" {
                h2 { "Overview" }
                div class=(views) {
                    @if let Some(overview) = &pictures.overview { (marked(overview, report)) }
                    @if !pictures.inside.is_empty() {
                        div class="inside" {
                            @for p in &pictures.inside {
                                figure {
                                    (image(&p.picture, &format!("From inside, frame {}", p.frame)))
                                    figcaption {
                                        (grouped(p.arc_mm, 0)) " mm"
                                        @if let Some(count) = frames { ", frame " (p.frame) " of " (count) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn marked(overview: &OverviewPicture, report: &Report) -> Markup {
    let [width, height] = overview.picture.size.map(f64::from);
    let marks = placed(marks(overview, report), [width, height]);
    // Marks have the same size on the page, whatever the picture's.
    let unit = height.max(width) / 600.0;
    let has_patches = report.coverage.as_ref().is_some_and(|c| !c.patches.is_empty());
    html! {
        figure {
            div class="marked" {
                (image(&overview.picture, "The whole organ, with path and marks"))
                svg viewBox=(format!("0 0 {width} {height}")) aria-hidden="true" {
                    @for (mark, [x, y]) in &marks {
                        line x1=(round(mark.at[0])) y1=(round(mark.at[1])) x2=(round(*x)) y2=(round(*y))
                            stroke=(mark.class) stroke-width=(round(1.2 * unit)) {}
                        circle cx=(round(mark.at[0])) cy=(round(mark.at[1])) r=(round(2.5 * unit)) fill=(mark.class) {}
                        circle cx=(round(*x)) cy=(round(*y)) r=(round(LABEL * unit)) fill=(mark.class) stroke="#000" stroke-width=(round(unit)) {}
                        text x=(round(*x)) y=(round(y + 4.2 * unit)) text-anchor="middle" fill="#000"
                            font-size=(round(12.0 * unit)) font-weight="700" font-family="sans-serif" { (mark.label) }
                    }
                }
            }
            figcaption {
                @if overview.on_the_right() == "left" { "From in front: the" } @else { "Head up: the" }
                " patient's " (overview.on_the_right()) " is on the right. S and E are start and end of the path; letters are its narrowest places"
                @if has_patches { "; numbers are the patches of wall that the flight missed, drawn in blue" }
                "."
            }
        }
    }
}

fn marks(overview: &OverviewPicture, report: &Report) -> Vec<Mark> {
    let mark = |label: String, class, p: [f64; 3]| Mark { label, class, at: overview.at(p) };
    let mut marks = Vec::new();
    if let Some(c) = &report.coverage {
        let patches = c.patches.iter().take(MARKED).enumerate();
        marks.extend(patches.map(|(i, p)| mark((i + 1).to_string(), "#8fc1ff", p.center_mm)));
    }
    if let Some(p) = &report.profile {
        let narrow = p.narrowest.iter().enumerate();
        marks.extend(narrow.map(|(i, n)| mark(letter(i).into(), "#ffb366", n.center_mm)));
        marks.push(mark("S".into(), "#fff", p.start_mm));
        marks.push(mark("E".into(), "#fff", p.end_mm));
    }
    marks
}

/// Radius of a label, in shares of the picture of 600.
const LABEL: f64 = 9.5;

/// Puts each label beside its place, where no other label is and within the picture.
fn placed(marks: Vec<Mark>, [width, height]: [f64; 2]) -> Vec<(Mark, [f64; 2])> {
    let unit = width.max(height) / 600.0;
    let mut taken: Vec<[f64; 2]> = Vec::new();
    let mut out = Vec::new();
    for mark in marks {
        let candidates = (0..48).map(|k| {
            let (ring, way) = (k / 12, f64::from(k % 12) / 12.0 * std::f64::consts::TAU);
            let reach = (17.0 + 14.0 * f64::from(ring)) * unit;
            [mark.at[0] + reach * way.cos(), mark.at[1] + reach * way.sin()]
        });
        let margin = (LABEL + 1.0) * unit;
        let inside = |p: &[f64; 2]| {
            (margin..=width - margin).contains(&p[0]) && (margin..=height - margin).contains(&p[1])
        };
        let far = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let free = |p: &[f64; 2]| taken.iter().all(|t| far(t, p) >= (2.0 * LABEL + 2.0) * unit);
        let mut all = candidates.filter(inside);
        let label = all.clone().find(free).or_else(|| all.next()).unwrap_or(mark.at);
        taken.push(label);
        out.push((mark, label));
    }
    out
}

fn round(v: f64) -> f64 {
    (v * 10.0).round() / 10.0
}
