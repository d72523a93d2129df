//! Numbers of every organ: body, frame of the patient, values.

/// Numbers of `body.rs`.
pub mod body {
    /// Least value of tissue, HU: foam, air and lung lie below.
    pub const TISSUE_HU: f64 = -300.0;
    /// Radius of the opening, mm: half of more than a table's plate and of less than a body's wall …
    pub const OPENING_MM: f64 = 5.0;
    /// … or this part of a small volume's least side across the patient.
    pub const OPENING_PART: f64 = 1.0 / 20.0;
    /// Tissue joined to the core within so many radii of the opening belongs to the body: a wall over
    /// distended bowel is thin, and a table's plate leads away from the body.
    pub const REACH_RADII: u32 = 5;
    /// Gaps in the wall that are closed in each slice, in radii of the opening.
    pub const GAP_RADII: f64 = 0.6;
}

/// Numbers of `glance.rs`.
pub mod glance {
    /// Distance between the samples that are looked at, mm, about.
    pub const STEP_MM: f64 = 4.0;
    /// Most samples along an axis.
    pub const MAX_STEPS: u32 = 256;
    /// A volume with values below this is a CT in HU with air in it.
    pub const CT_HU: f64 = -500.0;
    /// Values of tissue, of lung, of gas without lung, and of blood with contrast medium, HU.
    pub const TISSUE_HU: f64 = -300.0;
    pub const LUNG_HU: std::ops::Range<f64> = -950.0..-600.0;
    pub const GAS_HU: f64 = -940.0;
    pub const CONTRAST_HU: std::ops::Range<f64> = 140.0..600.0;
    /// Least volumes of lung, of gas beside no lung, and of contrast medium, ml.
    pub const LUNG_ML: f64 = 300.0;
    pub const GAS_ML: f64 = 100.0;
    pub const CONTRAST_ML: f64 = 60.0;
    /// Most of an angiogram's range of values that its median reaches: nearly all of it is dark.
    pub const DARK: f64 = 0.2;
    /// Most different values of a label map.
    pub const LABELS: usize = 32;
}

/// Numbers of `frame.rs`.
pub mod frame {
    /// Value of soft tissue, HU.
    pub const SOFT_HU: f32 = 40.0;
    /// Voxel sides of the coarse copy, mm, about.
    pub const COARSE_MM: f64 = 3.0;
    /// Distance of its slices, mm, about.
    pub const SLICE_MM: f64 = 5.0;
    pub const ARCH_SIDE_MM: f64 = 35.0;
    pub const BEHIND_MM: f64 = 70.0;
    /// Turns of the patient about his length that are tried, degrees.
    pub const ROLLS: [f64; 5] = [0.0, -10.0, 10.0, -20.0, 20.0];
    /// Score of a slice in which the spine is seen. Measured: medians of five spines 0.69 to 1.04, of two
    /// skulls 0.23 and 0.41.
    pub const SEEN: f64 = 0.25;
    /// Score by which another direction has to exceed the score of the header's direction.
    pub const TURNED: f64 = 0.15;
}

/// Numbers of `values.rs`.
pub mod values {
    /// Least value that a scanner measures, HU: below lies padding of Philips (-2000), GE (-1500,
    /// -3024). Noise of air reaches it at a standard deviation of 130 HU only.
    pub const MIN_HU: f64 = -1400.0;
}

/// Numbers of `rivals.rs`.
pub mod rivals {
    /// Margin about the limits of a stomach within which a piece may be stomach or colon.
    pub const NEAR: f64 = 0.25;
}
