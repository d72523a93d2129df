//! The run: device, times, memory. The only section that differs between runs on the same input.

use maud::{Markup, html};

use super::figures::{count, decimal, plain, row};
use crate::session::{Report, StageTime};

pub(super) fn section(report: &Report) -> Markup {
    html! {
        section id="run" {
            h2 { "Run" }
            table { tbody {
                @if !report.device.is_empty() {
                    (row("Computed on", html! { (plain(&report.device)) }))
                }
                @if report.total_ms > 0.0 {
                    (row("Time", html! { (decimal(report.total_ms, 0)) " ms" }))
                }
                (row("Largest resident memory", html! { (decimal(report.peak_memory_mb, 0)) " MB" }))
                @if let Some(f) = &report.frames {
                    (row("Frames", html! {
                        (count(f.count)) " of " (count(f.width)) " × " (count(f.height)) " on " (plain(&f.device))
                    }))
                    (row("A frame", html! {
                        (decimal(f.p50_ms, 1)) " ms median, " (decimal(f.p99_ms, 1)) " ms for 99 %; "
                        (count(f.triangles_p50)) " triangles"
                    }))
                    (row("Least distance of the near plane to the wall", html! {
                        (decimal(f.min_near_clearance_mm, 2)) " mm"
                    }))
                }
            } }
            @if !report.stages.is_empty() {
                h3 { "Stages" }
                div class="wide" { (stages(&report.stages)) }
            }
        }
    }
}

/// Stages in the order of their starts, each with a bar from its start to its end.
fn stages(stages: &[StageTime]) -> Markup {
    let mut sorted: Vec<&StageTime> = stages.iter().collect();
    sorted.sort_by(|a, b| a.start_ms.total_cmp(&b.start_ms));
    let end = stages.iter().map(|s| s.start_ms + s.ms).fold(1e-3, f64::max);
    let bar = |s: &StageTime| {
        format!("left:{:.2}%;width:{:.2}%", 100.0 * s.start_ms / end, 100.0 * s.ms / end)
    };
    html! { table {
        thead { tr {
            th { "Stage" }
            th { "Device" }
            th class="n" { "ms" }
            th class="n" { "Work" }
            th { "" }
        } }
        tbody { @for s in sorted {
            tr {
                th scope="row" { (s.name) }
                td { (plain(&s.device)) }
                td class="n" { (decimal(s.ms, 0)) }
                td class="n" { (count(s.items)) " " (s.unit) }
                td { div class="bar" { i style=(bar(s)) {} } }
            }
        } }
    } }
}
