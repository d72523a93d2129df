//! The report as one page of HTML: what `report.json` says, with pictures, curves and bars. The page
//! of a run and that of the window are this one; the window adds what its user noted.
//!
//! A page loads nothing: its pictures are within it, it has no script, and a policy forbids the
//! reader's browser to fetch anything. What differs between two runs on the same input stands in
//! the elements `time` and in the section `run`, and nowhere else.

mod chart;
mod coverage;
mod figures;
mod lumen;
mod notes;
mod overview;
mod path;
mod run;

use std::path::Path;

use maud::{DOCTYPE, Markup, PreEscaped, html};

pub use notes::{Finding, MeasuredValue, SliceView};

use crate::formats::{FormatError, NOTICE, atomic_file};
use crate::session::{PAGE_FILE, Report, ReportPictures};
use figures::{count, decimal, percent, plain};

/// Content of a page.
#[derive(Clone, Copy, Default)]
pub struct ReportPage<'a> {
    /// The report; a section whose part is not there is left out.
    pub report: Option<&'a Report>,
    /// Pictures of the lumen.
    pub pictures: Option<&'a ReportPictures>,
    /// Heading that the user gave it.
    pub title: Option<&'a str>,
    /// Share of the wall's area that the window has shown, 0 to 1.
    pub shown_fraction: Option<f64>,
    /// Places that the user noted.
    pub findings: &'a [Finding],
    /// Measurements that the user made.
    pub measurements: &'a [MeasuredValue],
    /// C-RADS category that follows from the findings of a colon.
    pub category: Option<&'a str>,
}

/// Forbids everything but what is within the page.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

const STYLE: &str = include_str!("style.css");

impl ReportPage<'_> {
    /// Writes the page into the folder of a run.
    ///
    /// # Errors
    /// [`FormatError::Io`].
    pub fn write(&self, folder: &Path) -> Result<(), FormatError> {
        let html = self.html();
        atomic_file::write_atomic(&folder.join(PAGE_FILE), |o| o.write_all(html.as_bytes()))
    }

    /// Returns the page as HTML.
    pub fn html(&self) -> String {
        let title = self.title.map(plain).filter(|t| !t.trim().is_empty());
        let heading = title.as_deref().unwrap_or("Virtual endoscopy");
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(POLICY);
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (heading) " – intima report" }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    header {
                        h1 { (heading) }
                        @if let Some(report) = self.report { (subtitle(report)) }
                        p class="notice" { (NOTICE) " Not a medical device." }
                    }
                    main { (self.sections()) }
                    footer { "intima " (env!("CARGO_PKG_VERSION")) ". " (NOTICE) " Not a medical device." }
                }
            }
        };
        page.into_string()
    }

    fn sections(&self) -> Markup {
        html! {
            @if let Some(report) = self.report {
                (warnings(&report.warnings))
                (tiles(report))
                (overview::section(report, self.pictures))
                (path::section(report))
                (coverage::section(report, self.shown_fraction))
            }
            (notes::findings(self.findings, self.measurements, self.category))
            (notes::measurements(self.measurements))
            @if let Some(report) = self.report {
                (path::tree(report))
                (lumen::section(report))
                (run::section(report))
            }
            (limits())
        }
    }
}

/// One line that says what was examined.
fn subtitle(report: &Report) -> Markup {
    let input = report.input.as_ref().or(report.mask.as_ref());
    let organ = report.organ.as_ref().map(|o| o.name);
    html! {
        p class="faint" {
            @if let Some(organ) = organ { (lumen::capitalised(organ)) " · " }
            @if let Some(modality) = input.and_then(|i| i.modality) { (modality) " · " }
            @if let Some(series) = input.and_then(|i| i.series_hash.as_deref()) {
                "series " code { (series) } " · "
            }
            "made " time datetime=(report.date) { (report.date.replace('T', " ").replace('Z', " UTC")) }
        }
    }
}

fn warnings(warnings: &[String]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            section id="warnings" class="warnings" {
                h3 { "Warnings" }
                ul { @for w in warnings { li { (plain(w)) } } }
            }
        }
    }
}

/// The figures that are read first.
fn tiles(report: &Report) -> Markup {
    let narrowest = report.profile.as_ref().and_then(|p| {
        // The list has the largest narrowing first.
        p.narrowest.iter().min_by(|a, b| a.radius_mm.total_cmp(&b.radius_mm))
    });
    html! {
        section id="summary" class="tiles" {
            @if let Some(l) = &report.lumen {
                (tile("Volume of the lumen", html! { (decimal(l.volume_ml, 1)) " ml" }))
            }
            @if let Some(p) = &report.profile {
                (tile("Length of the path", html! { (decimal(p.length_mm(), 0)) " mm" }))
            }
            @if let Some(n) = narrowest {
                (tile("Narrowest, radius there", html! { (decimal(n.radius_mm, 1)) " mm" }))
            }
            @if let Some(c) = &report.coverage {
                (tile("Wall seen both ways", percent(c.both_ways_fraction)))
                (tile("Missed patches", html! { (c.patches.len()) }))
            }
            @if let Some(tree) = report.centerline.as_ref().and_then(|c| c.tree.as_ref()) {
                (tile("Branches", count(tree.branches)))
            }
            @if let Some(organ) = &report.organ {
                (tile("Confidence in the organ", decimal(organ.confidence, 2)))
            }
        }
    }
}

fn tile(name: &str, value: Markup) -> Markup {
    html! { div class="tile" { b { (value) } span { (name) } } }
}

fn limits() -> Markup {
    html! {
        section id="limits" {
            h2 { "How to read this page" }
            ul {
                li { "Places are patient coordinates, LPS: +x to the patient's left, +y to the back, +z to the head. Lengths are millimetres." }
                li { "A radius is that of the largest sphere about a point of the path that lies in the lumen. A place is narrow against the widest radii on both sides of it; none below the size of a voxel, or narrower by less than half of it, is listed. An area is that of the section across the path; at the mouth of a branch it holds part of the branch. There is none where the plane runs along the lumen." }
                li { "Wall counts as seen when it was inside a frame and nothing stood between. That it was seen by the program does not mean that somebody looked at it." }
                li { "A wall can only be where the scan shows one: thin folds, collapsed stretches and residue change lumen, path and coverage. Nothing here looks for lesions." }
                li { "The page holds no name of a file and no text of the scan. A run has all its figures in " code { "report.json" } " too, unrounded." }
            }
        }
    }
}
