//! Subdivision schemes.

use super::template::PatchShape;

/// Scheme by which the triangles of the base are subdivided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Scheme {
    /// Each triangle into four, gaps closed by templates; new vertices on the original.
    #[default]
    #[serde(rename = "1-to-4")]
    #[cfg_attr(feature = "cli", value(name = "1-to-4"))]
    OneToFour,
    /// Templates of 1-to-4; new vertices where the modified butterfly predicts them from the base
    /// alone.
    Butterfly,
    /// Each triangle into three, edges flipped; new vertices on the original, without morphing.
    Sqrt3,
    /// Triangles bisected from their newest corner; new vertices on the original.
    #[serde(rename = "4-8")]
    #[cfg_attr(feature = "cli", value(name = "4-8"))]
    FourEight,
}

impl Scheme {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::OneToFour => "1-to-4",
            Self::Butterfly => "butterfly",
            Self::Sqrt3 => "sqrt3",
            Self::FourEight => "4-8",
        }
    }

    /// Number of the original's faces to one of the base. A base face is the least that is drawn; but
    /// over too large ones the parameterization is distorted. Where patches do not nest, a base face
    /// has no more triangles than its finest level.
    pub fn original_faces(self) -> usize {
        if self.nests() {
            return 48;
        }
        let shape = PatchShape::of(self);
        // The finest level has about 1.2 times the original's triangles, as that of nested patches.
        shape.triangles(shape.finest()) as usize * 5 / 6
    }

    /// Whether a patch can be split into patches. The parts of a triangle have its shape under
    /// 1-to-4 splits only. More splits bring predictions of the butterfly no nearer to the original.
    pub(super) fn nests(self) -> bool {
        self == Self::OneToFour
    }

    /// Whether the vertices of a level can begin on the triangles of the one before. Flipped edges
    /// are not in those.
    pub(super) fn morphs(self) -> bool {
        self != Self::Sqrt3
    }
}
