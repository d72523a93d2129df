//! Places of the panes in the window.

use egui::{Pos2, Rect, Vec2, pos2, vec2};

use super::action::{Pane, PaneLayout};

/// Gap between panes, points.
const GAP: f32 = 2.0;
/// Height of a row of controls under a pane, points.
const ROW: f32 = 26.0;
/// Width of the controls of the flight, and of a slice, in one row, points.
const TRANSPORT: f32 = 510.0;
const PRESETS: f32 = 620.0;
/// Width of the controls of a slice with the names of the planes, points.
const PRESETS_OF_PAIR: f32 = 900.0;
/// Most rows.
const MAX_ROWS: f32 = 4.0;
/// Least width of two columns; the inside view alone has less.
const TWO_COLUMNS: f32 = 420.0;
/// Least height of a pane above controls, points.
const MIN_HEIGHT: f32 = 100.0;
/// Share of the width that the inside view takes.
const INSIDE: f32 = 0.56;
/// Share of the slices' height that the row of small ones takes.
const FILMSTRIP: f32 = 0.24;
/// Side of the overview in a corner of the inside view, as a share of that, and at most, points.
const INSET: (f32, f32) = (0.34, 220.0);

/// Where panes and their controls are. A pane later in the list lies over one before.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Places {
    /// Panes that are shown.
    pub panes: Vec<(Pane, Rect)>,
    /// Row of controls under the inside view.
    pub transport: Option<Rect>,
    /// Row of controls under the large slice.
    pub presets: Option<Rect>,
}

/// Returns the places of the panes.
///
/// * `large`: the slice that is shown large.
/// * `maximised`: the pane that fills the window.
pub(super) fn places(
    whole: Rect,
    layout: PaneLayout,
    large: Pane,
    maximised: Option<Pane>,
) -> Places {
    match (maximised, layout) {
        (Some(Pane::Inside), _) => with_transport(whole),
        (Some(Pane::Overview), _) => {
            Places { panes: vec![(Pane::Overview, whole)], ..Places::default() }
        }
        (Some(slice), _) => with_presets(whole, slice, PRESETS),
        (None, PaneLayout::Reading) => {
            let [left, right] = columns(whole);
            let is_wide = whole.width() >= TWO_COLUMNS;
            let all = with_inset(if is_wide { left } else { whole });
            if !is_wide {
                return all;
            }
            let slices = large_slice(right, large);
            Places { panes: [all.panes, slices.panes].concat(), presets: slices.presets, ..all }
        }
        (None, PaneLayout::Slices) => large_slice(whole, large),
        (None, PaneLayout::All) => {
            let [left, right] = columns(whole);
            let all = with_transport(left);
            Places { panes: [all.panes, grid_of_slices(right)].concat(), ..all }
        }
    }
}

/// One of two cases that are shown beside each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Half {
    /// All of it.
    pub whole: Rect,
    /// Row of its name and of what both share.
    pub controls: Rect,
    /// Its scrub bar.
    pub scrub: Rect,
}

/// Height of the scrub bar of one of two cases, points.
const SCRUB: f32 = 52.0;
/// Share of the height of one of two cases that the inside view takes.
const INSIDE_OF_PAIR: f32 = 0.56;

/// Divides the window between two cases.
pub(super) fn halves(whole: Rect) -> [Half; 2] {
    let middle = whole.center().x.round();
    let left = Rect::from_min_max(whole.min, pos2(middle - GAP, whole.max.y));
    let right = Rect::from_min_max(pos2(middle, whole.min.y), whole.max);
    [left, right].map(|whole| {
        let below_name = (whole.min.y + ROW).min(whole.max.y);
        let above_scrub = (whole.max.y - SCRUB).max(below_name);
        let controls = Rect::from_min_max(whole.min, pos2(whole.max.x, below_name));
        let scrub = Rect::from_min_max(pos2(whole.min.x, above_scrub), whole.max);
        Half { whole, controls, scrub }
    })
}

impl Half {
    /// Places of the panes: the inside view with the overview in its corner above a slice.
    pub fn places(&self, large: Pane, maximised: Option<Pane>) -> Places {
        let panes = Rect::from_min_max(self.controls.left_bottom(), self.scrub.right_top());
        if maximised.is_some() {
            return places(panes, PaneLayout::Reading, large, maximised);
        }
        let edge = panes.min.y + (INSIDE_OF_PAIR * panes.height()).round();
        let upper = Rect::from_min_max(panes.min, pos2(panes.max.x, edge - GAP));
        let lower = Rect::from_min_max(pos2(panes.min.x, edge), panes.max);
        let (mut all, slice) = (with_inset(upper), with_presets(lower, large, PRESETS_OF_PAIR));
        all.panes.extend(slice.panes);
        Places { presets: slice.presets, ..all }
    }
}

/// The inside view with the overview in its corner and its controls below.
fn with_inset(place: Rect) -> Places {
    let mut all = with_transport(place);
    all.panes.push((Pane::Overview, inset(all.panes[0].1)));
    all
}

/// The place of the overview in the corner of the inside view.
pub(super) fn inset(inside: Rect) -> Rect {
    let side = (INSET.0 * inside.width().min(inside.height())).min(INSET.1).round();
    let corner = inside.right_top() + vec2(-side - 6.0, 6.0);
    Rect::from_min_size(corner, Vec2::splat(side))
}

fn columns(whole: Rect) -> [Rect; 2] {
    let split = whole.min.x + (INSIDE * whole.width()).round();
    let left = Rect::from_min_max(whole.min, pos2(split - GAP, whole.max.y));
    [left, Rect::from_min_max(pos2(split, whole.min.y), whole.max)]
}

/// The inside view with its controls below.
fn with_transport(place: Rect) -> Places {
    let (inside, controls) = above_controls(place, TRANSPORT);
    Places { panes: vec![(Pane::Inside, inside)], transport: controls, presets: None }
}

/// A slice with its controls below, which take so much width in one row.
fn with_presets(place: Rect, slice: Pane, width: f32) -> Places {
    let (slice_place, controls) = above_controls(place, width);
    Places { panes: vec![(slice, slice_place)], transport: None, presets: controls }
}

/// A pane above controls that take so much width in one row.
fn above_controls(place: Rect, width: f32) -> (Rect, Option<Rect>) {
    let rows = (width / place.width().max(1.0)).ceil().min(MAX_ROWS);
    let edge = place.max.y - rows * ROW;
    if edge < place.min.y + MIN_HEIGHT {
        return (place, None);
    }
    let pane = Rect::from_min_max(place.min, pos2(place.max.x, edge));
    (pane, Some(Rect::from_min_max(pos2(place.min.x, edge), place.max)))
}

/// One slice large, the others in a row below.
fn large_slice(place: Rect, large: Pane) -> Places {
    let strip = (FILMSTRIP * place.height()).round();
    let edge = place.max.y - strip;
    let upper = Rect::from_min_max(place.min, pos2(place.max.x, edge - GAP));
    let mut all = with_presets(upper, large, PRESETS);
    let others: Vec<Pane> = Pane::SLICES.into_iter().filter(|p| *p != large).collect();
    let width = place.width() / others.len() as f32;
    for (i, pane) in others.into_iter().enumerate() {
        let min = Pos2::new(place.min.x + i as f32 * width, edge);
        let size = vec2((width - GAP).max(1.0), strip.max(1.0));
        all.panes.push((pane, Rect::from_min_size(min, size)));
    }
    all
}

/// The overview and the slice across the path above the three others.
fn grid_of_slices(right: Rect) -> Vec<(Pane, Rect)> {
    let part = |col: usize, row: usize| {
        let size = vec2(right.width() / 2.0, right.height() / 3.0);
        let min = right.min + vec2(col as f32 * size.x, row as f32 * size.y);
        Rect::from_min_size(min, (size - Vec2::splat(GAP)).max(Vec2::splat(1.0)))
    };
    vec![
        (Pane::Overview, part(0, 0)),
        (Pane::Across, part(1, 0)),
        (Pane::Axial, part(0, 1)),
        (Pane::Coronal, part(1, 1)),
        (Pane::Sagittal, part(0, 2).union(part(1, 2))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(width: f32, height: f32) -> Rect {
        Rect::from_min_size(pos2(0.0, 30.0), vec2(width, height))
    }

    #[test]
    fn panes_fill_the_window_and_none_but_the_overview_lies_over_another() {
        for (width, height) in [(1044.0, 680.0), (1644.0, 960.0), (400.0, 300.0), (60.0, 40.0)] {
            let whole = window(width, height);
            for layout in [PaneLayout::Reading, PaneLayout::Slices, PaneLayout::All] {
                let of = places(whole, layout, Pane::Axial, None);
                let mut rects: Vec<(Option<Pane>, Rect)> =
                    of.panes.iter().map(|(pane, rect)| (Some(*pane), *rect)).collect();
                rects.extend(of.transport.into_iter().chain(of.presets).map(|r| (None, r)));
                assert!(rects.iter().all(|(_, r)| whole.expand(0.5).contains_rect(*r)));
                rects.retain(|(pane, _)| *pane != Some(Pane::Overview));
                for (i, (_, a)) in rects.iter().enumerate() {
                    for (_, b) in &rects[..i] {
                        let both = a.intersect(*b);
                        assert!(both.width() < 0.5 || both.height() < 0.5, "{a:?} and {b:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn two_cases_have_each_their_half_of_the_window() {
        for (width, height) in [(1044.0, 780.0), (1644.0, 960.0), (400.0, 300.0), (60.0, 40.0)] {
            let whole = window(width, height);
            let halves = halves(whole);
            assert!(halves[0].whole.max.x < halves[1].whole.min.x);
            for half in halves {
                let of = half.places(Pane::Axial, None);
                let own = of.panes.iter().map(|p| p.1).chain(of.transport).chain(of.presets);
                for rect in own.chain([half.controls, half.scrub]) {
                    assert!(half.whole.expand(0.5).contains_rect(rect), "{rect:?} of {half:?}");
                }
                assert_eq!(of.panes.len(), 3);
            }
        }
    }

    #[test]
    fn the_large_slice_of_a_laptop_is_twice_as_wide_as_it_was() {
        let of = places(window(1044.0, 680.0), PaneLayout::Reading, Pane::Coronal, None);
        let large = of.panes.iter().find(|(pane, _)| *pane == Pane::Coronal).unwrap().1;
        assert!(large.width() > 450.0 && large.height() > 450.0, "228 by 228 before: {large:?}");
        assert_eq!(of.panes.len(), 6);
    }
}
