//! NIfTI-1 out.

use std::io::Write;
use std::path::Path;

use glam::{DMat3, DQuat};

use super::affine::RAS;
use super::gzip::GzipWriter;
use super::rescale::real_samples;
use super::{FormatError, lower_name};
use crate::formats::atomic_file::write_atomic;
use crate::volume::{Grid, Rescale, SampleType, Volume};

/// Writes `.nii` raw and `.nii.gz` compressed.
pub(super) fn write(path: &Path, volume: &Volume) -> Result<(), FormatError> {
    let scl = [volume.rescale.slope, volume.rescale.intercept].map(|v| v as f32);
    // A factor that 32 bits cannot hold is applied to the samples instead.
    let fits = scl[0] != 0.0 && scl.iter().all(|v| v.is_finite());
    let (samples, scl) = if fits {
        (std::borrow::Cow::Borrowed(&volume.samples), scl)
    } else {
        (real_samples(volume), [1.0, 0.0])
    };
    let head = header(&volume.grid, samples.sample_type(), scl);
    let gz = lower_name(path).ends_with(".gz");
    write_atomic(path, |out| {
        if !gz {
            out.write_all(&head)?;
            return out.write_all(samples.bytes());
        }
        let mut out = GzipWriter::new(out)?;
        out.write_all(&head)?;
        out.write_all(samples.bytes())?;
        out.finish()
    })
}

/// The 352 bytes before the samples, in this machine's byte order; readers tell it from the first
/// field.
fn header(grid: &Grid, sample_type: SampleType, scl: [f32; 2]) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    let scl = if scl == [Rescale::IDENTITY.slope as f32, 0.0] { [0.0, 0.0] } else { scl };
    put(0, &348i32.to_ne_bytes());
    let dims = grid.dims.to_array();
    for (i, d) in [3, dims[0], dims[1], dims[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * i, &(d as i16).to_ne_bytes());
    }
    put(70, &code(sample_type).to_ne_bytes());
    put(72, &(8 * sample_type.size() as i16).to_ne_bytes());

    // Rows of the matrix from voxel to RAS mm.
    let ras = DMat3::from_diagonal(RAS);
    let axes = ras * grid.direction;
    let origin = grid.origin_mm * RAS;
    let handed = if axes.determinant() < 0.0 { -1.0 } else { 1.0 };
    let spacing = grid.spacing_mm;
    let pixdim = [handed, spacing.x, spacing.y, spacing.z, 0.0, 0.0, 0.0, 0.0];
    for (i, v) in pixdim.into_iter().enumerate() {
        put(76 + 4 * i, &(v as f32).to_ne_bytes());
    }
    put(108, &352f32.to_ne_bytes());
    put(112, &scl[0].to_ne_bytes());
    put(116, &scl[1].to_ne_bytes());
    put(123, &[2]); // millimetres
    // A quaternion holds square axes only; for others the sform stands alone.
    if grid.is_orthogonal() {
        put(252, &1i16.to_ne_bytes());
        let turn = DMat3::from_cols(axes.x_axis, axes.y_axis, axes.z_axis * handed);
        let q = DQuat::from_mat3(&turn).normalize();
        let q = if q.w < 0.0 { -q } else { q };
        for (i, v) in [q.x, q.y, q.z, origin.x, origin.y, origin.z].into_iter().enumerate() {
            put(256 + 4 * i, &(v as f32).to_ne_bytes());
        }
    }
    put(254, &1i16.to_ne_bytes()); // sform: scanner coordinates
    for row in 0..3 {
        let entries = [
            axes.x_axis[row] * spacing.x,
            axes.y_axis[row] * spacing.y,
            axes.z_axis[row] * spacing.z,
            origin[row],
        ];
        for (i, v) in entries.into_iter().enumerate() {
            put(280 + 16 * row + 4 * i, &((v + 0.0) as f32).to_ne_bytes());
        }
    }
    put(344, b"n+1\0");
    h
}

fn code(t: SampleType) -> i16 {
    match t {
        SampleType::U8 => 2,
        SampleType::I16 => 4,
        SampleType::I32 => 8,
        SampleType::F32 => 16,
        SampleType::F64 => 64,
        SampleType::I8 => 256,
        SampleType::U16 => 512,
        SampleType::U32 => 768,
        SampleType::I64 => 1024,
        SampleType::U64 => 1280,
    }
}
