//! Meshes that come from Python.

use glam::Vec3;
use intima::geometry::Mesh;
use intima::mesh::{SimplifyOptions, StopReason, make_manifold};
use intima::session::SessionError;
use intima::task::{CancelToken, catch_cancelled};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array;
use crate::call::call;
use crate::error::argument;
use crate::settings::word;

/// Simplifies a triangle mesh to `target` faces by half-edge collapse: a dictionary of arrays.
#[pyfunction]
#[pyo3(signature = (vertices, faces, normals, target, metric, max_error, keep_vertices, threads))]
pub fn simplify<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f32>,
    faces: PyReadonlyArray2<'py, u32>,
    normals: Option<PyReadonlyArray2<'py, f32>>,
    target: usize,
    metric: &str,
    max_error: Option<f64>,
    keep_vertices: bool,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let mesh = Mesh {
        positions: triples(&vertices, "vertices")?.into_iter().map(Vec3::from).collect(),
        normals: match &normals {
            Some(normals) => triples(normals, "normals")?.into_iter().map(Vec3::from).collect(),
            None => Vec::new(),
        },
        faces: triples(&faces, "faces")?,
        caps: Vec::new(),
    };
    if let Some(e) = max_error.filter(|e| e.is_nan() || *e <= 0.0) {
        return Err(argument(format!("max_error={e}: above 0 mm")));
    }
    let options = SimplifyOptions {
        metric: word("metric", metric)?,
        relocate: !keep_vertices,
        max_error_mm: max_error,
        ..SimplifyOptions::to_faces(target)
    };
    let cancel = CancelToken::default();
    let work = || {
        // A pool of its own: the global one would not outlive a fork.
        let entered = cancel.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .start_handler(move |_| entered.enter())
            .build()
            .map_err(|e| SessionError::System(e.to_string()))?;
        let simplified = pool.install(|| {
            catch_cancelled(|| {
                let (mesh, _) = make_manifold(&mesh)?;
                intima::mesh::simplify(&mesh, &options, &mut ())
            })
        });
        Ok(simplified.map_err(|_| SessionError::Cancelled)??)
    };
    let simplified = call(py, &cancel, work)?;
    let out = array::mesh(py, &simplified.mesh, false)?;
    let stopped = match simplified.stopped {
        StopReason::Reached => "reached",
        StopReason::NoLegalCollapse => "no legal collapse",
        StopReason::MaxError => "max error",
    };
    out.set_item("stopped", stopped)?;
    out.set_item("error_mm", simplified.error_mm)?;
    Ok(out)
}

/// Rows of three of an array of (n, 3).
fn triples<T: numpy::Element + Copy>(
    array: &PyReadonlyArray2<'_, T>,
    name: &str,
) -> PyResult<Vec<[T; 3]>> {
    if array.shape()[1] != 3 {
        return Err(argument(format!("{name}: an array of (n, 3), not {:?}", array.shape())));
    }
    let flat =
        array.as_slice().map_err(|_| argument(format!("{name}: the array is not C-contiguous")))?;
    Ok(flat.chunks_exact(3).map(|row| [row[0], row[1], row[2]]).collect())
}
