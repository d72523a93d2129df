//! Options of a simplification, and the reason why it ended.

/// Cost of a collapse.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Metric {
    /// Squared distances to the planes of the faces, by area (Garland and Heckbert 1997).
    Qem,
    /// Extends [`Self::Qem`] by normals. The mean area is added to each face's weight. Each vertex
    /// has a tangent plane by its normal, with half the weight of its faces together. Weights are
    /// higher where normals differ from their neighbours'. The deviation of each new face from its
    /// corners' normals is added as squared size times squared angle, and counts more where the
    /// angle is large or the face a sliver. The normals should be smoothed; without any, tangent
    /// planes come from the faces.
    #[default]
    NormalQem,
    /// Metric of Li et al. 2004: each face has weight 1, the tangent plane as much as all faces
    /// together.
    Paper,
}

impl Metric {
    /// Name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Qem => "qem",
            Self::NormalQem => "normal-qem",
            Self::Paper => "paper",
        }
    }
}

/// Target and constraints of a simplification.
#[derive(Clone, Copy, Debug)]
pub struct SimplifyOptions<'a> {
    /// Target number of faces; a collapse removes two (one on a boundary), so the result may have one
    /// less.
    pub faces: usize,
    /// Cost of a collapse.
    pub metric: Metric,
    /// Whether kept vertices move to the minimum of their quadric, at each collapse and once more at
    /// the end, except those on boundaries and cap rims and locked ones. Their normals are
    /// interpolated from the input at the nearest point.
    pub relocate: bool,
    /// One flag a vertex: it is neither moved nor removed.
    pub locked: Option<&'a [bool]>,
    /// Largest root mean square distance of a vertex to the planes of its quadric that a collapse may
    /// cause, mm.
    pub max_error_mm: Option<f64>,
}

impl SimplifyOptions<'_> {
    /// Creates options for simplification to this many faces by the default metric.
    pub fn to_faces(faces: usize) -> Self {
        Self { faces, metric: Metric::default(), relocate: false, locked: None, max_error_mm: None }
    }
}

/// Reason why a simplification ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// The target number of faces is reached.
    Reached,
    /// Every further collapse would change the topology, turn or thin a face too much, touch a locked
    /// vertex, or was vetoed by the recorder.
    NoLegalCollapse,
    /// Every further collapse would exceed `max_error_mm`.
    MaxError,
}
