//! Curves along the path, as SVG.

use std::fmt::Write as _;

use maud::{Markup, html};

use super::figures::grouped;
use super::overview::{MARKED, letter};
use crate::flight::LumenProfile;
use crate::session::PatchReport;

/// Size of a chart in its own units; text has 11 or 12 of them.
const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 190.0;
/// Places of the axes.
const ACROSS: [f64; 2] = [52.0, WIDTH - 14.0];
const UP: [f64; 2] = [HEIGHT - 40.0, 30.0];

/// Values from zero on along an axis, with its ticks.
struct Axis {
    end: f64,
    step: f64,
    digits: usize,
    /// Places of zero and of the end in the chart.
    span: [f64; 2],
}

impl Axis {
    /// An axis for values up to `most`, with at most so many steps of 1, 2 or 5.
    fn new(most: f64, span: [f64; 2], steps: f64) -> Self {
        let most = if most.is_finite() && most > 0.0 { most } else { 1.0 };
        let least = most / steps;
        let power = 10f64.powf(least.log10().floor());
        let wide_enough = |s: &f64| *s >= 0.999 * least;
        let step = [1.0, 2.0, 5.0].map(|s| s * power).into_iter().find(wide_enough);
        let step = step.unwrap_or(10.0 * power);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        Self { end: most, step, digits, span }
    }

    /// Extends the axis to a tick.
    fn ending_at_tick(self) -> Self {
        Self { end: (self.end / self.step - 1e-9).ceil() * self.step, ..self }
    }

    fn at(&self, value: f64) -> f64 {
        let [from, to] = self.span;
        ((from + (to - from) * value / self.end) * 10.0).round() / 10.0
    }

    fn ticks(&self) -> impl Iterator<Item = f64> {
        (0..=(self.end / self.step + 1e-9) as usize).map(|k| k as f64 * self.step)
    }
}

/// Values along the path.
struct Curve<'a> {
    /// Quantity and unit.
    title: &'a str,
    class: &'a str,
    values: Vec<Option<f64>>,
    /// Values at the narrowest places.
    narrow: Vec<Option<f64>>,
}

/// Charts of radius and area, with the narrowest places and, along the axis, the missed patches.
pub(super) fn charts(profile: &LumenProfile, patches: &[PatchReport]) -> Markup {
    let radius = Curve {
        title: "Radius, mm",
        class: "radius",
        values: profile.radius_mm.iter().map(|r| Some(*r)).collect(),
        narrow: profile.narrowest.iter().map(|n| Some(n.radius_mm)).collect(),
    };
    let area = Curve {
        title: "Area of the section, mm²",
        class: "area",
        values: profile.area_mm2.clone(),
        narrow: profile.narrowest.iter().map(|n| n.area_mm2).collect(),
    };
    html! {
        div class="wide" { (chart(profile, &radius, patches)) }
        div class="wide" { (chart(profile, &area, patches)) }
    }
}

fn chart(profile: &LumenProfile, curve: &Curve<'_>, patches: &[PatchReport]) -> Markup {
    let most = curve.values.iter().flatten().fold(0.0, |a: f64, b| a.max(*b));
    let x = Axis::new(profile.length_mm(), ACROSS, 10.0);
    let y = Axis::new(1.02 * most, UP, 4.0).ending_at_tick();
    let [left, right] = ACROSS;
    let [bottom, top] = UP;
    let narrow = profile.narrowest.iter().zip(&curve.narrow).enumerate();
    let narrow =
        narrow.filter_map(|(i, (n, value))| Some((letter(i), x.at(n.arc_mm), y.at((*value)?))));
    html! {
        svg class="chart" viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(curve.title) {
            text class="title" x=(left) y="14" { (curve.title) }
            @for v in y.ticks() {
                line class="grid" x1=(left) y1=(y.at(v)) x2=(right) y2=(y.at(v)) {}
                text x=(left - 6.0) y=(y.at(v) + 4.0) text-anchor="end" { (grouped(v, y.digits)) }
            }
            @for v in x.ticks() {
                line class="axis" x1=(x.at(v)) y1=(bottom) x2=(x.at(v)) y2=(bottom + 4.0) {}
                text x=(x.at(v)) y=(bottom + 16.0) text-anchor="middle" { (grouped(v, x.digits)) }
            }
            line class="axis" x1=(left) y1=(bottom) x2=(right) y2=(bottom) {}
            text x=(right) y=(HEIGHT - 6.0) text-anchor="end" { "mm along the path" }
            @for cut in profile.cuts.iter().filter_map(|i| profile.arc_mm.get(*i)) {
                line class="cut" x1=(x.at(*cut)) y1=(top) x2=(x.at(*cut)) y2=(bottom) {}
            }
            @for patch in patches.iter().take(MARKED).filter(|p| p.arc_mm <= profile.length_mm()) {
                circle class="patch" cx=(x.at(patch.arc_mm)) cy=(bottom) r="2.5" {}
            }
            path class=(curve.class) d=(line(profile, &curve.values, &x, &y)) {}
            @for (letter, x, y) in narrow {
                line class="axis" x1=(x) y1=(y) x2=(x) y2=(y - 12.0) {}
                text class="letter" x=(x) y=(y - 15.0) text-anchor="middle" { (letter) }
            }
        }
    }
}

/// Lines through the values; a new one where there is none and where another piece begins.
fn line(profile: &LumenProfile, values: &[Option<f64>], x: &Axis, y: &Axis) -> String {
    let mut d = String::new();
    let mut is_drawn = false;
    for (i, (arc, value)) in profile.arc_mm.iter().zip(values).enumerate() {
        let Some(value) = value else {
            is_drawn = false;
            continue;
        };
        let letter = if is_drawn && !profile.cuts.contains(&i) { 'L' } else { 'M' };
        let _ = write!(d, "{letter}{} {}", x.at(*arc), y.at(*value));
        is_drawn = true;
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few_and_reach_the_largest_value() {
        for (most, steps, wanted, step) in
            [(7.3, 4.0, 8.0, 2.0), (1543.0, 10.0, 1600.0, 200.0), (0.031, 4.0, 0.04, 0.01)]
        {
            let axis = Axis::new(most, [0.0, 100.0], steps).ending_at_tick();
            assert!((axis.end - wanted).abs() < 1e-9 && (axis.step - step).abs() < 1e-9);
            assert!(axis.ticks().count() as f64 <= steps + 1.0);
            assert_eq!((axis.at(0.0), axis.at(axis.end)), (0.0, 100.0));
        }
        assert_eq!(Axis::new(0.031, [0.0, 1.0], 4.0).digits, 2);
        assert_eq!(Axis::new(0.0, [0.0, 1.0], 4.0).end, 1.0, "of nothing");
    }

    #[test]
    fn a_curve_breaks_where_there_is_no_value_and_at_another_piece() {
        let profile = LumenProfile {
            arc_mm: vec![0.0, 1.0, 2.0, 3.0, 3.0, 4.0],
            cuts: vec![4],
            ..LumenProfile::default()
        };
        let (x, y) = (Axis::new(4.0, [0.0, 4.0], 4.0), Axis::new(1.0, [0.0, 1.0], 1.0));
        let values = [Some(1.0), Some(1.0), None, Some(1.0), Some(1.0), Some(0.0)];
        assert_eq!(line(&profile, &values, &x, &y), "M0 1L1 1M3 1M3 1L4 0");
    }
}
