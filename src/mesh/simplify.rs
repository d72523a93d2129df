//! Simplification by half-edge collapse: fewer faces, the vertices that stay stay where they are.

use rayon::prelude::*;

use super::edge_collapse::{Decimation, Piece, Stop};
use super::halfedge::NONE;
use super::input::Input;
use super::parts::in_parts;
use super::{MeshError, Recorder};
use crate::geometry::{ClosestPoint, Mesh, TriangleBvh};

/// What a collapse costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Metric {
    /// Squared distances to the planes of the faces, by area (Garland and Heckbert 1997).
    Qem,
    /// Those, each face weighing the mean area more, and the tangent plane by each vertex's normal,
    /// which weighs half as much as the faces around together, all of it more where normals differ
    /// from their neighbours'; and squared size times squared angle of each new face against its
    /// corners' normals, more than that where the angle is large or the face is a sliver. The
    /// normals should be fair; without any, those of the faces serve for the tangent planes.
    #[default]
    NormalQem,
    /// The paper's: each face weighs 1, the tangent plane as many as there are faces around.
    Paper,
}

/// What to simplify to, and what to leave alone.
#[derive(Clone, Copy, Debug)]
pub struct SimplifyOptions<'a> {
    /// Faces wanted; a collapse takes two (one on a boundary), so the last may go one below.
    pub faces: usize,
    /// What a collapse costs.
    pub metric: Metric,
    /// Whether the vertices that stay move to where they stand best for those that went, at each
    /// collapse and once more at the end; not those on boundaries and rims, nor locked ones.
    /// Connectivity stays what the collapses made it; normals are taken anew where they come to lie.
    pub relocate: bool,
    /// One flag a vertex: it neither moves nor goes.
    pub locked: Option<&'a [bool]>,
    /// No collapse whose vertex ends farther than this from the planes it stands for, root mean
    /// square, mm.
    pub max_error_mm: Option<f64>,
}

impl SimplifyOptions<'_> {
    /// Down to so many faces by the default metric.
    pub fn to_faces(faces: usize) -> Self {
        Self { faces, metric: Metric::default(), relocate: false, locked: None, max_error_mm: None }
    }
}

/// Why no more faces went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// As few faces as were wanted.
    Reached,
    /// Every further collapse would damage the mesh, or touch what is locked, or was refused by
    /// the recorder.
    NoLegalCollapse,
    /// Every further collapse would err too much.
    MaxError,
}

/// A simplified mesh, and where its parts come from.
#[derive(Clone, Debug)]
pub struct Simplified {
    /// The mesh. Vertices and faces are in the order of those they come from.
    pub mesh: Mesh,
    /// For each vertex, its id in the mesh given.
    pub vertex_ids: Vec<u32>,
    /// For each face, its id in the mesh given (a face whose corner moved to another vertex keeps
    /// its id).
    pub face_ids: Vec<u32>,
    /// Collapses made.
    pub collapses: usize,
    /// Why it ended.
    pub stopped: StopReason,
    /// Largest root mean square distance of a vertex that stayed to the planes it took over, mm.
    pub error_mm: f64,
}

/// Simplifies a manifold mesh; the result is manifold, with as many components, handles and
/// boundary loops as before, and the same at any number of threads.
///
/// A vertex on a boundary or on the rim of a cap goes along that line or not at all; where more
/// than two such lines meet, it stays. No face turns by more than 75° in a collapse, none becomes
/// thinner than 0.1° unless it was, no vertex gets more than 24 neighbours.
///
/// The recorder hears of each collapse when everything else agrees, under the ids of `mesh`; one
/// that it refuses is not made.
///
/// # Errors
/// What [`super::HalfEdges::new`] refuses (see [`super::make_manifold`]); [`MeshError::Length`] for a list of
/// locked vertices of another length than the vertices; [`MeshError::Empty`].
///
/// After Garland and Heckbert 1997 with half-edge collapses and the paper's normal term (section
/// 4.1). Departures: one entry a vertex in the heap, its cheapest target, whose cost is a lower
/// bound brought up to date when it is met: 9 of 10 entries of one an edge would be stale. Meshes
/// of 24,576 faces or more are simplified in parts of 12,288 (see `parts.rs`), then as a whole.
/// [`Metric::NormalQem`] also counts what the new faces deviate from their corners' normals, which
/// sees diagonals that quadrics at vertices do not, and weighs creases more.
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
        // The tree over the mesh given takes as much again.
        drop((run, input));
        renew_normals(&mut left, &vertex_ids, mesh);
    }
    Ok(Simplified { mesh: left, vertex_ids, face_ids, collapses, stopped, error_mm })
}

/// The run over all of the mesh.
pub fn whole(input: &Input<'_>) -> Decimation {
    let ids = |count: usize| (0..count as u32).collect();
    let vertex_ids = ids(input.mesh.positions.len());
    let piece = Piece { vertex_ids, face_ids: ids(input.mesh.faces.len()) };
    Decimation::new(input, piece, input.edges.clone(), input.freedom.clone())
}

/// Gives vertices that moved the normal of the surface given at the place nearest to them.
fn renew_normals(left: &mut Mesh, vertex_ids: &[u32], input: &Mesh) {
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

/// What is left, in the old order, with old ids of vertices and faces.
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
