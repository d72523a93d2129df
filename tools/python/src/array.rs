//! Volumes borrowed from arrays, and results as arrays.

use std::marker::PhantomData;
use std::sync::Arc;

use bytes::Bytes;
use glam::{DMat3, DVec3, Vec3};
use intima::geometry::Mesh;
use intima::volume::{Grid, Rescale, Sample, SampleBuffer, Samples, SharedSamples, Volume};
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use pyo3_bytes::PyBytes;

use crate::error::argument;

/// Array of samples with its place in the patient, as `intima.Volume` hands it over: a dictionary.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct ArrayInput {
    /// All bytes of the array, borrowed.
    buffer: PyBytes,
    /// Name of the sample type, as NumPy has it.
    dtype: String,
    /// Voxels along the array's axes: z, y, x.
    shape: [u64; 3],
    /// Distance of voxel centres along the array's axes, mm: z, y, x.
    spacing: [f64; 3],
    /// Centre of voxel (0, 0, 0), LPS mm: x, y, z.
    origin: [f64; 3],
    /// Rows of the direction matrix; its columns are the directions of x, y and z.
    direction: [[f64; 3]; 3],
    /// Slope and intercept from stored to real values.
    rescale: [f64; 2],
}

/// Samples in the memory of a Python object, which lives as long as they do.
struct BorrowedSamples<T> {
    bytes: Bytes,
    sample: PhantomData<fn() -> T>,
}

impl<T: Sample> AsRef<[T]> for BorrowedSamples<T> {
    fn as_ref(&self) -> &[T] {
        bytemuck::cast_slice(&self.bytes)
    }
}

/// Borrows samples; the cast, which depends on the address alone, is tried once here.
fn borrowed<T: Sample>(bytes: Bytes) -> PyResult<Samples>
where
    Samples: From<SharedSamples<T>>,
{
    if let Err(e) = bytemuck::try_cast_slice::<u8, T>(&bytes) {
        return Err(argument(format!("the array's memory is not aligned to its samples: {e}")));
    }
    let shared: SharedSamples<T> =
        Arc::new(BorrowedSamples { bytes, sample: PhantomData::<fn() -> T> });
    Ok(shared.into())
}

impl ArrayInput {
    /// The volume, in the array's own memory.
    pub fn volume(self) -> PyResult<Volume> {
        let [nz, ny, nx] = self.shape;
        let [z, y, x] = self.spacing;
        let [slope, intercept] = self.rescale;
        if !(slope.is_finite() && slope != 0.0 && intercept.is_finite()) {
            return Err(argument(format!("rescale ({slope}, {intercept}): finite, slope not 0")));
        }
        let direction = DMat3::from_cols_array_2d(&self.direction).transpose();
        let origin = DVec3::from(self.origin);
        let grid = Grid::new([nx, ny, nz], DVec3::new(x, y, z), origin, direction)
            .map_err(|e| argument(e.to_string()))?;
        let bytes = self.buffer.into_inner();
        let samples = samples_of(&self.dtype, bytes)?;
        if samples.len() != grid.len() {
            let (has, needs) = (samples.len(), grid.len());
            return Err(argument(format!("{has} samples do not fill {needs} voxels")));
        }
        let rescale = Rescale { slope, intercept };
        Ok(Volume { rescale, ..Volume::new(grid, samples) })
    }
}

fn samples_of(dtype: &str, bytes: Bytes) -> PyResult<Samples> {
    match dtype {
        "uint8" => borrowed::<u8>(bytes),
        "int8" => borrowed::<i8>(bytes),
        "uint16" => borrowed::<u16>(bytes),
        "int16" => borrowed::<i16>(bytes),
        "uint32" => borrowed::<u32>(bytes),
        "int32" => borrowed::<i32>(bytes),
        "uint64" => borrowed::<u64>(bytes),
        "int64" => borrowed::<i64>(bytes),
        "float32" => borrowed::<f32>(bytes),
        "float64" => borrowed::<f64>(bytes),
        other => Err(argument(format!("no samples of type {other}"))),
    }
}

/// A field over a grid as an array of z, y, x, in the memory of the vector.
pub fn dense<'py, T: Element>(
    py: Python<'py>,
    field: Vec<T>,
    grid: &Grid,
) -> PyResult<Bound<'py, PyAny>> {
    let [x, y, z] = grid.dims.to_array().map(|n| n as usize);
    Ok(field.into_pyarray(py).reshape([z, y, x])?.into_any())
}

/// Rows of three numbers as an array of (n, 3), in the memory of the vector.
pub fn rows<'py, T: Element + bytemuck::Pod>(
    py: Python<'py>,
    rows: Vec<[T; 3]>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let count = rows.len();
    let flat: Vec<T> = bytemuck::allocation::cast_vec(rows);
    flat.into_pyarray(py).reshape([count, 3])
}

/// Vectors as rows.
pub fn points(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    bytemuck::cast_slice(vectors).to_vec()
}

/// Samples of a volume that was read, without a copy where it is nobody else's.
pub fn samples<'py>(py: Python<'py>, volume: Volume) -> PyResult<Bound<'py, PyAny>> {
    let grid = volume.grid;
    Ok(match volume.samples {
        Samples::U8(s) => dense(py, owned(s), &grid)?,
        Samples::I8(s) => dense(py, owned(s), &grid)?,
        Samples::U16(s) => dense(py, owned(s), &grid)?,
        Samples::I16(s) => dense(py, owned(s), &grid)?,
        Samples::U32(s) => dense(py, owned(s), &grid)?,
        Samples::I32(s) => dense(py, owned(s), &grid)?,
        Samples::U64(s) => dense(py, owned(s), &grid)?,
        Samples::I64(s) => dense(py, owned(s), &grid)?,
        Samples::F32(s) => dense(py, owned(s), &grid)?,
        Samples::F64(s) => dense(py, owned(s), &grid)?,
    })
}

fn owned<T: Clone>(samples: SampleBuffer<T>) -> Vec<T> {
    match samples {
        SampleBuffer::Owned(v) => v,
        shared => shared.to_vec(),
    }
}

/// Place of a grid in the patient, in the words of `intima.Volume`.
pub fn geometry<'py>(py: Python<'py>, grid: &Grid) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let [x, y, z] = grid.spacing_mm.to_array();
    let [nx, ny, nz] = grid.dims.to_array();
    out.set_item("shape", (nz, ny, nx))?;
    out.set_item("spacing", (z, y, x))?;
    out.set_item("origin", <(f64, f64, f64)>::from(grid.origin_mm))?;
    out.set_item("direction", PyArray2::from_vec2(py, &direction(grid))?)?;
    Ok(out)
}

fn direction(grid: &Grid) -> Vec<Vec<f64>> {
    grid.direction.transpose().to_cols_array_2d().iter().map(|row| row.to_vec()).collect()
}

/// A mesh as a dictionary of arrays. Faces and normals of the engine look into the lumen.
///
/// * `outward`: whether to turn them over.
pub fn mesh<'py>(py: Python<'py>, mesh: &Mesh, outward: bool) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let mut faces = mesh.faces.clone();
    let mut normals = points(&mesh.normals);
    if outward {
        faces.iter_mut().for_each(|f| f.swap(1, 2));
        normals.iter_mut().flatten().for_each(|x| *x = 0.0 - *x);
    }
    out.set_item("vertices", rows(py, points(&mesh.positions))?)?;
    out.set_item("faces", rows(py, faces)?)?;
    let has_normals = !normals.is_empty();
    out.set_item("normals", has_normals.then(|| rows(py, normals)).transpose()?)?;
    let caps = (!mesh.caps.is_empty()).then(|| PyArray1::from_slice(py, &mesh.caps));
    out.set_item("caps", caps)?;
    Ok(out)
}
