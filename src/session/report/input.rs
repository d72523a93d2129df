//! Report of the volumes that were read.

use crate::volume::{Acquisition, Grid, Volume};
use serde::Serialize;

/// The volume that was read.
#[derive(Clone, Debug, Serialize)]
pub struct InputReport {
    /// BLAKE3 of the stored samples; absent where only the header was read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hash: Option<String>,
    /// Voxels along x, y, z.
    pub dims: [u32; 3],
    /// Distances between voxel centres along x, y, z.
    pub spacing_mm: [f64; 3],
    /// Stored type of a sample, such as `int16`.
    pub sample_type: String,
    /// Modality code such as `CT`, where the file says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub modality: Option<&'static str>,
    /// Start of the BLAKE3 hash of the series instance UID, of a DICOM series.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series_hash: Option<String>,
}

/// BLAKE3 of a volume's samples.
pub(in crate::session) fn hash_of(volume: &Volume) -> String {
    blake3::hash(volume.samples.bytes()).to_hex().to_string()
}

impl InputReport {
    /// Hash and geometry of a volume.
    pub fn of(volume: &Volume) -> Self {
        Self { hash: Some(hash_of(volume)), ..Self::without_hash(volume) }
    }

    /// Geometry and acquisition of a volume.
    pub(in crate::session) fn without_hash(volume: &Volume) -> Self {
        let sample_type = volume.samples.sample_type().name().to_owned();
        Self::of_header(&volume.grid, sample_type).of_acquisition(volume.acquisition.as_ref())
    }

    /// Geometry of an image of which only the header was read.
    pub(in crate::session) fn of_header(grid: &Grid, sample_type: String) -> Self {
        let stored = grid.as_stored();
        let (dims, spacing_mm) = (stored.dims.to_array(), stored.spacing_mm.to_array());
        Self { hash: None, dims, spacing_mm, sample_type, modality: None, series_hash: None }
    }

    /// Adds what is known of the acquisition.
    pub(in crate::session) fn of_acquisition(self, acquisition: Option<&Acquisition>) -> Self {
        let Some(a) = acquisition else { return self };
        Self { modality: Some(a.modality), series_hash: a.series_hash.clone(), ..self }
    }
}
