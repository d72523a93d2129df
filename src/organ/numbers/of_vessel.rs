//! Numbers by which a vessel is told: aorta, vertebrae, arteries.

/// Numbers of `vessel.rs`.
pub mod vessel {
    /// A volume with values below this is a CT in HU with air in it.
    pub const CT_HU: f64 = -500.0;
    /// Least number of slices along each axis: less shows no tree.
    pub const MIN_SIDE: u32 = 12;
    /// Most of a volume that vessels fill.
    pub const MAX_SHARE: f64 = 0.1;
    /// Least length in radii of the widest place.
    pub const MIN_RADII: f64 = 8.0;
    /// Least share of the tree's voxels that are not on its surface: below it the vessels are a voxel
    /// wide, and joined by chance.
    pub const MIN_INNER: f64 = 0.1;
    /// Least length, mm: a pool of tagged fluid is shorter.
    pub const MIN_MM: f64 = 60.0;
    /// Largest volume of vessels, and volume up to which confidence is 1, ml: a heart, a liver or bones
    /// hold more.
    pub const MAX_ML: f64 = 500.0;
    pub const SURE_ML: f64 = 250.0;
    /// Least number of different values of an image: a label map has fewer.
    pub const MIN_VALUES: usize = 16;
    /// Largest share of a mask's inner voxels that equal all their neighbours: it is 0.85 in a label
    /// map, and 0.44 in an angiogram whose brightest values were clipped.
    pub const MAX_FLAT: f64 = 0.65;
    /// Largest value of a background that was removed, as a share of the peak.
    pub const ZEROED: f64 = 0.1;
    /// Largest distance of the median from zero, as a share of the peak, where noise or the ringing of
    /// resampling came after the background was set to zero.
    pub const NEAR_ZERO: f64 = 0.02;
    /// Number of bins of a histogram.
    pub const BINS: usize = 1024;
}

/// Numbers of `arteries.rs`.
pub mod arteries {
    /// Soft tissue, HU: thresholds of a CT lie between it and the blood, half way in the aorta and so far
    /// in its branches, which organs with contrast medium surround.
    pub const SOFT_TISSUE_HU: f64 = 45.0;
    pub const TUBE_PART: f64 = 0.5;
    pub const BRANCH_PART: f64 = 0.75;
    /// Bone is brighter than blood by this, HU, and by so many standard deviations of the noise;
    /// voxels nearer to it than this, mm, are mixed with it.
    pub const BONE_ABOVE_HU: f64 = 120.0;
    pub const BONE_DEVIATIONS: f64 = 4.0;
    pub const BONE_RIM_MM: f64 = 2.0;
    /// Least piece of bone, ml; gaps in its cortex that are closed, mm; largest marrow or canal that it
    /// encloses in a slice, mm²: the ring of the pelvis encloses more.
    pub const BONE_ML: f64 = 0.5;
    pub const BONE_GAP_MM: f64 = 3.0;
    pub const BONE_HOLE_MM2: f64 = 3000.0;
    /// The aorta lies within this many of its radii about the middle of its sections, and a voxel more.
    pub const TUBE_RADII: f64 = 1.15;
    /// Greatest area of a branch and of the arch, in areas of the aorta.
    pub const BRANCH_AREAS: f64 = 0.6;
    pub const ARCH_AREAS: f64 = 1.6;
    /// Noise above which branches are followed in a smoothed copy, HU, and its Gaussian in sides of the
    /// smallest voxel side; most noise.
    pub const NOISY_HU: f64 = 15.0;
    pub const SMOOTHING: f64 = 0.9;
    pub const MAX_NOISE_HU: f64 = 120.0;
    /// Least share of the mask that is aorta: the rest are its branches.
    pub const MIN_TUBE: f64 = 0.2;
    /// Confidence of a chain's shape and place from which no other is looked at.
    pub const SURE_PLACE: f64 = 0.5;
    /// Confidence at most where no spine is seen.
    pub const NO_SPINE: f64 = 0.4;
    /// Confidence at most where its sections are not of one value.
    pub const UNEVEN: f64 = 0.4;
    /// Most chains that a refusal names.
    pub const LISTED: usize = 3;
}

/// Numbers of `aorta.rs`.
pub mod aorta {
    /// Voxel sides of the coarse copy, mm, about.
    pub const COARSE_MM: f64 = 1.5;
    /// Noise of the coarse copy from which on it is smoothed, HU: sections are even to twice that. Gaussian,
    /// in sides of the smallest voxel side.
    pub const NOISY_HU: f64 = 25.0;
    pub const SMOOTHING: f64 = 0.9;
    /// Thresholds that are tried, HU.
    pub const LEVELS_HU: [f64; 10] = [90., 110., 130., 150., 180., 220., 270., 330., 400., 500.];
    /// Areas of an aorta, mm².
    pub const AREA_MM2: std::ops::Range<f64> = 60.0..1800.0;
    /// Least circularity 4πA/P², and longest axis over the shortest.
    pub const CIRCULARITY: f64 = 0.7;
    pub const ASPECT: f64 = 1.7;
    /// Most of a section that may be holes.
    pub const HOLES: f64 = 0.05;
    /// Largest standard deviation of a section's values, and largest median, HU.
    pub const MAX_SPREAD_HU: f64 = 40.0;
    pub const MAX_BLOOD_HU: f64 = 700.0;
    /// Least share of a parted section's values that lie within the largest deviation about their median.
    pub const MIN_ALIKE: f64 = 0.5;
    /// Inner and outer distance of the ring about a section, mm or pixels, and least difference of the
    /// section's median from the ring's, HU.
    pub const RING: std::ops::Range<f64> = 1.0..2.2;
    pub const MIN_CONTRAST_HU: f64 = 50.0;
    /// Ratio of the areas of neighbouring sections, and the difference of their medians, HU.
    pub const AREA_RATIO: std::ops::RangeInclusive<f64> = 0.6..=1.67;
    pub const VALUE_STEP_HU: f64 = 30.0;
    /// Largest displacement of a section's centre from slice to slice, mm; more where slice steps or
    /// pixels are larger.
    pub const REACH_MM: f64 = 2.5;
    /// Length of the shortest chain considered, mm, and number of chains across each axis.
    pub const MIN_CHAIN_MM: f64 = 30.0;
    pub const MAX_CHAINS: usize = 3;
    /// Shortest chain that is an aorta, mm, and the bounds of its mean radius, mm.
    pub const MIN_MM: f64 = 60.0;
    pub const RADIUS_MM: std::ops::Range<f64> = 5.0..20.0;
    /// Most variation of its areas, standard deviation in parts of the mean.
    pub const MAX_VARIATION: f64 = 0.5;
    /// Bone lies this far from a section's rim, mm, covers this much, mm², and is at least as bright as
    /// this, HU, and brighter than the blood by so much.
    pub const BONE_WITHIN_MM: f64 = 20.0;
    pub const BONE_MM2: f64 = 40.0;
    pub const BONE_HU: f64 = 250.0;
    pub const BONE_ABOVE_BLOOD_HU: f64 = 60.0;
    /// Radius about a section's centre that counts as the section itself, in radii of the section.
    pub const OWN_RADII: f64 = 1.3;
    /// Least share of the sections that lie beside spine or bone.
    pub const MIN_BESIDE_BONE: f64 = 0.5;
    /// Greatest gap between a vertebra and the aorta, mm.
    pub const SPINE_WITHIN_MM: f64 = 25.0;
    /// Greatest gap to the side, mm.
    pub const SIDE_MM: f64 = 10.0;
    /// Distance between the middles of section and spine up to which the section is a vertebra, mm, and
    /// greatest share of vertebrae in an aorta's chain.
    pub const IN_SPINE_MM: f64 = 12.0;
    pub const MAX_IN_SPINE: f64 = 0.3;
    /// Share of a chain beside which another one, or the spine, has to run to be compared with it, and the
    /// least ratio of their values at which the brighter one is the artery.
    pub const BESIDE: f64 = 0.25;
    pub const BRIGHTER: f64 = 1.1;
    /// Gas lies this near to the rim of tagged fluid in a colon, mm, covers this much, mm², and is darker
    /// than lung, HU.
    pub const GAS_WITHIN_MM: f64 = 6.0;
    pub const GAS_MM2: f64 = 20.0;
    pub const GAS_HU: f64 = -930.0;
    /// Most of the sections that lie beside gas.
    pub const MAX_BESIDE_GAS: f64 = 0.5;
}

/// Numbers of `vertebrae.rs`.
pub mod vertebrae {
    /// Values of muscle, HU.
    pub const MUSCLE_HU: std::ops::Range<f64> = -50.0..130.0;
    /// Least brightness of a vertebra; discs between vertebrae have less.
    pub const MIN_BRIGHT: f64 = 0.05;
    /// Radius of a vertebra, of its canal, of arch and muscles, mm.
    pub const VERTEBRA_MM: f64 = 16.0;
    pub const CANAL_MM: f64 = 6.0;
    pub const BESIDE_MM: f64 = 9.0;
    /// Radii of a ring about the canal, mm, and its brightness from where on the canal counts as enclosed.
    pub const RING_MM: std::ops::Range<f64> = 8.0..13.0;
    pub const RING_BRIGHT: f64 = 0.35;
    /// A place so far behind a vertebra, of such a radius, mm, is not bright; brightness from where on it
    /// counts in full, and weight.
    pub const FAR_BEHIND_MM: f64 = 80.0;
    pub const FAR_MM: f64 = 14.0;
    pub const FAR_BRIGHT: f64 = 0.35;
    pub const FAR_WEIGHT: f64 = 0.8;
    /// Distance of canal and arch behind the middle of a vertebra, and of the muscles: behind and beside
    /// it, mm.
    pub const CANAL_BEHIND_MM: f64 = 25.0;
    pub const ARCH_BEHIND_MM: f64 = 42.0;
    /// Weights of the arch and of the muscles, where the vertebra weighs 1. The brightness of the arch counts
    /// up to so many times the brightness of the vertebra.
    pub const ARCH_WEIGHT: f64 = 0.7;
    pub const ARCH_TIMES: f64 = 1.5;
    pub const MUSCLE_WEIGHT: f64 = 0.3;
    /// Distance of a vertebra's middle from the skin of the back, mm, and from the middle of the body,
    /// at which nothing counts any more.
    pub const FROM_SKIN_MM: std::ops::Range<f64> = 20.0..150.0;
    pub const OFF_MIDDLE_MM: f64 = 60.0;
    /// Share of the score that the greatest distance from the skin takes.
    pub const DEEPER: f64 = 0.4;
    /// Slices of which one is looked at where the turn of the patient is found.
    pub const FEW: usize = 3;
    /// Score by which a turn has to be better, for each degree.
    pub const ROLL_COST: f64 = 0.004;
    /// Length along the patient over which scores are averaged, mm, and step aside per mm along.
    pub const ALONG_MM: f64 = 15.0;
    pub const SLOPE: f64 = 0.7;
}

/// Numbers of `coarse.rs`.
pub mod coarse {
    /// Values of soft tissue, HU, in which noise is measured, on every so many voxels.
    pub const SOFT_HU: std::ops::Range<f64> = -30.0..130.0;
    pub const NOISE_EVERY: usize = 7;
}
