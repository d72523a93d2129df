//! Wall that the flight saw, and the patches it missed.

use maud::{Markup, html};

use super::figures::{count, decimal, percent, place};
use super::overview::MARKED;
use crate::session::{CoverageReport, CoveredFlight, Report};

pub(super) fn section(report: &Report, shown_fraction: Option<f64>) -> Markup {
    html! {
        @if report.coverage.is_some() || shown_fraction.is_some() {
            section id="coverage" {
                h2 { "Coverage of the wall" }
                table { tbody {
                    @if let Some(c) = &report.coverage {
                        tr { th scope="row" { "Flight" } td colspan="2" { (flight(&c.of)) } }
                        (share("Seen by the flight", c.one_way_fraction))
                        (share("Seen by it or the flight back", c.both_ways_fraction))
                    }
                    @if let Some(fraction) = shown_fraction {
                        (share("Shown in the window", fraction))
                    }
                } }
                @if let Some(c) = &report.coverage { (patches(c)) }
            }
        }
    }
}

fn flight(f: &CoveredFlight) -> Markup {
    let route = match (f.route.as_str(), f.route.strip_prefix("leaf:")) {
        ("trunk", _) => "Along the path",
        ("all", _) => "Through all branches",
        (_, Some(_)) => "To the tip of branch ",
        _ => "Along a camera path that was given",
    };
    html! {
        (route) (f.route.strip_prefix("leaf:").unwrap_or(""))
        @if f.reverse { ", reversed" }
        ": " (count(f.cameras as u64)) " cameras, " (decimal(f.field_of_view_deg, 0)) "° of view"
    }
}

fn share(name: &str, fraction: f64) -> Markup {
    let width = format!("width:{:.1}%", (100.0 * fraction).clamp(0.0, 100.0));
    html! { tr {
        th scope="row" { (name) }
        td class="n" { (percent(fraction)) }
        td class="share" { div class="bar" { i style=(width) {} } }
    } }
}

fn patches(c: &CoverageReport) -> Markup {
    let hidden = c.patches.len().saturating_sub(MARKED);
    html! {
        p { "Of " (decimal(c.area_mm2, 0)) " mm² of wall." }
        h3 { "Missed patches" }
        @if c.patches.is_empty() {
            p { "None of " (decimal(c.listed_from_mm2, 0)) " mm² and more." }
        } @else {
            div class="wide" { table {
                thead { tr {
                    th class="n" { "No." }
                    th class="n" { "Area, mm²" }
                    th class="n" { "At, mm" }
                    th { "Centre, LPS mm" }
                } }
                tbody { @for (i, p) in c.patches.iter().take(MARKED).enumerate() {
                    tr {
                        th scope="row" class="n" { (i + 1) }
                        td class="n" { (decimal(p.area_mm2, 0)) }
                        td class="n" { (decimal(p.arc_mm, 0)) }
                        td class="n" { (place(p.center_mm)) }
                    }
                } }
            } }
            @if hidden > 0 { p {
                "And " (hidden) " smaller ones: the window lists them, and the " code { "report.json" } " of a run."
            } }
        }
        @if c.smaller_patches > 0 {
            p class="faint" {
                (count(c.smaller_patches)) " patches smaller than " (decimal(c.listed_from_mm2, 0))
                " mm² are not listed: " (decimal(c.smaller_patches_mm2, 0)) " mm² together."
            }
        }
    }
}
