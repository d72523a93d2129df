//! Organs that a piece of gas may be, each by measured features beside their limits. A piece gets the
//! first name of the table all of whose rows it passes; the name that fails by least is the runner-up.
//!
//! Limits of shape and place are rounded from textbook anatomy of adults: a stomach hangs from the oesophagus
//! under the left dome, crosses the middle to the pylorus near the first lumbar vertebra and ends
//! there; a colon frames the belly from flank to flank and reaches the pelvis. Limits of values were measured on the shared scans (docs/organs.md).

use super::numbers::of_every_organ::rivals::*;
use std::fmt::Write;

/// Name of a piece of gas, the more special ones first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rival {
    Airway,
    Lung,
    Stomach,
    Colon,
    Bowel,
}

impl Rival {
    /// All names, in the order in which they are given.
    const ALL: [Self; 5] = [Self::Airway, Self::Lung, Self::Stomach, Self::Colon, Self::Bowel];

    /// Rows of the name whose features were measured: feature, value, limit, and value without doubt.
    pub fn rows(
        self,
        features: &GasFeatures,
    ) -> impl Iterator<Item = (&'static str, f64, f64, f64)> {
        let own = TABLE.iter().filter(move |row| row.0 == self);
        own.filter_map(|row| Some((row.1, (row.2)(features)?, row.3, row.4)))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Airway => "airway",
            Self::Lung => "lung",
            Self::Stomach => "stomach",
            Self::Colon => "colon",
            Self::Bowel => "other gas",
        }
    }
}

/// Features of a piece of gas.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GasFeatures {
    pub volume_ml: f64,
    /// Radius of the largest sphere in it, mm.
    pub radius_mm: f64,
    /// Share of its voxels that are gas away from walls.
    pub deep: f64,
    /// Share of its shell that is tissue.
    pub tissue: f64,
    /// Share of it that lies in the airway.
    pub in_airway: f64,
    /// Distance of its top below the lowest place of the lungs, mm; negative above it. `None` without
    /// lungs in the scan.
    pub below_lung_mm: Option<f64>,
    /// Distance of its top below the head end of the scan, mm: lungs that are not in it lie above.
    pub below_end_mm: f64,
    /// Distance of its upper fifth from the middle of the body, to the left, in half widths of the body.
    pub top_left: f64,
    /// Reach of it to the right of the middle, in half widths of the body.
    pub right: f64,
    /// Distance from its top to its bottom, mm.
    pub height_mm: f64,
}

/// A row of the table: a feature, its limit, and the value at which there is no doubt.
type FeatureRow = (Rival, &'static str, fn(&GasFeatures) -> Option<f64>, f64, f64);

const TABLE: &[FeatureRow] = &[
    (Rival::Airway, "share in the airway", |f| Some(f.in_airway), 0.1, 0.2),
    (Rival::Lung, "volume, ml", |f| Some(f.volume_ml), 200.0, 600.0),
    (Rival::Lung, "share below -900 HU", |f| Some(f.deep), 0.8, 0.65),
    (Rival::Stomach, "share below -900 HU", |f| Some(f.deep), 0.8, 0.9),
    (
        Rival::Stomach,
        "depth of the top below the lungs or the scan's end, mm",
        |f| Some(f.below_lung_mm.unwrap_or(f.below_end_mm)),
        60.0,
        20.0,
    ),
    (Rival::Stomach, "top to the left, half widths", |f| Some(f.top_left), 0.1, 0.3),
    (Rival::Stomach, "reach to the right, half widths", |f| Some(f.right), 0.5, 0.3),
    // A descending colon lies in the flank.
    (
        Rival::Stomach,
        "least distance left of the middle, half widths",
        |f| Some(-f.right),
        0.25,
        0.1,
    ),
    (Rival::Stomach, "height, mm", |f| Some(f.height_mm), 170.0, 120.0),
    (Rival::Stomach, "radius, mm", |f| Some(f.radius_mm), 12.0, 20.0),
    (Rival::Colon, "share below -900 HU", |f| Some(f.deep), 0.8, 0.95),
    (Rival::Colon, "share of the shell that is tissue", |f| Some(f.tissue), 0.9, 0.97),
    (Rival::Colon, "radius, mm", |f| Some(f.radius_mm), 6.0, 12.0),
];

/// Fit of a name to a piece.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub rival: Rival,
    /// Least margin of its rows: 0 at a limit, at most 1; negative beyond a limit.
    pub margin: f64,
    /// The row with that margin: feature, value, limit, and value without doubt.
    decided_by: Option<(&'static str, f64, f64, f64)>,
    /// Whether a feature is only a bound: how far a pocket lies below lungs that are not in the scan.
    is_open: bool,
}

impl Fit {
    fn of(rival: Rival, features: &GasFeatures) -> Self {
        let is_open = rival == Rival::Stomach && features.below_lung_mm.is_none();
        let mut fit = Self { rival, margin: 1.0, decided_by: None, is_open };
        for row in rival.rows(features) {
            let (_, value, limit, sure) = row;
            let margin = ((value - limit) / (sure - limit)).clamp(-1.0, 1.0);
            if fit.decided_by.is_none() || margin < fit.margin {
                (fit.margin, fit.decided_by) = (margin, Some(row));
            }
        }
        if fit.decided_by.is_none() {
            fit.margin = 0.0;
        }
        fit
    }

    /// Describes the name with the feature that decided.
    fn words(&self) -> String {
        let mut out = self.rival.name().to_owned();
        if let Some((what, value, limit, sure)) = self.decided_by {
            let side = if sure > limit { "at least" } else { "at most" };
            let _ = write!(out, " ({what}: {value:.2}, {side} {limit})");
        }
        out
    }
}

/// The name of a piece, and the next one.
#[derive(Clone, Copy, Debug)]
pub(super) struct GasName {
    pub best: Fit,
    pub second: Fit,
}

impl GasName {
    /// Names a piece of gas.
    pub fn of(features: &GasFeatures) -> Self {
        let fits = Rival::ALL.map(|rival| Fit::of(rival, features));
        // Without lungs nothing says that a pocket lies under the dome.
        let passes = |fit: &&Fit| fit.margin > 0.0 && !fit.is_open;
        let bowel = fits[fits.len() - 1];
        let best = *fits.iter().find(passes).unwrap_or(&bowel);
        let others = fits.iter().filter(|fit| fit.rival != best.rival && fit.rival != Rival::Bowel);
        let second = others.max_by(|a, b| a.margin.total_cmp(&b.margin)).copied();
        Self { best, second: second.unwrap_or(bowel) }
    }

    /// Whether a piece passes as colon and, but for lungs that are not in the scan, as stomach.
    pub fn is_undecided(&self) -> bool {
        self.best.rival == Rival::Colon && self.second.is_open && self.second.margin > 0.0
    }

    /// Whether a colon may be stomach, or a stomach colon.
    pub fn is_near_tie(&self) -> bool {
        match (self.best.rival, self.second.rival) {
            (Rival::Colon, Rival::Stomach) => self.second.margin > -NEAR,
            (Rival::Stomach, Rival::Colon) => self.best.margin < NEAR && self.second.margin > 0.0,
            _ => false,
        }
    }

    /// Describes both names in a line.
    pub fn line(&self) -> String {
        if self.is_undecided() {
            let second = self.second.words();
            return format!("colon or {second}: no lungs are in the scan, which would tell");
        }
        format!("{}; else {}", self.best.words(), self.second.words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POCKET: GasFeatures = GasFeatures {
        volume_ml: 300.0,
        radius_mm: 28.0,
        deep: 0.95,
        tissue: 1.0,
        in_airway: 0.0,
        below_lung_mm: Some(15.0),
        below_end_mm: 300.0,
        top_left: 0.4,
        right: 0.4,
        height_mm: 110.0,
    };

    #[test]
    fn a_pocket_under_the_left_dome_that_ends_near_the_middle_is_stomach() {
        let named = GasName::of(&POCKET);
        assert_eq!((named.best.rival, named.second.rival), (Rival::Stomach, Rival::Colon));
        assert!(named.line().starts_with("stomach (reach to the right"), "{}", named.line());
    }

    #[test]
    fn gas_from_flank_to_flank_or_down_to_the_pelvis_is_colon() {
        for features in [
            GasFeatures { right: 0.75, ..POCKET },
            GasFeatures { height_mm: 260.0, ..POCKET },
            GasFeatures { below_lung_mm: Some(150.0), ..POCKET },
            GasFeatures { top_left: -0.5, ..POCKET },
            GasFeatures { right: -0.4, ..POCKET },
        ] {
            let named = GasName::of(&features);
            assert_eq!(named.best.rival, Rival::Colon, "{}", named.line());
        }
    }

    #[test]
    fn without_lungs_a_pocket_near_the_head_end_is_undecided_and_a_lower_one_colon() {
        let high = GasFeatures { below_lung_mm: None, below_end_mm: 30.0, ..POCKET };
        let named = GasName::of(&high);
        assert!(named.is_undecided() && named.is_near_tie(), "{}", named.line());
        for low in
            [GasFeatures { below_end_mm: 80.0, ..high }, GasFeatures { height_mm: 300.0, ..high }]
        {
            let named = GasName::of(&low);
            assert!(named.best.rival == Rival::Colon && !named.is_near_tie(), "{}", named.line());
        }
    }

    #[test]
    fn values_of_lung_and_an_airway_are_named() {
        let lung = GasFeatures { deep: 0.2, volume_ml: 1500.0, tissue: 0.8, ..POCKET };
        assert_eq!(GasName::of(&lung).best.rival, Rival::Lung);
        let airway = GasFeatures { in_airway: 0.6, ..POCKET };
        assert_eq!(GasName::of(&airway).best.rival, Rival::Airway);
        let narrow = GasFeatures { radius_mm: 4.0, ..POCKET };
        assert_eq!(GasName::of(&narrow).best.rival, Rival::Bowel);
    }
}
