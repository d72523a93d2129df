//! Mesh simplification by half-edge collapse with quadric error metrics.

use rayon::prelude::*;

use super::edge_collapse::{Decimation, Stop, SubMesh};
use super::halfedge::NONE;
use super::input::Input;
use super::options::{SimplifyOptions, StopReason};
use super::parts::in_parts;
use super::{MeshError, Recorder};
use crate::geometry::{ClosestPoint, Mesh, TriangleBvh};

/// A simplified mesh, with the input ids of its vertices and faces.
#[derive(Clone, Debug)]
pub struct Simplified {
    /// The mesh. Vertices and faces are in the order of their input ids.
    pub mesh: Mesh,
    /// For each vertex, its input id.
    pub vertex_ids: Vec<u32>,
    /// For each face, its input id (a face one of whose corners collapsed keeps its id).
    pub face_ids: Vec<u32>,
    /// Collapses made.
    pub collapses: usize,
    /// Why the simplification ended.
    pub stopped: StopReason,
    /// Largest root mean square distance of a vertex to the planes of its quadric, mm.
    pub error_mm: f64,
}

/// Simplifies a manifold mesh; the result is manifold, with as many components, handles and
/// boundary loops as before, and the same at any number of threads.
///
/// A vertex on a boundary or on the rim of a cap collapses along that line only; where more than two
/// such lines meet, it is kept. No face turns by more than 75° in a collapse, no angle becomes
/// smaller than 0.1° unless it was, no vertex gets more than 24 neighbours.
///
/// The recorder receives each legal collapse before it is made, with the ids of `mesh`; one that it
/// vetoes is not made.
///
/// # Errors
/// What [`super::HalfEdges::new`] refuses (see [`super::make_manifold`]); [`MeshError::Length`] for a list of
/// locked vertices of another length than the vertices; [`MeshError::Empty`].
///
/// Garland and Heckbert 1997 (doi:10.1145/258734.258849) with half-edge collapses and the normal term
/// of Li et al. 2004, section 4.1. Departures: the heap has one entry a vertex, its cheapest target,
/// whose cost is a lower bound that is brought up to date when it comes up. Meshes of 24,576 faces
/// or more are simplified in parts of 12,288 in parallel (`parts.rs`), then as a whole.
/// [`NormalQem`](super::Metric::NormalQem) adds the deviation of new faces from their corners' normals, which tells
/// diagonals apart that vertex quadrics do not, and weights creases.
pub fn simplify<R: Recorder>(
    mesh: &Mesh,
    options: &SimplifyOptions<'_>,
    recorder: &mut R,
) -> Result<Simplified, MeshError> {
    if mesh.faces.is_empty() {
        return Err(MeshError::Empty);
    }
    let wanted = mesh.positions.len();
    if let Some(locked) = options.locked.filter(|l| l.len() != wanted) {
        let (what, found) = ("locked flags", locked.len());
        return Err(MeshError::Length { what, found, wanted });
    }
    let input = Input::new(mesh, options)?;
    let stop = Stop { faces: options.faces, most: u64::MAX, max_error_mm: options.max_error_mm };
    let mut run = match in_parts::<R::Log>(&input, &stop) {
        Some((run, logs)) => {
            logs.into_iter().for_each(|log| recorder.merge(log));
            run
        }
        None => whole(&input),
    };
    let mut log = R::Log::default();
    let stopped = run.run(&input, &stop, &mut log);
    recorder.merge(log);
    let (collapses, error_mm) = (run.collapses, run.error_mm);
    let (mut left, vertex_ids, face_ids) = left_of(mesh, &run);
    if options.relocate && collapses > 0 {
        run.relocate_all();
        for (p, v) in left.positions.iter_mut().zip(run.stay()) {
            if run.may_move(v) {
                *p = input.in_mm(run.position(v)).as_vec3();
            }
        }
        // Freed first: the tree over the input needs as much memory again.
        drop((run, input));
        interpolate_normals(&mut left, &vertex_ids, mesh);
    }
    Ok(Simplified { mesh: left, vertex_ids, face_ids, collapses, stopped, error_mm })
}

/// The run over all of the mesh.
pub fn whole(input: &Input<'_>) -> Decimation {
    let ids = |count: usize| (0..count as u32).collect();
    let vertex_ids = ids(input.mesh.positions.len());
    let piece = SubMesh { vertex_ids, face_ids: ids(input.mesh.faces.len()) };
    Decimation::new(input, piece, input.edges.clone(), input.freedom.clone())
}

/// Gives vertices that moved the normal of the input surface at the nearest point.
fn interpolate_normals(left: &mut Mesh, vertex_ids: &[u32], input: &Mesh) {
    if left.normals.is_empty() {
        return;
    }
    let tree = TriangleBvh::new(input);
    let places = left.positions.par_iter().zip(vertex_ids).with_min_len(512);
    places.zip(&mut left.normals).for_each(|((p, id), normal)| {
        if *p == input.positions[*id as usize] {
            return;
        }
        let Some(ClosestPoint { at, .. }) = tree.closest(p.as_dvec3()) else { return };
        let corners = input.faces[at.face as usize].map(|v| input.normals[v as usize]);
        let sum: glam::Vec3 = corners.iter().zip(at.weights).map(|(n, w)| *n * w as f32).sum();
        *normal = sum.try_normalize().unwrap_or(*normal);
    });
}

/// The remaining mesh in input order, with the input ids of its vertices and faces.
pub fn left_of(mesh: &Mesh, run: &Decimation) -> (Mesh, Vec<u32>, Vec<u32>) {
    let mut new = vec![NONE; run.edges.vertex_count()];
    let mut vertex_ids = Vec::new();
    for v in run.stay() {
        new[v as usize] = vertex_ids.len() as u32;
        vertex_ids.push(run.vertex_id(v));
    }
    let (mut faces, mut face_ids) = (Vec::new(), Vec::new());
    for f in 0..run.edges.face_count() as u32 {
        if let Some(corners) = run.edges.face(f) {
            faces.push(corners.map(|v| new[v as usize]));
            face_ids.push(run.face_id(f));
        }
    }
    let pick = |list: &[glam::Vec3]| match list.is_empty() {
        true => Vec::new(),
        false => vertex_ids.iter().map(|v| list[*v as usize]).collect(),
    };
    let (positions, normals) = (pick(&mesh.positions), pick(&mesh.normals));
    let caps = match mesh.caps.is_empty() {
        true => Vec::new(),
        false => face_ids.iter().map(|f| mesh.caps[*f as usize]).collect(),
    };
    (Mesh { positions, normals, faces, caps }, vertex_ids, face_ids)
}
