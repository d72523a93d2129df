//! Collapse of the complex onto a graph: a free element (one with a single coface) is removed
//! together with its coface, which keeps the homotopy type. Pairs are removed in order of depth.

use super::CellComplex;
use crate::task::checkpoint;

/// Number of elements between two checks of the cancellation token.
const BETWEEN_CHECKS: u32 = 1 << 16;

/// The collapsed complex: a graph of nodes and contacts.
#[derive(Clone, Debug, PartialEq)]
pub struct Collapsed {
    /// Nodes left, ascending.
    pub nodes: Vec<u32>,
    /// Contacts left, ascending.
    pub contacts: Vec<u32>,
    /// Number of closed shells that had to be opened: each was a cavity, and opening it made no
    /// loop.
    pub shells: usize,
}

/// State of an element during the collapse.
#[derive(Clone, Copy, Default)]
struct ElementState {
    /// Exclusive or of the indices of the remaining cofaces: the index itself when one is left.
    bounds: u32,
    /// Number of remaining cofaces. Contacts of a node share a face of 16 voxels each: below 100.
    count: u8,
    gone: bool,
    /// Whether the element is never removed as the bounding element of a pair.
    anchor: bool,
}

struct Collapsing<'a> {
    complex: &'a CellComplex,
    /// First element of each dimension, and their number.
    first: [u32; 5],
    state: Vec<ElementState>,
    /// Elements with a single remaining coface, by key: each list first in, first out.
    free: Vec<Vec<u32>>,
}

/// Collapses a complex; nodes in `anchors` stay.
pub fn collapse(complex: &CellComplex, anchors: &[u32]) -> Collapsed {
    let mut this = Collapsing::new(complex, anchors);
    let mut shells = 0;
    loop {
        this.run();
        // A shell has no free edge: each of its contacts bounds two runs. Its run nearest to the
        // wall opens it.
        let runs = this.first[2]..this.first[3];
        let left = runs.filter(|e| !this.state[*e as usize].gone);
        let Some(run) = left.min_by_key(|e| (this.key(*e), *e)) else { break };
        this.remove(run, 0);
        shells += 1;
    }
    let left = |dimension: usize| {
        let first = this.first[dimension];
        let all = first..this.first[dimension + 1];
        all.filter(|e| !this.state[*e as usize].gone).map(|e| e - first).collect()
    };
    Collapsed { nodes: left(0), contacts: left(1), shells }
}

impl<'a> Collapsing<'a> {
    fn new(complex: &'a CellComplex, anchors: &[u32]) -> Self {
        let counts = [
            complex.nodes.len(),
            complex.contacts.len(),
            complex.runs.len(),
            complex.corners.len(),
        ];
        let mut first = [0; 5];
        for (k, n) in counts.into_iter().enumerate() {
            first[k + 1] = first[k] + n as u32;
        }
        let deepest = complex.nodes.iter().map(|n| n.key).max().unwrap_or(0);
        let mut this = Self {
            complex,
            first,
            state: vec![ElementState::default(); first[4] as usize],
            free: vec![Vec::new(); deepest as usize + 1],
        };
        anchors.iter().for_each(|n| this.state[*n as usize].anchor = true);
        for e in first[1]..first[4] {
            this.boundary(e, |this, b| {
                let s = &mut this.state[b as usize];
                s.count += 1;
                s.bounds ^= e;
            });
        }
        for e in 0..first[3] {
            this.queue_if_free(e, 0);
        }
        this
    }

    fn key(&self, e: u32) -> u32 {
        let [_, contacts, runs, corners, _] = self.first;
        match e {
            _ if e < contacts => self.complex.nodes[e as usize].key,
            _ if e < runs => self.complex.contacts[(e - contacts) as usize].key,
            _ if e < corners => self.complex.runs[(e - runs) as usize].key,
            _ => self.complex.corners[(e - corners) as usize].key,
        }
    }

    /// Visits the faces of `e`.
    fn boundary(&mut self, e: u32, mut visit: impl FnMut(&mut Self, u32)) {
        let [_, contacts, runs, corners, _] = self.first;
        if e < contacts {
        } else if e < runs {
            let all = self.complex.contacts[(e - contacts) as usize].nodes;
            all.into_iter().for_each(|n| visit(self, n));
        } else if e < corners {
            let all = self.complex.runs[(e - runs) as usize].contacts;
            all.into_iter().for_each(|c| visit(self, contacts + c));
        } else {
            let all = self.complex.corners[(e - corners) as usize].runs;
            all.into_iter().for_each(|r| visit(self, runs + r));
        }
    }

    fn queue_if_free(&mut self, e: u32, level: u32) {
        let s = self.state[e as usize];
        if s.count == 1 && !s.gone && !s.anchor {
            let key = self.key(e).max(level);
            self.free[key as usize].push(e);
        }
    }

    /// Removes an element from the cofaces of its faces.
    fn remove(&mut self, e: u32, level: u32) {
        self.state[e as usize].gone = true;
        self.boundary(e, |this, b| {
            let s = &mut this.state[b as usize];
            s.count -= 1;
            s.bounds ^= e;
            this.queue_if_free(b, level);
        });
    }

    /// Collapses all pairs, the bounding element nearest to the wall first.
    fn run(&mut self) {
        let mut done = 0u32;
        for level in 0..self.free.len() {
            let mut at = 0;
            while let Some(&e) = self.free[level].get(at) {
                at += 1;
                done = done.wrapping_add(1);
                if done.is_multiple_of(BETWEEN_CHECKS) {
                    checkpoint();
                }
                let s = self.state[e as usize];
                if s.gone || s.count != 1 {
                    continue;
                }
                self.state[e as usize].gone = true;
                self.remove(s.bounds, level as u32);
                self.remove(e, level as u32);
            }
            self.free[level] = Vec::new();
        }
    }
}
