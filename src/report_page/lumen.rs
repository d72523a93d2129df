//! Sections on the scan, the choice of the lumen, and the place of its wall.

use maud::{Markup, html};

use super::figures::{count, decimal, percent, place, plain, row, triple};
use crate::session::{
    ComponentReport, InputReport, LumenReport, OrganReport, Report, SelectionReport, SurfaceReport,
    WallMethod, WallReport,
};

pub(super) fn section(report: &Report) -> Markup {
    // The unit of values is known for CT alone.
    let is_ct = report.input.as_ref().is_some_and(|i| i.modality == Some("CT"));
    let unit = if is_ct { "\u{a0}HU" } else { "" };
    html! {
        @if report.input.is_some() || report.mask.is_some() {
            section id="input" {
                h2 { "Scan" }
                div class="wide" { table { tbody {
                    @if let Some(input) = &report.input { (volume("Volume", input)) }
                    @if let Some(mask) = &report.mask { (volume("Label map", mask)) }
                } } }
            }
        }
        @if let Some(organ) = &report.organ { (found_organ(organ, unit)) }
        @if let Some(l) = &report.lumen { (lumen(l, unit)) }
        @if let Some(w) = &report.wall { (wall(w, unit)) }
        @if let Some(s) = &report.surface { (surface(s)) }
    }
}

pub(super) fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or_else(String::new, |c| c.to_uppercase().chain(letters).collect())
}

fn volume(name: &str, input: &InputReport) -> Markup {
    html! {
        (row(name, html! {
            (triple(input.dims.map(f64::from), 0)) " voxels, " (plain(&input.sample_type))
        }))
        (row("Voxel size", html! { (triple(input.spacing_mm, 3)) " mm" }))
        @if let Some(modality) = input.modality { (row("Modality", html! { (modality) })) }
        @if let Some(series) = &input.series_hash {
            (row("Series, hash of its UID", html! { code { (series) } }))
        }
        @if let Some(hash) = &input.hash { (row("Samples, BLAKE3", html! { code { (hash) } })) }
    }
}

fn found_organ(organ: &OrganReport, unit: &str) -> Markup {
    html! {
        section id="organ" {
            h2 { "How the organ was found" }
            table { tbody {
                (row("Organ", html! { (capitalised(organ.name)) }))
                (row("Threshold", html! { (decimal(organ.threshold, 0)) (unit) }))
                (row("Confidence", html! {
                    (decimal(organ.confidence, 2)) " (least margin by which a gate was passed, 0 to 1)"
                }))
                (row("Segments", html! { @for (i, s) in organ.segments.iter().enumerate() {
                    @if i > 0 { ", " }
                    (decimal(s.volume_ml, 1))
                } " ml" }))
            } }
            h3 { "Measurements and gates" }
            ul { @for reason in &organ.reasons { li { (plain(reason)) } } }
        }
    }
}

fn lumen(l: &LumenReport, unit: &str) -> Markup {
    html! {
        section id="lumen" {
            h2 { "Lumen" }
            div class="wide" { table { tbody {
                @if let Some(selection) = &l.selection { (selected(selection, unit)) }
                @if let Some(threshold) = l.leak_threshold {
                    (row("Threshold before the first leak", html! { (decimal(threshold, 0)) (unit) }))
                }
                (row("Volume", html! { (decimal(l.volume_ml, 2)) " ml" }))
                (row("Voxels", html! {
                    (count(l.internal_voxels)) " inside and " (count(l.boundary_voxels)) " at the wall"
                }))
                @if l.filled_cavities > 0 {
                    (row("Cavities filled", html! {
                        (count(l.filled_cavities)) ", " (count(l.filled_voxels)) " voxels"
                    }))
                }
                @if let Some(taken) = &l.taken { (row("Component taken", component(taken))) }
                @if l.joined_voxels > 0 {
                    (row("Voxels added where parts touched by edges or corners", html! {
                        (count(l.joined_voxels))
                        @for [x, y, z] in &l.joined_at_mm {
                            "; (" (decimal(*x, 1)) ", " (decimal(*y, 1)) ", " (decimal(*z, 1)) ") mm"
                        }
                    }))
                }
                @if l.other_components > 0 {
                    (row("Components left out", html! {
                        (count(l.other_components)) ", " (count(l.other_voxels)) " voxels"
                    }))
                }
                @for c in &l.left_out {
                    (row(if c.outside_body { "– outside the body" } else { "– in the body" }, component(c)))
                }
                (row("Reaches the edge of the volume", html! { (if l.touches_edge { "yes" } else { "no" }) }))
            } } }
        }
    }
}

fn selected(s: &SelectionReport, unit: &str) -> Markup {
    let end = |v: Option<f64>, open: &str| v.map_or(html! { (open) }, |v| decimal(v, 0));
    html! {
        @if let Some([low, high]) = s.range {
            (row("Values inside", html! { (end(low, "any")) " to " (end(high, "any")) (unit) }))
        }
        @if let Some(labels) = &s.labels {
            (row("Labels", html! {
                @if labels.is_empty() { "every one but 0" }
                @for (i, label) in labels.iter().enumerate() {
                    @if i > 0 { ", " }
                    (decimal(*label as f64, 0))
                }
            }))
        }
        @if let Some(seed) = s.seed_voxel {
            (row("Seed voxel", html! {
                (count(seed[0])) ", " (count(seed[1])) ", " (count(seed[2]))
            }))
        }
    }
}

fn component(c: &ComponentReport) -> Markup {
    html! { (decimal(c.volume_ml, 2)) " ml at " (place(c.first_mm)) " (LPS mm)" }
}

fn wall(w: &WallReport, unit: &str) -> Markup {
    let method = match w.method {
        WallMethod::Field => "grey values: where the profile across the wall is steepest",
        WallMethod::Relaxed => "label map, smoothed within half a voxel",
        WallMethod::Exact => "half way between voxels, or at the threshold",
        WallMethod::Auto => "by the kind of scan",
    };
    html! {
        section id="wall" {
            h2 { "Wall" }
            table { tbody {
                (row("Placed by", html! { (method) }))
                @if let Some(f) = &w.field {
                    (row("Median value of lumen and wall", html! {
                        (decimal(f.lumen_value, 0)) " and " (decimal(f.wall_value, 0)) (unit)
                    }))
                    (row("Threshold along the wall, 5 to 95 %", html! {
                        (decimal(f.threshold_percentiles[0], 0)) " to " (decimal(f.threshold_percentiles[4], 0)) (unit)
                    }))
                    (row("Noise in the lumen", html! { (decimal(f.noise, 0)) (unit) }))
                    (row("Blur of the scan, standard deviation", html! { (decimal(f.sigma_mm, 2)) " mm" }))
                    (row("Wall on a thin sheet", percent(f.sheet_share)))
                    (row("Wall that the scan does not show", percent(f.closed_by_limit_share)))
                }
            } }
        }
    }
}

fn surface(s: &SurfaceReport) -> Markup {
    html! {
        section id="surface" {
            h3 { "Surface" }
            table { tbody {
                (row("Area", html! { (decimal(s.area_mm2, 0)) " mm²" }))
                (row("Mesh", html! {
                    (count(s.vertices)) " vertices, " (count(s.faces)) " faces, "
                    (if s.watertight { "watertight" } else { "not watertight" })
                }))
                (row("Parts and tunnels", html! {
                    (count(s.components)) " and " (decimal(s.tunnels as f64, 0))
                }))
            } }
        }
    }
}
