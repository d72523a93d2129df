//! The surface with its normals.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use super::load::InputVolume;
use super::{Clock, Segmented, Session, SessionError, SettingError, WallMethod, present};
use crate::compute::Plan;
use crate::device::Device;
use crate::field::Sampler;
use crate::geometry::Mesh;
use crate::lumen::{Bricks, GreyBricks, GreyValues, Lumen};
use crate::render::PreparedMesh;
use crate::surface::{
    self as stage, Adjacency, Grey, Midpoint, MultiscaleNormals, Shading, Smoothing, Surface,
    Topology, VoxelFrame, shading,
};
use crate::volume::Volume;
use crate::wall::{
    Evidence, FieldCrossing, FluidLevel, WallField, field_normals, fluid_levels, smoothed_field,
    vertex_evidence,
};

/// Value below which a lumen is filled with gas, HU.
pub(super) const MAX_GAS_HU: f64 = -200.0;

/// Options for making the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SurfaceOptions {
    /// Smoothing of the normals.
    smoothing: Smoothing,
    /// Start of a walk along +x that hits first the component to keep; all are kept without one.
    track_from: Option<IVec3>,
}

/// A surface ready to draw.
pub struct Wall {
    /// Mesh with smoothed normals.
    pub mesh: Mesh,
    /// Counts.
    pub topology: Topology,
    /// Surfaces of fluid under gas in it, the largest first.
    pub levels: Vec<FluidLevel>,
}

impl Wall {
    /// Returns notes for a reader of the surface.
    pub(super) fn notes(&self) -> impl Iterator<Item = String> {
        let levels = self.levels.len();
        let area: f64 = self.levels.iter().map(|level| level.area_mm2).sum();
        let levels = (levels > 0).then(|| {
            format!(
                "{levels} flat piece(s) of the wall, {area:.0} mm² in all, are levels of fluid and no \
                 mucosa"
            )
        });
        let tunnels = self.topology.tunnels();
        let tunnels = (tunnels > 0).then(|| {
            format!(
                "the lumen has {tunnels} tunnels (touching folds, loops, noise); the centerline \
                 follows a tree through them"
            )
        });
        tunnels.into_iter().chain(levels)
    }
}

/// Part of a wall that is drawn and written.
pub struct ShownWall {
    wall: Arc<Wall>,
    /// The wall without caps, where they are left out and there are any.
    pub(super) open: Option<Mesh>,
    /// Whether it has no hole.
    pub closed: bool,
}

impl ShownWall {
    /// The mesh that is drawn.
    pub fn mesh(&self) -> &Mesh {
        self.open.as_ref().unwrap_or(&self.wall.mesh)
    }

    /// The mesh with its caps.
    pub(super) fn whole(&self) -> &Mesh {
        &self.wall.mesh
    }
}

/// The mesh without its caps.
pub fn without_caps(mesh: &Mesh) -> Mesh {
    let keep = |f: &([u32; 3], bool)| !f.1;
    let faces = mesh.faces.iter().copied().zip(mesh.caps.iter().copied());
    Mesh {
        positions: mesh.positions.clone(),
        normals: mesh.normals.clone(),
        faces: faces.filter(keep).map(|f| f.0).collect(),
        caps: Vec::new(),
    }
}

/// Returns the mesh of a wall as it is written: with open ends, the faces that are no caps and their
/// vertices.
pub fn written_mesh(mesh: &Mesh, open_ends: bool) -> Cow<'_, Mesh> {
    if !open_ends || !mesh.caps.contains(&true) {
        return Cow::Borrowed(mesh);
    }
    let open = without_caps(mesh);
    let mut used = vec![false; open.positions.len()];
    open.faces.iter().flatten().for_each(|v| used[*v as usize] = true);
    let number = |next: &mut u32, used: &bool| {
        let own = *next;
        *next += u32::from(*used);
        Some(own)
    };
    let new: Vec<u32> = used.iter().scan(0, number).collect();
    let of_used = |values: Vec<Vec3>| {
        values.into_iter().zip(&used).filter(|v| *v.1).map(|v| v.0).collect::<Vec<_>>()
    };
    Cow::Owned(Mesh {
        positions: of_used(open.positions),
        normals: of_used(open.normals),
        faces: open.faces.iter().map(|f| f.map(|v| new[v as usize])).collect(),
        caps: Vec::new(),
    })
}

impl Session {
    pub(super) fn run_wall(&self, clock: &mut Clock) -> Result<Wall, SessionError> {
        let segmented = present(&self.slots.lumen);
        // Crossings of a wall field are in the field.
        let crosses_grey = self.crosses_grey(segmented.method, &segmented.options.selection);
        let loaded = if crosses_grey { Some(self.with_samples()?) } else { None };
        let device = present(&self.slots.device);
        let options = SurfaceOptions {
            smoothing: self.settings.smoothing(),
            track_from: segmented.track_from(),
        };
        let bricks = match loaded.as_ref().map(|l| &l.volume) {
            Some(InputVolume::Parts(input)) => {
                Some(GreyBricks::read(&input.parts, Bricks::about(&segmented.lumen.mask()))?)
            }
            _ => None,
        };
        let whole = loaded.as_ref().and_then(|l| l.volume.whole());
        let grey = match &bricks {
            Some(bricks) => Some(GreyValues::Bricks(bricks)),
            None => whole.map(|volume| GreyValues::Whole(volume)),
        };
        wall(&mut device.lock(), grey, &segmented, options, clock)
    }

    pub(super) fn run_shown_wall(&self, _: &mut Clock) -> Result<ShownWall, SessionError> {
        let wall = present(&self.slots.wall);
        let open = self.settings.wall.open_ends && wall.mesh.caps.contains(&true);
        let closed = wall.topology.watertight && !open;
        let open = open.then(|| without_caps(&wall.mesh));
        Ok(ShownWall { wall, open, closed })
    }

    pub(super) fn run_prepared_wall(
        &self,
        clock: &mut Clock,
    ) -> Result<PreparedMesh, SessionError> {
        let wall = present(&self.slots.wall);
        let faces = wall.mesh.faces.len() as u64;
        let prepare = || match self.settings.wall.open_ends {
            true => PreparedMesh::without_caps(&wall.mesh),
            false => PreparedMesh::new(&wall.mesh),
        };
        Ok(clock.time("prepared wall", "faces", prepare, |_| faces)?)
    }

    pub(super) fn run_evidence(
        &self,
        clock: &mut Clock,
    ) -> Result<Option<Vec<Evidence>>, SessionError> {
        let (found, wall) = (present(&self.slots.lumen), present(&self.slots.wall));
        let vertices = wall.mesh.positions.len() as u64;
        let of = |field| {
            let mut evidence = vertex_evidence(&found.lumen, field, &wall.mesh);
            for v in wall.levels.iter().flat_map(|level| &level.vertices) {
                evidence[*v as usize] = Evidence::FluidLevel;
            }
            evidence
        };
        let find = || found.wall.as_ref().map(of);
        Ok(clock.time("evidence", "vertices", find, |_| vertices))
    }

    pub(super) fn run_shading(&self, clock: &mut Clock) -> Result<Shading, SessionError> {
        let drawn = present(&self.slots.shown_wall);
        let count = |s: &Shading| s.vertices.len() as u64;
        Ok(clock.time("shading", "vertices", || shading(drawn.mesh()), count))
    }
}

/// Extracts and fairs the surface of a lumen.
///
/// * `grey`: values that give crossings between voxels, where the selection is a threshold.
///
/// # Errors
/// The device's.
fn wall(
    device: &mut Device,
    grey: Option<GreyValues<'_>>,
    segmented: &Segmented,
    options: SurfaceOptions,
    clock: &mut Clock,
) -> Result<Wall, SessionError> {
    let Segmented { lumen, wall, options: segmentation, method, .. } = segmented;
    let relaxed = *method == WallMethod::Relaxed;
    let grey = grey.and_then(|grey| Grey::new(lumen, grey, &segmentation.selection));
    let mesh = clock.time(
        "surface",
        "faces",
        || match (wall, grey) {
            (Some(field), _) => stage::extract(lumen, &FieldCrossing { lumen, field }),
            (None, Some(grey)) => stage::extract(lumen, &grey),
            (None, _) => stage::extract(lumen, &Midpoint),
        },
        |mesh| mesh.faces.len() as u64,
    );
    let surface = clock.time(
        "topology",
        "faces",
        || Surface::of(mesh, lumen, options.track_from),
        |s| s.mesh.faces.len() as u64,
    );
    let Surface { mut mesh, adjacency, topology } = surface;
    mesh.normals = match (wall, options.smoothing) {
        (Some(field), Smoothing::Multiscale) => gradient_of(device, lumen, field, &mesh, clock)?,
        (_, smoothing) => {
            let grid = &lumen.grid;
            let lattice = VoxelFrame { direction: grid.direction, spacing_mm: grid.spacing_mm };
            smoothed_normals(device, (&mesh, &adjacency), lattice, smoothing, clock)?
        }
    };
    if relaxed {
        mesh.positions = relaxed_positions(device, lumen, (&mesh, &adjacency), clock)?;
    }
    let levels = match wall {
        Some(field) if field.stats.contrast.lumen < MAX_GAS_HU => {
            fluid_levels(&mesh, lumen.grid.spacing_mm.element_product().cbrt())
        }
        _ => Vec::new(),
    };
    Ok(Wall { mesh, topology, levels })
}

/// Positions of a halfway mesh's vertices after they have slid along their grid edges to where the
/// wall agrees with the mesh's smoothed normals.
///
/// # Errors
/// The device's; [`crate::surface::RelaxError`] for thick slices.
fn relaxed_positions(
    device: &mut Device,
    lumen: &Lumen,
    (mesh, adjacency): (&Mesh, &Adjacency),
    clock: &mut Clock,
) -> Result<Vec<Vec3>, SessionError> {
    let start = Instant::now();
    let input = stage::RelaxInput::new(mesh, lumen)?;
    let flat: Vec<f32> = mesh.normals.iter().flat_map(|n| n.to_array()).collect();
    let mut plan = Plan::new();
    let normals = plan.upload("normals", &flat);
    let s = stage::relax(&mut plan, adjacency, &input, normals);
    plan.download(s);
    let out = device.run(&plan)?;
    let positions = input.positions(&mesh.positions, out.get(s));
    let items = (mesh.positions.len() as u64, "vertices");
    clock.record_plan("relax", device.name(), start, items, &out);
    Ok(positions)
}

/// Normals of a mesh from the gradient of its wall field.
///
/// # Errors
/// The device's.
fn gradient_of(
    device: &mut Device,
    lumen: &Lumen,
    field: &WallField,
    mesh: &Mesh,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, SessionError> {
    let start = Instant::now();
    // What has no brick counts as 0 to a Gaussian: let that be far outside.
    let far = field.offset_mm.iter().copied().fold(0.0, f32::max);
    let offsets: Vec<f32> = field.offset_mm.par_iter().map(|o| o - far).collect();
    let mut plan = Plan::new();
    let f = smoothed_field(&mut plan, lumen, &offsets);
    plan.download(f);
    let out = device.run(&plan)?;
    let faces: Vec<Vec3> =
        stage::face_normals(mesh).chunks_exact(3).map(Vec3::from_slice).collect();
    let normals = field_normals(lumen, out.get(f), mesh, &faces);
    let items = (mesh.positions.len() as u64, "vertices");
    clock.record_plan("field normals", device.name(), start, items, &out);
    Ok(normals)
}

/// Smoothed normals of a mesh and its adjacency, from its face normals.
///
/// * `lattice`: the grid the mesh was taken from.
///
/// # Errors
/// The device's.
pub fn smoothed_normals(
    device: &mut Device,
    (mesh, adjacency): (&Mesh, &Adjacency),
    lattice: VoxelFrame,
    smoothing: Smoothing,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, SessionError> {
    let start = Instant::now();
    let mut plan = Plan::new();
    let (scales, normals, weights);
    let n = match smoothing {
        Smoothing::Multiscale => {
            scales = MultiscaleNormals::new(mesh, adjacency, lattice);
            stage::multiscale_normals(&mut plan, adjacency, &scales)
        }
        Smoothing::Steps(fairing) => {
            normals = stage::face_normals(mesh);
            weights = stage::weights(mesh, adjacency, fairing.weights);
            stage::fair(&mut plan, adjacency, &weights, &normals, fairing)
        }
    };
    plan.download(n);
    let out = device.run(&plan)?;
    clock.record_plan(
        "fair",
        device.name(),
        start,
        (mesh.positions.len() as u64, "vertices"),
        &out,
    );
    Ok(out.get(n).chunks_exact(3).map(Vec3::from_slice).collect())
}

/// Normals of a mesh from the gradient of a volume after a Gaussian: what normal smoothing is
/// compared with, and the better choice on isotropic binary data.
///
/// * `sigma_mm`: `None` takes 1.5 of the largest voxel spacing.
///
/// The gradient's sign is taken so that the mean normal agrees with the faces.
///
/// # Errors
/// The device's.
pub fn gradient_normals(
    device: &mut Device,
    mesh: &Mesh,
    volume: &Volume,
    sigma_mm: Option<f64>,
    clock: &mut Clock,
) -> Result<Vec<Vec3>, SessionError> {
    let h = volume.grid.spacing_mm;
    let sigma = sigma_mm.unwrap_or(1.5 * h.max_element());
    let most = 50.0 * h.min_element();
    if !(sigma > 0.0 && sigma <= most) {
        let allowed = format!("more than 0 and at most 50 voxels ({most} mm)");
        return Err(SettingError { name: "sigma", value: format!("{sigma} mm"), allowed }.into());
    }
    let start = Instant::now();
    let (bricks, values) = super::fields::volume_as_bricks(volume);
    let mut plan = Plan::new();
    let buffers = crate::field::LumenBuffers::new(&mut plan, &bricks);
    let f = plan.upload("values", &values);
    let f = crate::field::smooth(&mut plan, &buffers, f, sigma, Some(volume.grid.dims));
    plan.download(f);
    let out = device.run(&plan)?;
    let f = Sampler { lumen: &bricks, field: out.get(f) };
    let to_voxel = volume.grid.voxel_from_world();
    let faces = stage::face_normals(mesh);
    let top = volume.grid.dims.as_dvec3() - 1.0;
    let mut normals: Vec<Vec3> = mesh
        .positions
        .par_iter()
        .zip(faces.par_chunks_exact(3))
        .map(|(p, old)| {
            let v = to_voxel.transform_point3(p.as_dvec3());
            let at = |d: DVec3| f.at((v + d).clamp(DVec3::ZERO, top) * h);
            let g = DVec3::new(
                at(DVec3::X) - at(DVec3::NEG_X),
                at(DVec3::Y) - at(DVec3::NEG_Y),
                at(DVec3::Z) - at(DVec3::NEG_Z),
            ) / (2.0 * h);
            let g = volume.grid.direction * g;
            g.as_vec3().try_normalize().unwrap_or(Vec3::from_slice(old))
        })
        .collect();
    let agree: f64 = normals
        .iter()
        .zip(faces.chunks_exact(3))
        .map(|(n, f)| f64::from(n.dot(Vec3::from_slice(f))))
        .sum();
    if agree < 0.0 {
        normals.iter_mut().for_each(|n| *n = -*n);
    }
    let items = (mesh.positions.len() as u64, "vertices");
    clock.record_plan("gradient normals", device.name(), start, items, &out);
    Ok(normals)
}
