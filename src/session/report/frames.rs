//! Report of frames, and of the wall that they show.

use serde::Serialize;

/// Frames that were drawn.
#[derive(Clone, Debug, Serialize)]
pub struct FramesReport {
    /// Frames.
    pub count: usize,
    /// Pixels of a row.
    pub width: u32,
    /// Rows of pixels.
    pub height: u32,
    /// Median time of a frame.
    pub p50_ms: f64,
    /// Time that 99 % of the frames stay below.
    pub p99_ms: f64,
    /// Triangles drawn a frame, median.
    pub triangles_p50: u64,
    /// Triangles drawn a frame, 99th percentile.
    pub triangles_p99: u64,
    /// Time from the first frame to the last.
    pub total_ms: f64,
    /// Smallest distance between the near plane's ball and the wall over all frames.
    pub min_near_clearance_mm: f64,
    /// Duration of the flight.
    pub flight_seconds: f64,
    /// Frames that begin another piece of the lumen, or another branch: the eye jumps there.
    pub cuts: Vec<usize>,
    /// Name of the device that drew.
    pub device: String,
}

/// Wall seen by the frames of the flight.
#[derive(Clone, Debug, Serialize)]
pub struct CoverageReport {
    /// Flight whose cameras saw it.
    pub of: CoveredFlight,
    /// Share seen by the flight as it was flown.
    pub one_way_fraction: f64,
    /// Share seen by it or by the same flight in the other direction.
    pub both_ways_fraction: f64,
    /// Quantity of which the shares are.
    pub by: &'static str,
    /// Area of the wall.
    pub area_mm2: f64,
    /// Connected patches that neither direction saw, largest first.
    pub patches: Vec<PatchReport>,
    /// Patches of at least this area are listed.
    pub listed_from_mm2: f64,
    /// Patches smaller than that, and their area together.
    pub smaller_patches: usize,
    /// Area of those patches.
    pub smaller_patches_mm2: f64,
}

/// A flight along which coverage was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoveredFlight {
    /// Branches that it follows: `trunk`, `all`, or `leaf:` with a number; `path` of cameras that
    /// were given.
    pub route: String,
    /// Whether it goes from the end to the start.
    pub reverse: bool,
    /// Number of its cameras.
    pub cameras: usize,
    /// Vertical field of view of the first, degrees; 360 where each sees everything about it.
    pub field_of_view_deg: f64,
}

/// A patch that was missed.
#[derive(Clone, Debug, Serialize)]
pub struct PatchReport {
    /// Area of the patch.
    pub area_mm2: f64,
    /// Centre of the patch, LPS.
    pub center_mm: [f64; 3],
    /// Arc length of the path nearest to its centre, mm.
    pub arc_mm: f64,
}
