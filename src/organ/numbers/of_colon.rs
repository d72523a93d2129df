//! Numbers by which a colon is told: gas, its names, fluid.

/// Numbers of `gas.rs`.
pub mod gas {
    /// Highest value of gas, HU.
    pub const GAS_HU: f64 = -800.0;
    /// Highest value of gas away from walls, HU.
    pub const DEEP_GAS_HU: f64 = -900.0;
    /// Least volume of a segment, ml.
    pub const MIN_ML: f64 = 15.0;
    /// Least value of the tissue that encloses the colon, HU.
    pub const TISSUE_HU: f64 = -300.0;
    /// Share of a piece's height that is its top.
    pub const TOP_SHARE: f64 = 0.2;
}

/// Numbers of `colon.rs`.
pub mod colon {
    /// Least volume of all segments, ml: sinuses and a trachea hold less.
    pub const MIN_TOTAL_ML: f64 = 60.0;
    /// Least extent of the longest segment, mm.
    pub const MIN_EXTENT_MM: f64 = 50.0;
    /// Segments grow to here, HU, by so many voxels: half way between gas and tissue.
    pub const WALL_HU: f64 = -450.0;
    pub const WALL_VOXELS: usize = 2;
    /// Longest voxel side at which a fold can be told from the gas beside it, mm: folds are about as thick.
    pub const FOLD_MM: f64 = 3.0;
    /// Confidence at most where a segment may be stomach.
    pub const DOUBTFUL: f64 = 0.3;
    /// Most pieces of gas that a message names.
    pub const MAX_NAMED: usize = 4;
}

/// Numbers of `colon_order.rs`.
pub mod colon_order {
    /// Most places of a segment's rim that distances to it are taken from.
    pub const RIM_PLACES: usize = 1000;
    /// Step along a gap, mm.
    pub const STEP_MM: f64 = 0.5;
}

/// Numbers of `fluid.rs`.
pub mod fluid {
    /// Least value at which fluid is looked for, HU.
    pub const FLUID_HU: f64 = 200.0;
    /// Soft tissue, HU: the threshold lies half way between it and the fluid.
    pub const SOFT_TISSUE_HU: f64 = 40.0;
    /// Largest distance below gas at which fluid begins, voxels: in between lie mixed values.
    pub const LAYER_VOXELS: i32 = 3;
    /// Least area in which a pool meets the gas, mm² …
    pub const MIN_CONTACT_MM2: f64 = 100.0;
    /// … and least share of its top: bones and small bowel only touch.
    pub const MIN_CONTACT_SHARE: f64 = 0.25;
}
