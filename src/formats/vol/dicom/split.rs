//! Series that hold more than one stack: told apart by orientation and size, and by what was varied
//! where slices share their places or lie unevenly among each other.

use std::collections::BTreeMap;

use glam::DVec3;

use super::head::Head;
use super::stack::MAX_UNEVEN;

/// Elements that number the stacks of a series, in the order in which they are asked: acquisition,
/// echo, time, trigger.
const NUMBERS: [(u16, u16); 4] =
    [(0x0020, 0x0012), (0x0018, 0x0086), (0x0020, 0x0100), (0x0018, 0x1060)];
/// Slices nearer to each other than this share a place, mm.
const SAME_MM: f64 = 1e-3;

/// The stacks of a series, in the order of their first slices.
pub(super) fn stacks(heads: Vec<Head>) -> Vec<Vec<Head>> {
    let mut parts = split(heads, |h| {
        let way = way(h).map(|v| v.map(|x| (x * 1000.0).round() as i64));
        (h.rows, h.columns, way)
    });
    for tag in NUMBERS {
        let number = |h: &Head| h.int(tag.0, tag.1);
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

fn split<K: Ord>(heads: Vec<Head>, key: impl Fn(&Head) -> K) -> Vec<Vec<Head>> {
    let mut parts: BTreeMap<K, usize> = BTreeMap::new();
    let mut out: Vec<Vec<Head>> = Vec::new();
    for head in heads {
        let at = *parts.entry(key(&head)).or_insert(out.len());
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
    let mut places: Vec<f64> = heads.iter().filter_map(place).collect();
    places.sort_by(f64::total_cmp);
    places.windows(2).any(|w| w[1] - w[0] < SAME_MM)
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
