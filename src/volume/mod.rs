//! A sampled volume: its grid in patient space (LPS, mm), its samples as they were stored, and
//! analytic phantoms with their truth.

mod grid;
pub mod phantom;
mod samples;

pub use grid::{Grid, GridError};
pub(crate) use samples::with_samples;
pub use samples::{Sample, SampleBuffer, SampleType, Samples, SharedSamples};

/// A volume as it came from a file: samples in stored units, geometry in patient space.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Where the samples lie.
    pub grid: Grid,
    /// The samples, x fastest; `grid.len()` of them.
    pub samples: Samples,
    /// Stored value to real value: `real = slope * stored + intercept` (HU for CT).
    pub rescale: Rescale,
    /// Stored values, first and last, that fill the grid where nothing was measured (DICOM's pixel
    /// padding): never part of a range of values.
    pub padding: Option<[f64; 2]>,
}

/// Linear map from stored to real values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rescale {
    /// Factor; never zero, may be negative.
    pub slope: f64,
    /// Offset in real units.
    pub intercept: f64,
}

impl Rescale {
    /// Stored values are real values.
    pub const IDENTITY: Self = Self { slope: 1.0, intercept: 0.0 };

    /// Real value of a stored one.
    #[inline]
    pub fn real(self, stored: f64) -> f64 {
        self.slope * stored + self.intercept
    }

    /// Stored value (not rounded) of a real one.
    #[inline]
    pub fn stored(self, real: f64) -> f64 {
        (real - self.intercept) / self.slope
    }
}

impl Volume {
    /// A volume whose stored values are its real values.
    ///
    /// # Panics
    /// If the number of samples is not the grid's.
    pub fn new(grid: Grid, samples: Samples) -> Self {
        assert_eq!(samples.len(), grid.len(), "samples must fill the grid");
        Self { grid, samples, rescale: Rescale::IDENTITY, padding: None }
    }

    /// Real value (after rescale) at linear index `i`.
    pub fn real(&self, i: usize) -> f64 {
        self.rescale.real(self.samples.get(i))
    }

    /// Whether a stored value is padding.
    pub fn is_padding(&self, stored: f64) -> bool {
        self.padding.is_some_and(|[first, last]| first <= stored && stored <= last)
    }

    /// Smallest and largest finite real value but padding, or `None` if there is no such sample.
    pub fn range(&self) -> Option<(f64, f64)> {
        let (lo, hi) = self.samples.range_without(self.padding)?;
        let (a, b) = (self.rescale.real(lo), self.rescale.real(hi));
        Some((a.min(b), a.max(b)))
    }
}
