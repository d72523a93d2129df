//! Lumen along the path, its narrowest places, and branches by generation.

use maud::{Markup, html};

use super::chart::charts;
use super::figures::{count, decimal, percent, place, row};
use super::overview::letter;
use crate::centerline::ChosenEnd;
use crate::flight::{LumenProfile, NarrowPlace};
use crate::session::{CenterlineReport, Report};

pub(super) fn section(report: &Report) -> Markup {
    let patches = report.coverage.as_ref().map_or(&[][..], |c| &c.patches);
    html! {
        @if report.profile.is_some() || report.centerline.is_some() {
            section id="profile" {
                h2 { "Lumen along the path" }
                @if let Some(profile) = &report.profile {
                    (explanation(profile, !patches.is_empty()))
                    (charts(profile, patches))
                    (narrowest(profile))
                }
            }
            @if let Some(c) = &report.centerline { (centerline(c)) }
        }
    }
}

fn explanation(profile: &LumenProfile, has_patches: bool) -> Markup {
    html! {
        p class="faint" {
            "Lengths count from the start of the path"
            @if let Some(start) = profile.start { ", which is at the " (start) }
            "."
            @if has_patches { " Dots on the axis are missed patches." }
            @if !profile.cuts.is_empty() { " Dashed lines part pieces of the lumen that are not joined." }
        }
    }
}

fn narrowest(profile: &LumenProfile) -> Markup {
    let optional = |v: Option<f64>| v.map_or(html! { "–" }, |v| decimal(v, 1));
    html! {
        h3 { "Narrowest places" }
        @if profile.narrowest.is_empty() {
            p { "None: nowhere that the scan resolves, away from branches and ends, is the lumen narrower by 15 % than the lumen about it." }
        } @else {
            div class="wide" { table {
                thead { tr {
                    th { "" }
                    th class="n" { "At, mm" }
                    th class="n" { "Radius, mm" }
                    th class="n" { "Loss of diameter" }
                    th class="n" { "of area" }
                    th class="n" { "Reference radius, mm" }
                    th class="n" { "Area, mm²" }
                    th class="n" { "Diameters, mm" }
                    th { "Place, LPS mm" }
                } }
                tbody { @for (i, n) in profile.narrowest.iter().enumerate() {
                    tr {
                        th scope="row" { (letter(i)) }
                        td class="n" { (decimal(n.arc_mm, 0)) }
                        td class="n" { (decimal(n.radius_mm, 1)) }
                        td class="n" { (percent(n.narrowing)) }
                        td class="n" { (percent(n.narrowing_area)) }
                        td class="n" {
                            (decimal(n.reference_radius_mm, 1)) ", from "
                            (decimal(n.reference_arc_mm[0], 0)) " to " (decimal(n.reference_arc_mm[1], 0))
                        }
                        td class="n" { (optional(n.area_mm2)) }
                        td class="n" { (diameters(n)) }
                        td class="n" { (place(n.center_mm)) }
                    }
                } }
            } }
        }
    }
}

fn diameters(n: &NarrowPlace) -> Markup {
    match n.smallest_mm.zip(n.largest_mm) {
        Some((smallest, largest)) => html! { (decimal(smallest, 1)) " to " (decimal(largest, 1)) },
        None => html! { "–" },
    }
}

/// The rule of an end, its margin and the runner-up.
fn end_of(end: &ChosenEnd) -> Markup {
    let rule = end.rule.words();
    let place = |[x, y, z]: [f64; 3]| {
        html! {
            "(" (decimal(x, 1)) ", " (decimal(y, 1)) ", " (decimal(z, 1)) ") mm"
        }
    };
    html! {
        (rule) ", " (place(end.at_mm))
        @if let (Some(margin), Some(other)) = (end.margin, end.runner_up_mm) {
            ", " (percent(margin)) " before " (place(other))
        }
        @if end.is_doubtful() { ": in doubt" }
    }
}

fn centerline(c: &CenterlineReport) -> Markup {
    html! {
        section id="centerline" {
            h3 { "Centerline" }
            table { tbody {
                (row("Lines", html! { (count(c.branches)) ", " (decimal(c.length_mm, 0)) " mm together" }))
                (row("Least distance to the wall", html! { (decimal(c.min_clearance_mm, 2)) " mm" }))
                @for (end, name) in c.ends.iter().flatten().zip(["Start", "End"]) {
                    (row(name, end_of(end)))
                }
                @if let Some(mm) = c.beyond_start_mm {
                    (row("Larynx or pharynx above the start", html! { (decimal(mm, 0)) " mm" }))
                }
                @if let Some(mm) = c.beyond_end_mm {
                    (row("Ileum or appendix beyond the end", html! { (decimal(mm, 0)) " mm" }))
                }
                @if c.rerouted_points > 0 {
                    (row("Points led back inside the wall", count(c.rerouted_points)))
                }
                @if c.points_in_cavities > 0 {
                    (row("Points in filled cavities of the mask", count(c.points_in_cavities)))
                }
                @if c.points_outside > 0 {
                    (row("Points beyond the wall", count(c.points_outside)))
                }
                @if c.pieces > 1 {
                    (row("Pieces that are not joined", html! {
                        (count(c.pieces)) ", apart by "
                        @for (i, gap) in c.gaps_mm.iter().enumerate() {
                            @if i > 0 { ", " }
                            (decimal(*gap, 0))
                        }
                        " mm"
                    }))
                }
                @if !c.loops.is_empty() {
                    (row("Loops of the lumen", html! {
                        (c.loops.len())
                        @if c.loops.iter().any(|l| l.doubtful) { "; where some were cut is doubtful" }
                    }))
                }
                @if c.unreachable_voxels > 0 {
                    (row("Voxels without a way to the path", count(c.unreachable_voxels)))
                }
            } }
        }
    }
}

/// Branches by generation, of a tree.
pub(super) fn tree(report: &Report) -> Markup {
    let tree = report.centerline.as_ref().and_then(|c| c.tree.as_ref());
    html! { @if let Some(tree) = tree {
        section id="tree" {
            h2 { "Branches" }
            p {
                (count(tree.branches)) " branches between bifurcations, " (count(tree.terminal_branches))
                " of them terminal"
                @if tree.loops > 0 { ", " (count(tree.loops)) " loops" }
                ". A generation counts the bifurcations on the way from the root."
            }
            div class="wide" { table {
                thead { tr {
                    th class="n" { "Generation" }
                    th class="n" { "Branches" }
                    th class="n" { "Length together, mm" }
                    th class="n" { "Mean radius, mm" }
                } }
                tbody { @for (g, branches) in tree.generations.iter().enumerate() {
                    tr {
                        th scope="row" class="n" { (g) }
                        td class="n" { (count(*branches)) }
                        td class="n" { (tree.generation_lengths_mm.get(g).map_or(html! { "–" }, |v| decimal(*v, 0))) }
                        td class="n" { (tree.generation_radii_mm.get(g).map_or(html! { "–" }, |v| decimal(*v, 2))) }
                    }
                } }
            } }
        }
    } }
}
