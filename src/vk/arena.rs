//! Places of a plan's buffers: few blocks of memory, shared by buffers whose lifetimes do not meet.
//!
//! A lifetime is a range of launches. What the host writes lives from the start of the plan, what it
//! reads to the end. Large buffers are placed first, each at the lowest place that is free during its
//! whole lifetime (greedy by size: Pisarchyk & Lee 2020, arXiv:2001.03288).

use std::ops::RangeInclusive;

use crate::compute::{Contents, Plan};

/// Launches during which a buffer holds something: from the first, or 0 for what the host writes, to
/// the last, or `usize::MAX` for what it reads back.
type Lifetime = RangeInclusive<usize>;

/// Place of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Index of the block.
    pub block: usize,
    /// First byte in it.
    pub offset: u64,
}

/// Places of all buffers of a plan.
#[derive(Debug, Default)]
pub(super) struct ArenaLayout {
    /// Place of each buffer; `None` where it has no size.
    pub places: Vec<Option<Place>>,
    /// Buffers that share bytes with each buffer.
    pub aliases: Vec<Vec<u32>>,
    /// Size of each block, bytes.
    pub blocks: Vec<u64>,
    /// Largest number of bytes in use at once: no layout takes less.
    pub least_bytes: u64,
}

impl ArenaLayout {
    /// Places the buffers of a plan.
    ///
    /// * `sizes`: bytes that each buffer takes, 0 for one that is not placed.
    /// * `alignment`: of offsets, bytes.
    /// * `block_bytes`: most bytes of a block, but for one buffer that is larger.
    pub fn new(plan: &Plan<'_>, sizes: &[u64], alignment: u64, block_bytes: u64) -> Self {
        let lifetimes = lifetimes(plan);
        let sizes: Vec<u64> = sizes.iter().map(|s| s.next_multiple_of(alignment.max(1))).collect();
        let mut largest_first: Vec<usize> = (0..sizes.len()).filter(|b| sizes[*b] > 0).collect();
        largest_first.sort_by_key(|b| std::cmp::Reverse(sizes[*b]));
        let meet = |a: usize, b: usize| match (&lifetimes[a], &lifetimes[b]) {
            (Some(a), Some(b)) => a.start() <= b.end() && b.start() <= a.end(),
            _ => true,
        };
        let mut this = Self {
            places: vec![None; sizes.len()],
            aliases: vec![Vec::new(); sizes.len()],
            blocks: Vec::new(),
            least_bytes: least_bytes(&lifetimes, &sizes, plan.steps().len()),
        };
        for (at, &buffer) in largest_first.iter().enumerate() {
            let placed = &largest_first[..at];
            let taken = |block: usize| {
                let here = placed.iter().filter(|p| meet(**p, buffer));
                let here = here.filter_map(|p| this.places[*p].map(|place| (place, sizes[*p])));
                let mut taken: Vec<(u64, u64)> = here
                    .filter(|(place, _)| place.block == block)
                    .map(|(place, bytes)| (place.offset, place.offset + bytes))
                    .collect();
                taken.sort_unstable();
                taken
            };
            let fits = |block: &usize| {
                let offset = first_gap(&taken(*block), sizes[buffer]);
                (offset + sizes[buffer] <= block_bytes).then_some((*block, offset))
            };
            let found = (0..this.blocks.len()).find_map(|b| fits(&b));
            let (block, offset) = found.unwrap_or((this.blocks.len(), 0));
            if block == this.blocks.len() {
                this.blocks.push(0);
            }
            this.blocks[block] = this.blocks[block].max(offset + sizes[buffer]);
            let end = offset + sizes[buffer];
            for &other in placed {
                let Some(place) = this.places[other].filter(|p| p.block == block) else { continue };
                if place.offset < end && offset < place.offset + sizes[other] {
                    this.aliases[buffer].push(other as u32);
                    this.aliases[other].push(buffer as u32);
                }
            }
            this.places[buffer] = Some(Place { block, offset });
        }
        this
    }
}

/// Whether a launch that has threads binds each buffer.
pub(super) fn bound(plan: &Plan<'_>) -> Vec<bool> {
    lifetimes(plan).iter().map(Option::is_some).collect()
}

/// Lowest place where `bytes` fit between ranges, which are in ascending order of their starts.
fn first_gap(taken: &[(u64, u64)], bytes: u64) -> u64 {
    let mut at = 0;
    for &(start, end) in taken {
        if start >= at + bytes {
            break;
        }
        at = at.max(end);
    }
    at
}

/// Lifetime of each buffer; `None` where no launch that has threads binds it.
fn lifetimes(plan: &Plan<'_>) -> Vec<Option<Lifetime>> {
    let mut of: Vec<Option<Lifetime>> = vec![None; plan.buffers().len()];
    let launches = plan.steps().iter().enumerate().filter(|(_, launch)| launch.threads > 0);
    for (step, launch) in launches {
        for id in &launch.buffers {
            let own = &mut of[id.0 as usize];
            *own = Some(own.as_ref().map_or(step, |l| *l.start())..=step);
        }
    }
    for (own, buffer) in of.iter_mut().zip(plan.buffers()) {
        if let (Some(l), Contents::Borrowed(_) | Contents::Owned(_)) = (&own, &buffer.contents) {
            *own = Some(0..=*l.end());
        }
    }
    for id in plan.downloads() {
        let own = &mut of[id.0 as usize];
        *own = own.as_ref().map(|l| *l.start()..=usize::MAX);
    }
    of
}

/// Largest sum of the sizes of buffers that live during one launch, bytes.
fn least_bytes(lifetimes: &[Option<Lifetime>], sizes: &[u64], steps: usize) -> u64 {
    let during = |step: usize| {
        let live = lifetimes.iter().zip(sizes);
        live.filter(|(l, _)| l.as_ref().is_some_and(|l| l.contains(&step))).map(|(_, b)| b).sum()
    };
    (0..=steps).map(during).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::Buf;
    use crate::kernels::copy;

    /// A chain of copies, each of the one before; the last is read back.
    fn chain(copies: usize, quads: usize) -> Plan<'static> {
        let mut plan = Plan::new();
        let mut from: Buf<[u32; 4]> = plan.upload_owned("source", &vec![[1u32; 4]; quads]);
        for _ in 0..copies {
            let to = plan.undefined("copied", quads);
            let bindings = copy::Bindings { source: from, copied: to };
            let params = copy::Params { quads: quads as u32 };
            plan.launch(&copy::KERNEL, bindings, params, quads, quads);
            from = to;
        }
        plan.download(from);
        plan
    }

    fn sizes(plan: &Plan<'_>) -> Vec<u64> {
        plan.buffers().iter().map(|b| b.bytes as u64).collect()
    }

    #[test]
    fn a_chain_of_copies_takes_the_memory_of_two_buffers() {
        let plan = chain(9, 64);
        let layout = ArenaLayout::new(&plan, &sizes(&plan), 256, u64::MAX);
        assert_eq!(layout.blocks, [2 * 1024]);
        assert_eq!(layout.least_bytes, 2 * 1024);
        // Every other copy has the place of the source.
        assert!(layout.aliases.iter().all(|a| a.len() == 4));
    }

    #[test]
    fn buffers_that_live_at_the_same_time_never_share_bytes() {
        let mut seed = 9u64;
        let mut random = |below: u64| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 33) % below
        };
        for round in 0..60 {
            let mut plan = Plan::new();
            let first = plan.upload_owned("first", &[[0u32; 4]; 1]);
            let mut all: Vec<Buf<[u32; 4]>> = vec![first];
            for _ in 0..30 {
                let quads = 1 + random(40) as usize;
                let to = plan.undefined("copied", quads);
                let source = all[random(all.len() as u64) as usize];
                let bindings = copy::Bindings { source, copied: to };
                let params = copy::Params { quads: 1 };
                plan.launch(&copy::KERNEL, bindings, params, 1, 1);
                all.push(to);
            }
            plan.download(all[random(31) as usize]);
            let block_bytes = if round % 2 == 0 { u64::MAX } else { 1500 };
            let layout = ArenaLayout::new(&plan, &sizes(&plan), 16, block_bytes);
            let lifetimes = lifetimes(&plan);
            let size = |b: usize| plan.buffers()[b].bytes as u64;
            let mut shared = 0;
            for a in 0..all.len() {
                let (Some(p), Some(l)) = (layout.places[a], &lifetimes[a]) else { continue };
                assert!(p.offset + size(a) <= layout.blocks[p.block] && p.offset % 16 == 0);
                for (b, m) in lifetimes[..a].iter().enumerate() {
                    let (Some(q), Some(m)) = (layout.places[b], m) else { continue };
                    let overlap = p.block == q.block
                        && p.offset < q.offset + size(b)
                        && q.offset < p.offset + size(a);
                    let meet = l.start() <= m.end() && m.start() <= l.end();
                    assert!(!(overlap && meet), "{a} and {b}");
                    assert_eq!(overlap, layout.aliases[a].contains(&(b as u32)), "{a} and {b}");
                    shared += u32::from(overlap);
                }
            }
            let all: u64 = layout.blocks.iter().sum();
            assert!(all >= layout.least_bytes && shared > 0);
            assert!(round % 2 == 0 || layout.blocks.iter().all(|b| *b <= 1500));
        }
    }

    #[test]
    fn gaps_are_filled_from_the_lowest() {
        assert_eq!(first_gap(&[], 8), 0);
        assert_eq!(first_gap(&[(0, 4), (8, 12)], 4), 4);
        assert_eq!(first_gap(&[(0, 4), (8, 12)], 5), 12);
        assert_eq!(first_gap(&[(0, 20), (4, 8), (24, 30)], 4), 20);
    }
}
