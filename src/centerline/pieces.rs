//! The order in which the pieces of a lumen follow each other.

use glam::DVec3;

/// Largest number of pieces whose best order is found; more are joined one after another, nearest
/// first.
const MAX_EXACT: usize = 12;

/// A piece between two ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathPiece {
    /// Ends of the piece, mm.
    pub ends: [DVec3; 2],
    /// Unit vectors out of the piece at its ends; zero where there is none.
    pub outward: [DVec3; 2],
}

impl PathPiece {
    /// Cost of going on from this piece (flown backwards if `from`) to another: the gap, up to twice
    /// as much where it is left or met at an angle. In µm, so that sums are exact.
    fn cost(&self, from: usize, other: &Self, to: usize) -> u64 {
        // Flown forwards, a piece is left at its second end and entered at its first.
        let (leave, enter) = (1 - from, to);
        let way = other.ends[enter] - self.ends[leave];
        let along = way.normalize_or_zero();
        let out = 1.0 - self.outward[leave].dot(along);
        let into = 1.0 - other.outward[enter].dot(-along);
        (1000.0 * way.length() * (1.0 + 0.5 * out + 0.5 * into)).round() as u64
    }
}

/// Order of pieces and whether each is flown backwards, so that the gaps cost least together (Held &
/// Karp 1962, doi:10.1137/0110015); of equal orders the first by number.
pub(super) fn order(pieces: &[PathPiece]) -> Vec<(usize, bool)> {
    if pieces.len() > MAX_EXACT {
        return one_after_another(pieces);
    }
    let n = pieces.len();
    // Least cost over a set of pieces that ends with one in a direction, and the one before.
    let mut best = vec![[(u64::MAX, usize::MAX, 0); 2]; n << n];
    for last in 0..n {
        best[last + n * (1 << last)] = [(0, usize::MAX, 0); 2];
    }
    for set in 1..1usize << n {
        for last in (0..n).filter(|i| set >> i & 1 != 0) {
            for way in 0..2 {
                let here = best[last + n * set][way].0;
                if here == u64::MAX {
                    continue;
                }
                for next in (0..n).filter(|i| set >> i & 1 == 0) {
                    let entries = &mut best[next + n * (set | 1 << next)];
                    for (to, entry) in entries.iter_mut().enumerate() {
                        let cost = here + pieces[last].cost(way, &pieces[next], to);
                        *entry = (*entry).min((cost, last, way));
                    }
                }
            }
        }
    }
    let all = (1 << n) - 1;
    let ends = (0..n).flat_map(|last| [(last, 0), (last, 1)]);
    let least = ends.min_by_key(|(last, way)| (best[last + n * all][*way].0, *last, *way));
    let mut out = Vec::new();
    let (mut set, mut at) = (all, least);
    while let Some((last, way)) = at {
        out.push((last, way == 1));
        let (_, before, way) = best[last + n * set][way];
        set &= !(1 << last);
        at = (before != usize::MAX).then_some((before, way));
    }
    out.reverse();
    out
}

/// The first piece, then always the one that costs least to go on to, at either end.
fn one_after_another(pieces: &[PathPiece]) -> Vec<(usize, bool)> {
    let mut left: Vec<usize> = (1..pieces.len()).collect();
    let mut out = std::collections::VecDeque::from([(0, 0usize)]);
    while !left.is_empty() {
        let (&(first, f), &(last, l)) = (&out[0], &out[out.len() - 1]);
        let ways = left.iter().flat_map(|next| [(*next, 0), (*next, 1)]);
        let joins = ways.flat_map(|(next, way)| {
            let after = pieces[last].cost(l, &pieces[next], way);
            let before = pieces[next].cost(way, &pieces[first], f);
            [(after, false, next, way), (before, true, next, way)]
        });
        let Some((_, before, next, way)) = joins.min() else { break };
        if before {
            out.push_front((next, way))
        } else {
            out.push_back((next, way))
        }
        left.retain(|i| *i != next);
    }
    out.into_iter().map(|(i, way)| (i, way == 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A winding curve cut into pieces with gaps, each third one turned round.
    fn cut(count: usize, gap: f64) -> (Vec<PathPiece>, Vec<bool>) {
        let at = |s: f64| DVec3::new(80.0 * (0.02 * s).sin(), 0.9 * s, 60.0 * (0.013 * s).cos());
        let (mut pieces, mut turned) = (Vec::new(), Vec::new());
        let mut s = 0.0;
        for i in 0..count {
            let (a, b) = (s, s + 60.0 + 17.0 * (i % 4) as f64);
            let ends = [at(a), at(b)];
            let outward = [at(a) - at(a + 5.0), at(b) - at(b - 5.0)].map(DVec3::normalize);
            let turn = i % 3 == 1;
            let swap = |p: [DVec3; 2]| if turn { [p[1], p[0]] } else { p };
            pieces.push(PathPiece { ends: swap(ends), outward: swap(outward) });
            turned.push(turn);
            s = b + gap;
        }
        (pieces, turned)
    }

    #[test]
    fn shuffled_pieces_of_a_curve_are_put_in_order() {
        for count in [1, 2, 4, 7, 14] {
            for gap in [5.0, 20.0, 40.0] {
                let (pieces, turned) = cut(count, gap);
                // Seven has no factor in common with any count but itself.
                let step = if count == 7 { 3 } else { 5 };
                let places: Vec<usize> = (0..count).map(|i| i * step % count).collect();
                let shuffled: Vec<PathPiece> = places.iter().map(|i| pieces[*i]).collect();
                let found = order(&shuffled);
                let mut names: Vec<usize> = found.iter().map(|(i, _)| places[*i]).collect();
                let mut ways: Vec<bool> =
                    found.iter().map(|(i, back)| *back != turned[places[*i]]).collect();
                if names[0] > names[names.len() - 1] {
                    names.reverse();
                    ways.iter_mut().for_each(|w| *w = !*w);
                }
                assert_eq!(names, (0..count).collect::<Vec<_>>(), "{count} pieces, {gap} mm");
                // One piece alone has no direction.
                assert!(count == 1 || ways.iter().all(|w| !w), "{count} pieces, {gap} mm");
            }
        }
    }
}
