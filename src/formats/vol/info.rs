//! Description of an input in words and numbers, without any text of the patient.

use glam::{DMat3, DVec3};
use serde::Serialize;

use super::affine::toward;
use crate::volume::{Acquisition, Grid, GridError, Rescale, SampleType};

/// Properties of an input, as `intima info` shows them: no description, name or date of it.
#[derive(Clone, Debug, Serialize)]
pub struct InputInfo {
    /// File format.
    pub format: String,
    /// The image; absent where a DICOM folder holds several series and none was chosen.
    #[serde(flatten)]
    pub image: Option<ImageInfo>,
    /// Series of a DICOM input, in the order of their index; empty for other formats.
    pub series: Vec<SeriesInfo>,
    /// Named segments of a segmentation; empty for other inputs.
    pub segments: Vec<SegmentInfo>,
    /// Assumptions made and data passed over, one sentence each.
    pub notes: Vec<String>,
    /// Acquisition of the image.
    #[serde(skip)]
    pub acquisition: Option<Acquisition>,
}

/// Geometry and sample type of one image.
#[derive(Clone, Debug, Serialize)]
pub struct ImageInfo {
    /// Voxels along i, j, k.
    pub dims: [u32; 3],
    /// Distance between voxel centres, mm.
    pub spacing_mm: [f64; 3],
    /// Centre of the first voxel, LPS mm.
    pub origin_mm: [f64; 3],
    /// Direction of the axes, LPS, row by row: the columns of the 3×3 matrix are i, j and k.
    pub direction: [f64; 9],
    /// Stored type, such as `int16`.
    pub sample_type: String,
    /// Factor from stored to real values.
    pub rescale_slope: f64,
    /// Offset from stored to real values, real units.
    pub rescale_intercept: f64,
    /// Directions in which i, j and k grow, one letter each: `LPS` is left, posterior, superior.
    pub orientation: String,
    /// Orientation in words.
    pub orientation_words: String,
    /// `right` or `left`: whether index space is mirrored against the patient.
    pub handedness: String,
    /// Whether the axes are square to each other.
    pub orthogonal: bool,
    /// Most memory that reading takes beside the samples, bytes: frames that are decoded, slices that
    /// are resampled.
    #[serde(skip)]
    pub reading_bytes: u64,
}

/// One segment of a segmentation (`.seg.nrrd`, DICOM SEG).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SegmentInfo {
    /// Name of the segment, for `--segment`: the only free text of an input that is shown.
    pub name: String,
    /// Value of the segment in the label map.
    pub label: i64,
    /// Index of the segment's layer, from 0: segments of different layers may overlap.
    pub layer: usize,
}

/// Free text of an input, for the screen alone: it may name the patient, so that what is printed for
/// debugging or logged has its length and not the text.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct ScreenText(pub String);

impl std::fmt::Debug for ScreenText {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} characters", self.0.chars().count())
    }
}

/// One DICOM series of a folder.
#[derive(Clone, Debug, Serialize)]
pub struct SeriesInfo {
    /// Place in the listing, from 0; accepted by `--series`.
    pub index: usize,
    /// Series instance UID; accepted by `--series`.
    pub uid: String,
    /// Modality code such as `CT`, or `other`.
    pub modality: String,
    /// Columns, rows and slices.
    pub dims: [u32; 3],
    /// Spacing in mm, where the slices form a box.
    pub spacing_mm: Option<[f64; 3]>,
    /// Number of slices.
    pub slices: usize,
    /// Description of the series, free text that may be empty: for a choice on the screen alone.
    #[serde(skip)]
    pub description: ScreenText,
    /// Convolution kernel of a CT; may be empty. For a choice on the screen alone.
    #[serde(skip)]
    pub kernel: ScreenText,
    /// Thickness of a slice, mm, where the series says.
    #[serde(skip)]
    pub thickness_mm: Option<f64>,
    /// Plane of the slices: axial, coronal, sagittal or oblique; empty where none is said.
    pub plane: &'static str,
}

/// Kernels that a manufacturer calls by a word.
const KERNEL_NAMES: [&str; 8] =
    ["BONE", "BONEPLUS", "CHST", "DETAIL", "EDGE", "LUNG", "SOFT", "STANDARD"];

impl SeriesInfo {
    /// Thickness of a slice, or the step from one to the next where none is said: mm, to hundredths.
    pub fn slice_mm(&self) -> Option<f64> {
        let mm = self.thickness_mm.or(self.spacing_mm.map(|spacing| spacing[2]))?;
        Some((100.0 * mm).round() / 100.0)
    }

    /// Kernel in the manner of a code, such as `B70f`, `FC52` or `STANDARD`: other text of the input goes
    /// into no message.
    pub fn kernel_code(&self) -> Option<&str> {
        let kernel = self.kernel.0.as_str();
        let is_code = kernel.len() <= 8
            && kernel.starts_with(|c: char| c.is_ascii_alphabetic())
            && kernel.bytes().all(|b| b.is_ascii_alphanumeric())
            && kernel.bytes().any(|b| b.is_ascii_digit());
        (is_code || KERNEL_NAMES.contains(&kernel)).then_some(kernel)
    }

    /// Thickness, plane and kernel, as far as they are known, joined by commas.
    pub fn distinction(&self) -> String {
        let mm = self.slice_mm().map(|mm| format!("{mm} mm"));
        let plane = Some(self.plane.to_owned()).filter(|plane| !plane.is_empty());
        let kernel = self.kernel_code().map(str::to_owned);
        let known: Vec<String> = [mm, plane, kernel].into_iter().flatten().collect();
        known.join(", ")
    }
}

impl ImageInfo {
    /// The grid that this describes.
    ///
    /// # Errors
    /// [`GridError`] names the part that is unusable.
    pub fn grid(&self) -> Result<Grid, GridError> {
        Grid::new(
            self.dims.map(u64::from),
            DVec3::from(self.spacing_mm),
            DVec3::from(self.origin_mm),
            DMat3::from_cols_array(&self.direction).transpose(),
        )
    }

    /// Bytes of the samples once read. The name of a type ends with its bits.
    pub fn bytes(&self) -> u64 {
        let bits = self.sample_type.trim_start_matches(|c: char| c.is_ascii_alphabetic());
        let sample = bits.parse::<u64>().map_or(8, |bits| bits.div_ceil(8));
        self.dims.iter().fold(sample, |n, d| n.saturating_mul(u64::from(*d)))
    }

    pub(super) fn of(grid: &Grid, sample_type: SampleType, rescale: Rescale) -> Self {
        let d = grid.direction;
        let axes = [("i", toward(d.x_axis)), ("j", toward(d.y_axis)), ("k", toward(d.z_axis))];
        let words: Vec<_> = axes.iter().map(|(n, (_, phrase))| format!("{n} {phrase}")).collect();
        Self {
            dims: grid.dims.to_array(),
            spacing_mm: grid.spacing_mm.to_array(),
            origin_mm: grid.origin_mm.to_array(),
            direction: d.transpose().to_cols_array(),
            sample_type: sample_type.name().to_owned(),
            rescale_slope: rescale.slope,
            rescale_intercept: rescale.intercept,
            orientation: axes.iter().map(|(_, (letter, _))| letter).collect(),
            orientation_words: words.join(", "),
            handedness: if grid.is_left_handed() { "left" } else { "right" }.to_owned(),
            orthogonal: grid.is_orthogonal(),
            reading_bytes: 0,
        }
    }
}
