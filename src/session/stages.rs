//! The table of stages: what each product needs, where it runs, what is shown while it does.
//!
//! To follow the data, read the table from the top. A row is used when its `when` holds for the
//! session's settings; exactly one row of each product does, or none.

use super::settings::{Lod, Settings};
use super::{Clock, Mode, Session, SessionError};

/// A result that a session can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Product {
    /// The volume the lumen is chosen from.
    Volume,
    /// The device that plans run on.
    Device,
    /// Hash of the volume's samples.
    Identity,
    /// Hash and geometry of the inputs, for the report.
    Inputs,
    /// The mask that decides which lumen is meant.
    Core,
    /// Bricks and classes of the lumen, and its wall field.
    Lumen,
    /// Exact distance to the wall.
    Distance,
    /// Distance and smoothed distance, in paper mode ridge candidates too, in one plan.
    Fields,
    /// The centred route: path or tree.
    Route,
    /// Which boundary voxels the viewpoints see.
    Visibility,
    /// Route and visibility test together.
    Centerline,
    /// The surface with its normals.
    Wall,
    /// What is drawn of the wall: with or without caps.
    DrawnWall,
    /// Vertices with curvature tint.
    Shading,
    /// Triangles of the wall by place.
    TriangleTree,
    /// Triangles by place of what is drawn of the wall.
    DrawnTree,
    /// Triangles of the wall in buckets.
    WallIndex,
    /// Space outside a watertight wall.
    Exterior,
    /// Clusters of the wall at every level.
    Clusters,
    /// The wall at many levels, ready to be refined.
    Levels,
    /// Poses of the flight.
    Flight,
    /// The renderer on its device.
    Display,
    /// What the frames saw of the wall.
    Coverage,
    /// Cross-sections along the flight.
    Sections,
    /// The simplified wall.
    Base,
}

/// How many products there are.
pub(super) const PRODUCTS: usize = Product::Base as usize + 1;

/// Where a stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunsOn {
    /// Worker threads.
    Cpu,
    /// The device that plans run on, and only one such stage at a time.
    Device,
}

/// One row of the table.
pub struct Stage {
    /// What it makes.
    pub product: Product,
    /// What has to be there before it starts.
    pub needs: &'static [Product],
    /// Where it runs.
    pub runs_on: RunsOn,
    /// What is shown while it runs.
    pub label: &'static str,
    /// Its usual share of a run without frames, per cent: for progress only.
    pub weight: f32,
    /// Whether these settings use this row.
    pub when: fn(&Settings) -> bool,
    pub(super) run: fn(&Session, &mut Clock) -> Result<(), SessionError>,
}

fn always(_: &Settings) -> bool {
    true
}

fn default_mode(s: &Settings) -> bool {
    s.mode == Mode::Default
}

fn paper_mode(s: &Settings) -> bool {
    s.mode == Mode::Paper
}

fn clusters(s: &Settings) -> bool {
    s.drawn_lod() == Lod::Clusters
}

fn subdivision(s: &Settings) -> bool {
    s.drawn_lod() == Lod::Vds
}

fn base_from_clusters(s: &Settings) -> bool {
    clusters(s) && default_mode(s)
}

fn base_from_wall(s: &Settings) -> bool {
    !base_from_clusters(s)
}

macro_rules! stages {
    ($($product:ident $needs:tt $on:ident $label:literal $weight:literal $when:ident $run:ident;)*) => {
        &[$(Stage {
            product: Product::$product,
            needs: stages!(@needs $needs),
            runs_on: RunsOn::$on,
            label: $label,
            weight: $weight,
            when: $when,
            run: Session::$run,
        }),*]
    };
    (@needs [$($need:ident)*]) => { &[$(Product::$need),*] };
}

/// All stages. Where several could start, the upper one does: what others wait for longest stands
/// above what few need.
pub static STAGES: &[Stage] = stages! {
    // product  needs                                  runs on  shown                   % when            run
    Volume      []                                      Cpu     "reading"               4.0 always        run_volume;
    Device      []                                      Cpu     "opening the device"    1.0 always        run_device;
    Core        [Volume]                                Cpu     "segmentation"          2.0 always        run_core;
    Lumen       [Core Volume Device]                    Device  "wall field"            3.0 always        run_lumen;
    Distance    [Lumen Device]                          Device  "distance field"        3.0 always        run_distance;
    Fields      [Lumen Device]                          Device  "distance fields"       6.0 always        run_fields;
    Display     [Device]                                Cpu     "opening the renderer"  1.0 always        run_display;
    Route       [Lumen Fields]                          Cpu     "centerline"           15.0 default_mode  run_route;
    Visibility  [Lumen Fields Route Device]             Device  "visibility"            5.0 default_mode  run_visibility;
    Wall        [Lumen Volume Device]                   Device  "surface and normals"   8.0 always        run_wall;
    Identity    [Volume]                                Cpu     "hashing the input"     1.0 always        run_identity;
    Inputs      [Volume Identity]                       Cpu     "hashing the input"     0.1 always        run_inputs;
    Centerline  [Lumen Fields Route Visibility]         Cpu     "centerline"            0.1 default_mode  run_centerline;
    Centerline  [Lumen Fields Device]                   Device  "centerline (paper)"   30.0 paper_mode    run_paper_centerline;
    DrawnWall   [Wall]                                  Cpu     "surface"               0.1 always        run_drawn_wall;
    Shading     [DrawnWall]                             Cpu     "curvature tint"        1.0 always        run_shading;
    TriangleTree [Wall]                                 Cpu     "triangle tree"         0.5 always        run_triangle_tree;
    DrawnTree   [DrawnWall TriangleTree]                Cpu     "triangle tree"         0.1 clusters      run_drawn_tree;
    Clusters    [DrawnWall Shading DrawnTree]           Cpu     "levels of detail"     25.0 clusters      run_clusters;
    WallIndex   [Wall]                                  Cpu     "wall index"            0.5 always        run_wall_index;
    Flight      [Lumen Fields Centerline Wall WallIndex] Cpu    "flight"                1.0 always        run_flight;
    Exterior    [Wall]                                  Cpu     "occlusion grid"        1.0 always        run_exterior;
    Levels      [DrawnWall Shading Clusters Exterior]   Cpu     "levels of detail"      0.1 clusters      run_cluster_levels;
    Levels      [DrawnWall Shading]                     Cpu     "subdivision"          25.0 subdivision   run_subdivision_levels;
    Base        [Wall Clusters]                         Cpu     "simplified surface"    3.0 base_from_clusters run_base_from_clusters;
    Base        [Wall]                                  Cpu     "simplified surface"   10.0 base_from_wall run_base_from_wall;
    Coverage    [Wall Flight TriangleTree Exterior]     Cpu     "coverage"              5.0 always        run_coverage;
    Sections    [Wall TriangleTree Centerline Flight]   Cpu     "sections"              0.5 always        run_sections;
};

/// The row that makes a product with these settings.
///
/// # Errors
/// [`SessionError::Unavailable`] where none does.
pub(super) fn row(product: Product, settings: &Settings) -> Result<&'static Stage, SessionError> {
    let mut rows = STAGES.iter().filter(|s| s.product == product);
    let label = rows.clone().next().map_or("", |s| s.label);
    rows.find(|s| (s.when)(settings))
        .ok_or_else(|| SessionError::Unavailable { product: label, settings: settings.deciding() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::View;

    fn all_settings() -> impl Iterator<Item = Settings> {
        let modes = [Mode::Default, Mode::Paper];
        let lods = [Lod::Clusters, Lod::Vds, Lod::Off];
        let views = [View::Inside, View::Overview];
        modes.into_iter().flat_map(move |mode| {
            lods.into_iter().flat_map(move |lod| {
                views.into_iter().map(move |view| {
                    let mut s = Settings { mode, ..Settings::default() };
                    s.levels.lod = lod;
                    s.flight.view = view;
                    s
                })
            })
        })
    }

    #[test]
    fn every_need_is_made_by_a_row_above_under_the_same_settings() {
        for settings in all_settings() {
            let used: Vec<&Stage> = STAGES.iter().filter(|s| (s.when)(&settings)).collect();
            for (i, stage) in used.iter().enumerate() {
                assert!(
                    !used[..i].iter().any(|s| s.product == stage.product),
                    "{:?}",
                    stage.product
                );
                for need in stage.needs {
                    let above = used[..i].iter().any(|s| s.product == *need);
                    assert!(above, "{:?} needs {need:?} ({settings:?})", stage.product);
                }
            }
        }
    }
}
