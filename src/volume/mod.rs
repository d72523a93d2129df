//! A sampled volume: its grid in patient space (LPS, mm), its samples as they were stored, and
//! analytic phantoms with exact reference data.

mod axis_order;
mod grid;
pub mod phantom;
mod samples;

pub use axis_order::AxisOrder;
pub(crate) use axis_order::canonical_samples;
pub use grid::{Grid, GridError};
pub(crate) use samples::with_samples;
pub use samples::{Sample, SampleBuffer, SampleType, Samples, SharedSamples};

/// A volume as read from a file: samples in stored units, geometry in patient space.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Grid of the samples in patient space.
    pub grid: Grid,
    /// Samples, x fastest; `grid.len()` of them.
    pub samples: Samples,
    /// Map from stored to real values: `real = slope * stored + intercept` (HU for CT).
    pub rescale: Rescale,
    /// First and last of the stored values that mark places without a measurement (DICOM's pixel
    /// padding): never part of a range of values.
    pub padding: Option<[f64; 2]>,
    /// Acquisition that the samples are of, where the file says.
    pub acquisition: Option<Acquisition>,
}

/// Acquisition that a volume was measured in, without text of the patient.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Acquisition {
    /// Modality code such as `CT`, or `other`.
    pub modality: &'static str,
    /// First 16 digits of the BLAKE3 hash of the series instance UID, in hexadecimal: tells two
    /// series apart without naming either. `None` where the file has no valid UID.
    pub series_hash: Option<String>,
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
    /// Identity: stored values are real values.
    pub const IDENTITY: Self = Self { slope: 1.0, intercept: 0.0 };

    /// Returns the real value of a stored one.
    #[inline]
    pub fn real(self, stored: f64) -> f64 {
        self.slope * stored + self.intercept
    }

    /// Returns the stored value (not rounded) of a real one.
    #[inline]
    pub fn stored(self, real: f64) -> f64 {
        (real - self.intercept) / self.slope
    }
}

impl Volume {
    /// Creates a volume whose stored values are its real values.
    ///
    /// # Panics
    /// If the number of samples is not the grid's.
    pub fn new(grid: Grid, samples: Samples) -> Self {
        assert_eq!(samples.len(), grid.len(), "samples must fill the grid");
        Self { grid, samples, rescale: Rescale::IDENTITY, padding: None, acquisition: None }
    }

    /// Returns the real value (after rescale) at linear index `i`.
    pub fn real(&self, i: usize) -> f64 {
        self.rescale.real(self.samples.get(i))
    }

    /// Whether a stored value is padding.
    pub fn is_padding(&self, stored: f64) -> bool {
        self.padding.is_some_and(|[first, last]| first <= stored && stored <= last)
    }

    /// Returns the smallest and largest finite real value without padding, or `None` if there is no
    /// such sample.
    pub fn range(&self) -> Option<(f64, f64)> {
        let (lo, hi) = self.samples.range_without(self.padding)?;
        let (a, b) = (self.rescale.real(lo), self.rescale.real(hi));
        Some((a.min(b), a.max(b)))
    }
}
