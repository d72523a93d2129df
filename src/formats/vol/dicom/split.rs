//! Series that hold more than one stack: told apart by orientation and size, and by what was varied
//! where slices share their places or lie unevenly among each other.

use std::collections::BTreeMap;

use glam::DVec3;

use super::head::Head;
use super::stack::{MAX_TURNED, MAX_UNEVEN};

/// Elements that number the stacks of a series, in the order in which they are asked: acquisition,
/// echo, time, trigger.
const NUMBERS: [(u16, u16); 4] =
    [(0x0020, 0x0012), (0x0018, 0x0086), (0x0020, 0x0100), (0x0018, 0x1060)];
/// Slices nearer to each other than this share a place, mm.
const SAME_MM: f64 = 1e-3;
/// The largest part by a number has at least one in so many of the places.
const MIN_SHARE: usize = 8;

/// The stacks of a series, in the order of their first slices.
pub(super) fn stacks(heads: Vec<Head>) -> Vec<Vec<Head>> {
    let mut parts = by_orientation(heads);
    for tag in NUMBERS {
        // Thousandths: a trigger time may be a fraction of a millisecond.
        let number = |h: &Head| {
            let text = h.text(tag.0, tag.1);
            let number: f64 = text.split('\\').next()?.trim().parse().ok()?;
            Some((number * 1000.0).round() as i64)
        };
        parts = parts
            .into_iter()
            .flat_map(|part| match shares_places(&part) || interleaves(&part, number) {
                true => split(part, number),
                false => vec![part],
            })
            .collect();
    }
    parts
}

/// Parts of one size and orientation, as near as slices of one stack may be to each other.
fn by_orientation(heads: Vec<Head>) -> Vec<Vec<Head>> {
    let mut parts: Vec<(Option<[f64; 6]>, Vec<Head>)> = Vec::new();
    for head in heads {
        let own = way(&head);
        let part = parts.iter_mut().find(|(way, part)| {
            let is_near = match (way, own) {
                (Some(a), Some(b)) => turned(*a, b) <= MAX_TURNED,
                (None, None) => true,
                _ => false,
            };
            is_near && (part[0].rows, part[0].columns) == (head.rows, head.columns)
        });
        match part {
            Some((_, part)) => part.push(head),
            None => parts.push((own, vec![head])),
        }
    }
    parts.into_iter().map(|(_, part)| part).collect()
}

/// Distance between the axes of two orientations.
fn turned(a: [f64; 6], b: [f64; 6]) -> f64 {
    let axis = |v: [f64; 6], k: usize| DVec3::new(v[k], v[k + 1], v[k + 2]);
    axis(a, 0).distance(axis(b, 0)) + axis(a, 3).distance(axis(b, 3))
}

/// Parts by number. A number that is another for nearly every slice tells no stacks apart: where a
/// slice is there twice, the series stays whole.
fn split(heads: Vec<Head>, number: impl Fn(&Head) -> Option<i64>) -> Vec<Vec<Head>> {
    let mut counts = BTreeMap::<Option<i64>, usize>::new();
    heads.iter().for_each(|h| *counts.entry(number(h)).or_default() += 1);
    let largest = counts.values().copied().max().unwrap_or(0);
    if largest * MIN_SHARE < distinct_places(&heads) {
        return vec![heads];
    }
    let mut parts: BTreeMap<Option<i64>, usize> = BTreeMap::new();
    let mut out: Vec<Vec<Head>> = Vec::new();
    for head in heads {
        let at = *parts.entry(number(&head)).or_insert(out.len());
        match out.get_mut(at) {
            Some(part) => part.push(head),
            None => out.push(vec![head]),
        }
    }
    out
}

/// Orientation as six numbers; what cannot be read is judged later.
fn way(h: &Head) -> Option<[f64; 6]> {
    h.decimals(0x0020, 0x0037, "ImageOrientationPatient").ok().flatten()
}

/// The place of a slice along its normal, mm.
fn place(h: &Head) -> Option<f64> {
    let v = way(h)?;
    let [x, y, z]: [f64; 3] = h.decimals(0x0020, 0x0032, "ImagePositionPatient").ok().flatten()?;
    let normal = DVec3::new(v[0], v[1], v[2]).cross(DVec3::new(v[3], v[4], v[5]));
    Some(normal.dot(DVec3::new(x, y, z)))
}

/// Whether slices lie at the same places along their normal.
fn shares_places(heads: &[Head]) -> bool {
    distinct_places(heads) < heads.iter().filter_map(place).count()
}

/// Number of different places along the normal.
fn distinct_places(heads: &[Head]) -> usize {
    let mut places: Vec<f64> = heads.iter().filter_map(place).collect();
    places.sort_by(f64::total_cmp);
    places.dedup_by(|b, a| *b - *a < SAME_MM);
    places.len()
}

/// Whether slices lie unevenly, and those of one number begin before those of another end. A stack
/// that was taken in several passes lies evenly; parts with a gap between them do not interleave.
fn interleaves(heads: &[Head], number: impl Fn(&Head) -> Option<i64>) -> bool {
    let mut runs = BTreeMap::<Option<i64>, [f64; 2]>::new();
    let mut places = Vec::with_capacity(heads.len());
    for h in heads {
        let Some(place) = place(h) else { return false };
        let [first, last] = runs.entry(number(h)).or_insert([place; 2]);
        (*first, *last) = (first.min(place), last.max(place));
        places.push(place);
    }
    places.sort_by(f64::total_cmp);
    let mut steps: Vec<f64> = places.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    let Some(usual) = steps.get(steps.len() / 2) else { return false };
    let is_even = steps.iter().all(|s| (s - usual).abs() <= MAX_UNEVEN * usual);
    let mut runs: Vec<[f64; 2]> = runs.into_values().collect();
    runs.sort_by(|a, b| a[0].total_cmp(&b[0]));
    // Of the runs before one, the farthest end.
    let mut end = f64::NEG_INFINITY;
    !is_even
        && runs.iter().any(|run| {
            let overlaps = end > run[0];
            end = end.max(run[1]);
            overlaps
        })
}
