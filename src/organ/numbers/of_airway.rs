//! Numbers by which an airway is told: trachea, lungs, bronchi.

/// Numbers of `trachea.rs`.
pub mod trachea {
    /// Highest value of the trachea's air in a cross section, HU.
    pub const AIR_HU: f64 = -900.0;
    /// Areas of a trachea, mm².
    pub const AREA_MM2: std::ops::Range<f64> = 40.0..1500.0;
    /// Least circularity 4πA/P².
    pub const CIRCULARITY: f64 = 0.55;
    /// Longest axis over the shortest.
    pub const ASPECT: f64 = 2.2;
    /// The ring around a cross section where tissue is looked for: mm, or pixels where those are larger.
    pub const RING: std::ops::Range<f64> = 1.0..3.0;
    /// Least median value of the ring, HU.
    pub const RING_HU: f64 = -300.0;
    /// Ratio of the areas of neighbouring cross sections.
    pub const AREA_RATIO: std::ops::RangeInclusive<f64> = 0.5..=2.0;
    /// Shortest chain that is looked at, mm.
    pub const MIN_CHAIN_MM: f64 = 15.0;
    /// Most chains that are looked at across an axis.
    pub const MAX_CHAINS: usize = 4;
    /// Share of the radius in which a cross section is all air.
    pub const CORE: f64 = 0.6;
}

/// Numbers of `airway.rs`.
pub mod airway {
    /// Highest value of air and lung, HU.
    pub const LUNG_HU: f64 = -400.0;
    /// Least volume of the air and lung that the trachea opens into, ml …
    pub const MIN_LUNG_ML: f64 = 300.0;
    /// … and least share of it with the values of lung.
    pub const MIN_LUNG_SHARE: f64 = 0.5;
    /// The flood ends here, ml: no airway is larger.
    pub const MAX_FLOOD_ML: f64 = 400.0;
    /// Largest airway, ml.
    pub const MAX_AIRWAY_ML: f64 = 120.0;
    /// Least volume that joins in a step for the step to be judged a leak or not, ml …
    pub const JUDGED_ML: f64 = 1.0;
    /// … and, for it to be reported, least volume, ml, and least share of the tree before it.
    pub const JUMP_ML: f64 = 5.0;
    pub const JUMP_SHARE: f64 = 0.2;
    /// Least share of the boundary of bronchi that is wall. Measured: bronchi 0.66 to 0.93, lung 0.17.
    pub const MIN_WALLED: f64 = 0.45;
    /// Most of the lung that an airway fills: 0.015 of a whole chest.
    pub const MAX_FILLED: f64 = 0.15;
    /// Most noise of the air in the trachea, standard deviation in HU.
    pub const MAX_NOISE_HU: f64 = 140.0;
    /// Limits for a trachea without lung: most air joined to it, ml; its least and greatest length and its
    /// least and greatest radius, mm; the greatest variation of its cross sections; how near to the first or
    /// last slice of the scan it comes, mm; its least share of all the air that is joined to it.
    pub const MAX_SHORT_ML: f64 = 150.0;
    pub const MIN_SHORT_MM: f64 = 30.0;
    pub const MAX_SHORT_MM: f64 = 170.0;
    pub const MIN_SHORT_RADIUS_MM: f64 = 3.0;
    pub const SHORT_RADIUS_MM: f64 = 14.0;
    pub const SHORT_VARIATION: f64 = 0.4;
    pub const SHORT_FROM_END_MM: f64 = 15.0;
    pub const MIN_TRACHEA: f64 = 0.3;
    /// Least share of it that lies inside the body.
    pub const SHORT_INSIDE: f64 = 0.8;
    /// Least share of the air beside a trachea without lung on the side with less of it.
    pub const MIN_FORK_SIDE: f64 = 0.2;
    /// Thickness of slices, mm, from which there is doubt, from which thin bronchi are neither looked for
    /// nor kept, and greatest thickness; least radius of a bronchus in thick slices, in thicknesses.
    pub const DOUBTFUL_SLICE_MM: f64 = 4.0;
    pub const THICK_MM: f64 = 6.0;
    pub const MAX_SLICE_MM: f64 = 12.0;
    pub const THIN_PART: f64 = 0.25;
    /// Bronchi lie this far beside the trachea, mm. Where the side with less lung has this share of it,
    /// and the side with fewer bronchi less than this of them, the confidence is at most that.
    pub const BESIDE_MM: f64 = 25.0;
    pub const MIN_LUNG_SIDE: f64 = 0.2;
    pub const MIN_TREE_SIDE: f64 = 0.05;
    pub const ONE_SIDED: f64 = 0.3;
    /// Most chains that a refusal names.
    pub const LISTED: usize = 4;
    /// Share of the trachea's core that must have joined before a jump in volume counts as a leak.
    pub const JOINED: f64 = 0.95;
    /// Noise above which the volume is smoothed, standard deviation in HU.
    pub const NOISY_HU: f64 = 20.0;
    /// Standard deviations of the smoothing that is tried, in sides of the smallest voxel side.
    pub const SMOOTHING: [f64; 3] = [0.6, 0.9, 1.3];
}

/// Numbers of `lungs.rs`.
pub mod lungs {
    /// Volume above which a piece of gas is taken for lung, ml.
    pub const MIN_LUNG_ML: f64 = 200.0;
    /// Least volume of a core, ml.
    pub const MIN_CORE_ML: f64 = 15.0;
    /// Largest number of cores: labels are a byte.
    pub const MAX_CORES: usize = 254;
    /// Lungs hold blood: their mean lies this far above that of gas, HU. Emphysema begins at −950.
    pub const ABOVE_GAS_HU: f64 = 20.0;
}

/// Numbers of `walled.rs`.
pub mod walled {
    /// Least value of a wall, HU: a wall thinner than a voxel is mixed with the air on both sides, and
    /// lung lies below −700.
    pub const WALL_HU: f64 = -700.0;
    /// Length of the rays on which a wall is looked for, mm, and its bounds in voxels.
    pub const REACH_MM: f64 = 2.5;
    pub const REACH_VOXELS: std::ops::RangeInclusive<i32> = 2..=4;
}

/// Numbers of `branches.rs`.
pub mod branches {
    /// Layers from whose areas the greatest area of a branch follows.
    pub const FIRST_LAYERS: std::ops::Range<usize> = 2..8;
    /// Limit of the total area of a branch's fronts, in medians of it, and least such limit, mm².
    pub const MAX_GROWTH: f64 = 3.0;
    pub const MIN_LIMIT_MM2: f64 = 25.0;
    /// A front of voxels that share sides has this many times as many as its area needs.
    pub const LAYER_FACTOR: f64 = 1.3;
    /// Branches that end before this, mm, are roughness.
    pub const MIN_MM: f64 = 5.0;
}

/// Numbers of `bronchi.rs`.
pub mod bronchi {
    /// Largest rise of the threshold, and size of a step, HU.
    pub const RISE_HU: f64 = 160.0;
    pub const STEP_HU: f64 = 8.0;
    /// Largest piece that joins at one threshold, ml.
    pub const MAX_PIECE_ML: f64 = 0.25;
    /// Largest branch behind a narrow place, ml, and the least share of its boundary that is wall.
    pub const MAX_BRANCH_ML: f64 = 60.0;
    pub const MIN_WALLED: f64 = 0.6;
    /// A branch behind a narrow place is looked for at this number of thresholds, from the tree's
    /// threshold down, this far apart, HU: behind such a place lung may leak where the tree does not.
    pub const FALLS: usize = 8;
    pub const FALL_HU: f64 = 16.0;
    /// Volume of the smallest piece added, ml: smaller ones are roughness.
    pub const MIN_PIECE_ML: f64 = 0.01;
    /// Largest volume added, as a share of the tree: more than this is lung, found bit by bit.
    pub const MAX_ADDED: f64 = 0.5;
}
