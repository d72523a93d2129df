//! The table of products and stages: what each product is, what it needs, where it is made.
//!
//! Read the table from the top to follow the data. A product stands below the products that it needs. It
//! has one row for each way to make it. For given settings at most one row of a product has a true
//! condition, and that row is used.
//!
//! A row of `products!` is: name, share of the time, products it needs, settings it reads, where it
//! runs, condition, function. If one of these settings changes, the product is made again.

use std::sync::Arc;

use super::frames::Display;
use super::load::{Inputs, Loaded};
use super::settings::{Lod, Settings};
use super::{
    Centered, Clock, Core, Exterior, Fields, Levels, Mode, OpenDevice, Segmented, Session,
    SessionError, ShownWall, Slot, Visibility, Wall, locked, put,
};
use crate::behind::BehindWall;
use crate::centerline::Routed;
use crate::compute::{Array, Kernel};
use crate::flight::CenterlineDistances;
use crate::flight::{Coverage, Flight, LumenProfile, SectionFigures};
use crate::geometry::{Mesh, TriangleBvh};
use crate::render::PreparedMesh;
use crate::surface::Shading;
use crate::wall::{Evidence, WallSpline};

/// Processor that a stage runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunsOn {
    /// Worker threads.
    Cpu,
    /// The device that plans run on, and only one such stage at a time.
    Device,
}

/// One row of the table.
pub struct Stage {
    /// Product of the stage.
    pub product: Product,
    /// Products that it needs before it starts.
    pub needs: &'static [Product],
    /// Processor that it runs on.
    pub runs_on: RunsOn,
    /// Name of the stage, shown while it runs, in reports and in `bench`. If a stage is timed in several
    /// steps, one of the steps has this name.
    pub name: &'static str,
    /// Usual share of the run time, per cent, without frames. Used for progress only.
    pub weight: f32,
    /// Whether these settings use this row.
    pub when: fn(&Settings) -> bool,
    /// Whether the settings that the stage reads are the same in both.
    pub(super) same: fn(&Settings, &Settings) -> bool,
    pub(super) run: fn(&Session, &mut Clock) -> Result<(), SessionError>,
}

fn always(_: &Settings) -> bool {
    true
}

fn is_default_mode(s: &Settings) -> bool {
    s.mode == Mode::Default
}

fn is_paper_mode(s: &Settings) -> bool {
    s.mode == Mode::Paper
}

fn has_organ(s: &Settings) -> bool {
    s.lumen.organ.is_some()
}

fn has_no_organ(s: &Settings) -> bool {
    !has_organ(s)
}

fn draws_subdivision(s: &Settings) -> bool {
    s.drawn_lod() == Lod::Vds
}

fn draws_whole_wall(s: &Settings) -> bool {
    !draws_subdivision(s) && !draws_refined_wall(s)
}

fn draws_refined_wall(s: &Settings) -> bool {
    s.drawn_lod() == Lod::Auto
}

fn draws_mesh_or_subdivision(s: &Settings) -> bool {
    !draws_refined_wall(s)
}

/// Makes the products, their slots and getters, and the stages.
///
/// `PRODUCT slot: TYPE = STAGE | STAGE …;` where a stage is its name, share of the time, needs,
/// settings it reads, place, condition, and the function that returns the product.
macro_rules! products {
    ($($(#[$doc:meta])* $vis:vis $product:ident $slot:ident: $kind:ty =
        $($name:literal $weight:literal $needs:tt $reads:tt $on:ident $when:ident $run:ident)|+;)*) => {
        /// A result that a session can be asked for.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Product {
            $($(#[$doc])* $product,)*
        }

        impl Product {
            /// All of them, in the order of the table.
            pub const ALL: &[Self] = &[$(Self::$product),*];
        }

        /// Snapshot of the products of a session.
        #[derive(Clone, Default)]
        pub struct Products {
            $($(#[$doc])* $vis $slot: Option<Arc<$kind>>,)*
        }

        impl Products {
            /// Whether the snapshot holds a product.
            pub fn has(&self, product: Product) -> bool {
                match product {
                    $(Product::$product => self.$slot.is_some(),)*
                }
            }
        }

        /// Storage of a session: one slot per product.
        #[derive(Default)]
        pub(super) struct Slots {
            $(pub $slot: Slot<$kind>,)*
        }

        impl Slots {
            /// Empties the slot of a product.
            pub fn forget(&self, product: Product) {
                match product {
                    $(Product::$product => drop(locked(&self.$slot).take()),)*
                }
            }

            /// Copies a product, or its absence, from another session. Returns whether the other session
            /// has it.
            pub fn share(&self, other: &Self, product: Product) -> bool {
                match product {
                    $(Product::$product => {
                        let value = locked(&other.$slot).clone();
                        let has = value.is_some();
                        *locked(&self.$slot) = value;
                        has
                    })*
                }
            }
        }

        impl Session {
            /// Returns a snapshot of the requested products that exist. If it holds a product, it also
            /// holds the requested products that this product was made from. Never waits.
            pub fn products(&self, requested: &[Product]) -> Products {
                let mut there = Products::default();
                // From the bottom of the table: what a product needs was there before it.
                for product in Product::ALL.iter().rev().filter(|p| requested.contains(p)) {
                    match product {
                        $(Product::$product => {
                            there.$slot = locked(&self.slots.$slot).clone();
                        })*
                    }
                }
                there
            }

            $($(#[$doc])*
            ///
            /// # Errors
            /// The error of the stage that failed; [`SessionError::Cancelled`];
            /// [`SessionError::Unavailable`] if the settings leave it out.
            // Some products are for stages alone.
            #[allow(dead_code)]
            $vis fn $slot(&self) -> Result<Arc<$kind>, SessionError> {
                self.product(Product::$product, &self.slots.$slot)
            })*
        }

        /// All stages. If several stages can start, the uppermost starts first. So a stage that holds up
        /// many others stands high in the table.
        pub static STAGES: &[Stage] = &[$($(Stage {
            product: Product::$product,
            needs: products!(@needs $needs),
            runs_on: RunsOn::$on,
            name: $name,
            weight: $weight,
            when: $when,
            same: products!(@same $reads),
            run: |session, clock| {
                put(&session.slots.$slot, session.$run(clock)?);
                Ok(())
            },
        }),+),*];
    };
    (@needs [$($need:ident)*]) => { &[$(Product::$need),*] };
    (@same ()) => { |_, _| true };
    (@same ($($group:ident $(. $field:ident)?),+)) => {
        |a, b| $(a.$group $(.$field)? == b.$group $(.$field)?)&&+
    };
}

products! {
    /// The volume the lumen is chosen from, with what reading it found.
    pub(super) Volume loaded: Loaded =
        "read" 4.0 [] () Cpu always run_volume;
    /// The device that plans run on.
    pub Device device: OpenDevice =
        "device" 1.0 [] (device) Cpu always run_device;
    /// The mask that decides which lumen is meant.
    pub Core core: Core =
        "segment" 2.0 [Volume] (lumen.select, lumen.seed, lumen.all_components, lumen.fill,
            lumen.leak_control) Cpu has_no_organ run_core
        | "organ" 30.0 [Volume] (lumen.organ, lumen.fill) Cpu has_organ run_core;
    /// The lumen in bricks, with what choosing it found, and its wall field.
    pub Lumen lumen: Segmented =
        "wall field" 3.0 [Core Volume Device] (mode, lumen.wall, wall.from_mask) Device always run_lumen;
    /// Exact distance to the nearest external voxel centre, mm, in slot order of the lumen.
    pub Distance distance: Array<f32> =
        "distance" 3.0 [Lumen Device] () Device always run_distance;
    /// Distance and smoothed distance, and in paper mode the ridge, in one plan.
    pub Fields fields: Fields =
        "distance, smooth" 6.0 [Lumen Device] () Device is_default_mode run_fields
        | "distance, ridge" 6.0 [Lumen Device] () Device is_paper_mode run_ridge_fields;
    /// The renderer on its device.
    pub(super) Display display: Display =
        "renderer" 1.0 [Device] (flight.size, flight.antialiasing) Cpu always run_display;
    /// The centred route: path or tree.
    pub(super) Route route: Routed =
        "route" 15.0 [Lumen Fields] (centerline.from, centerline.to, centerline.tree, centerline.loops) Cpu is_default_mode run_route;
    /// Outcome of the visibility test, with the boundary voxels that no viewpoint sees.
    pub(super) Visibility visibility: Visibility =
        "visibility" 5.0 [Lumen Fields Route Device] () Device is_default_mode run_visibility;
    /// The wall with smoothed normals, LPS mm.
    pub Wall wall: Wall =
        "surface" 8.0 [Lumen Volume Device] (mode, wall.from_mask, wall.smoothing) Device always run_wall;
    /// The wall's triangles by place: for rays, nearest points and planes.
    pub TriangleTree triangle_tree: TriangleBvh =
        "triangle tree" 0.5 [Wall] () Cpu always run_triangle_tree;
    /// BLAKE3 of the samples of the volume the lumen is chosen from, in hexadecimal.
    pub Identity identity: String =
        "hash" 1.0 [Volume] () Cpu always run_identity;
    /// Smallest and largest value of the volume; `None` where it has none.
    pub ValueRange value_range: Option<(f64, f64)> =
        "value range" 0.2 [Volume] () Cpu always run_value_range;
    /// Hash and geometry of the inputs, for the report.
    pub(super) Inputs inputs: Inputs =
        "inputs" 0.1 [Volume Identity] () Cpu always run_inputs;
    /// Path or tree, centred and proven inside, with the visibility test.
    pub Centerline centerline: Centered =
        "centerline" 0.1 [Lumen Route Visibility TriangleTree] (mode) Cpu is_default_mode run_centerline
        | "paper path" 30.0 [Lumen Fields Device TriangleTree] (centerline) Device is_paper_mode run_paper_centerline;
    /// The wall as shown: with or without caps.
    pub(super) ShownWall shown_wall: ShownWall =
        "shown wall" 0.1 [Wall] (wall.open_ends) Cpu always run_shown_wall;
    /// The wall with all its vertices, ready for a device; with or without caps.
    pub PreparedWall prepared_wall: PreparedMesh =
        "prepared wall" 1.0 [Wall] (wall.open_ends) Cpu always run_prepared_wall;
    /// Evidence of the wall at each vertex; `None` where it does not follow grey values.
    pub Evidence evidence: Option<Vec<Evidence>> =
        "evidence" 0.2 [Lumen Wall] () Cpu always run_evidence;
    /// Vertices with curvature tint.
    pub(super) Shading shading: Shading =
        "shading" 1.0 [ShownWall] () Cpu always run_shading;
    /// Space outside the wall, where it is watertight.
    pub Exterior exterior: Exterior =
        "outside" 1.0 [Wall] () Cpu always run_exterior;
    /// The wall as the zero of a spline; known nowhere if no wall field placed it.
    pub Spline spline: WallSpline =
        "smooth wall" 1.0 [Lumen ShownWall] () Cpu always run_spline;
    /// The wall in the form in which frames draw it (a [`DrawnWall`](crate::lod::DrawnWall)).
    pub Levels levels: Levels =
        "octree" 0.3 [ShownWall Exterior] (levels.lod) Cpu draws_whole_wall run_whole_levels
        | "refined wall" 0.5 [Lumen Spline ShownWall Shading Exterior] (mode, levels.lod, levels.pixel_error) Cpu draws_refined_wall run_refined_levels
        | "subdivision" 25.0 [Lumen ShownWall Shading TriangleTree Exterior] (mode, levels.scheme, levels.pixel_error) Cpu draws_subdivision run_subdivision_levels;
    /// Poses of the flight along the first path.
    pub Flight flight: Flight =
        "flight" 1.0 [Lumen Fields Centerline TriangleTree Levels] (mode, levels.lod, flight.frames, flight.size, flight.view, flight.fov_y_rad,
            flight.reverse, flight.route, flight.script, flight.script_frames) Cpu draws_refined_wall run_flight_by_refined_wall
        | "flight" 1.0 [Lumen Fields Centerline TriangleTree] (mode, levels.lod, flight.frames, flight.size, flight.view, flight.fov_y_rad,
            flight.reverse, flight.route, flight.script, flight.script_frames) Cpu draws_mesh_or_subdivision run_flight;
    /// The tissue behind the wall.
    pub Behind behind: BehindWall =
        "behind the wall" 2.0 [Volume Lumen TriangleTree] (lumen.organ, flight.behind_mm) Cpu always run_behind;
    /// The wall with few faces.
    pub Base base: Mesh =
        "base" 10.0 [Wall] (mode, wall.base_faces) Cpu always run_base;
    /// Coverage of the wall by the frames of the flight, weighted by area.
    pub Coverage coverage: Coverage =
        "coverage" 60.0 [Wall Flight TriangleTree Exterior] (flight.view) Cpu always run_coverage;
    /// Cross-sections of the lumen along the flight, one a pose.
    pub Sections sections: Vec<Option<SectionFigures>> =
        "sections" 0.5 [Wall TriangleTree Centerline Flight] () Cpu always run_sections;
    /// Radius and cross-section along the path, with the narrowest places.
    pub LumenProfile lumen_profile: LumenProfile =
        "profile" 0.5 [Wall TriangleTree Centerline] (flight.route, flight.reverse) Cpu always run_lumen_profile;
    /// Distances of the wall's vertices from the centerline.
    pub CenterlineDistances centerline_distances: CenterlineDistances =
        "centerline distances" 0.5 [Wall TriangleTree Centerline] () Cpu always run_centerline_distances;
}

/// Returns all kernels: those of the stages, and the copy kernel that measures the speed of a device.
pub fn kernels() -> impl Iterator<Item = &'static Kernel> {
    crate::kernels::ALL.iter().chain(crate::paper::kernels::ALL).copied()
}

/// Number of products.
pub(super) const PRODUCTS: usize = Product::ALL.len();

/// The row that makes a product with these settings.
///
/// # Errors
/// [`SessionError::Unavailable`] if the settings leave the product out.
pub(super) fn row(product: Product, settings: &Settings) -> Result<&'static Stage, SessionError> {
    let used = STAGES.iter().find(|stage| stage.product == product && (stage.when)(settings));
    used.ok_or_else(|| SessionError::Unavailable { product, settings: settings.deciding() })
}

/// Returns these products and all that the settings make from them.
pub(super) fn with_dependents(mut products: Vec<Product>, settings: &Settings) -> Vec<Product> {
    // Rows stand below what they need, so one pass finds all that follows.
    for stage in STAGES.iter().filter(|s| (s.when)(settings)) {
        let follows = stage.needs.iter().any(|need| products.contains(need));
        if follows && !products.contains(&stage.product) {
            products.push(stage.product);
        }
    }
    products
}

/// Returns the products that must be made again when the settings of a session change.
pub(super) fn stale(before: &Settings, after: &Settings) -> Vec<Product> {
    let is_unchanged = |product: &Product| match (row(*product, before), row(*product, after)) {
        (Ok(a), Ok(b)) => std::ptr::eq(a, b) && (a.same)(before, after),
        (Err(_), Err(_)) => true,
        _ => false,
    };
    let changed = Product::ALL.iter().copied().filter(|p| !is_unchanged(p)).collect();
    with_dependents(changed, after)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::device::DeviceChoice;
    use crate::lumen::IntensitySelection;
    use crate::render::View;
    use crate::session::{Source, VolumeSource};
    use crate::volume::Volume;
    use crate::volume::phantom::{Kind, Phantom};

    /// Names of the stages in the report of a session that makes everything but frames.
    fn reported(volume: Volume, mut settings: Settings) -> Vec<&'static str> {
        settings.device = DeviceChoice::Cpu;
        let source = Source::Image(VolumeSource::Memory(Arc::new(volume)));
        let session = Session::new(source, settings).unwrap();
        let has_values = session.settings().lumen.select.is_some();
        let is_made = |s: &&Stage| {
            (s.when)(session.settings()) && (has_values || s.product != Product::Behind)
        };
        let made = STAGES.iter().filter(is_made);
        // One by one, so that the distance is made without the other fields.
        for stage in made.filter(|s| s.product != Product::Display) {
            session.prepare(&[stage.product]).unwrap();
        }
        session.clock().stages.iter().map(|s| s.name).collect()
    }

    #[test]
    fn a_stage_has_the_same_name_in_table_and_report() {
        // They take no time worth a row of the report, or need another input.
        const NOT_REPORTED: [&str; 7] =
            ["device", "organ", "renderer", "hash", "inputs", "centerline", "shown wall"];
        let bend = Phantom::new(Kind::Bend, 32, [1.0; 3]).unwrap();
        let mut grey = Settings::default();
        grey.lumen.select = Some(IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 });
        let mut paper = Settings { mode: Mode::Paper, ..Settings::default() };
        paper.levels.lod = Lod::Vds;
        let mut culled = Settings::default();
        culled.levels.lod = Lod::Culled;
        let mut names = reported(bend.grey(None, 1), grey);
        names.extend(reported(bend.mask(), culled));
        names.extend(reported(bend.mask(), Settings::default()));
        names.extend(reported(bend.mask(), paper));
        for stage in STAGES.iter().filter(|s| !NOT_REPORTED.contains(&s.name)) {
            assert!(names.contains(&stage.name), "{} is not in {names:?}", stage.name);
        }
    }

    fn all_settings() -> impl Iterator<Item = Settings> {
        let modes = [Mode::Default, Mode::Paper];
        let lods = [Lod::Auto, Lod::Vds, Lod::Culled, Lod::Off];
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
