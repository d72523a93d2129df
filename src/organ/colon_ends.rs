//! Names of the ends of a colon's path.

use glam::DVec3;

/// Names of the ends of a colon's path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColonEnds {
    /// Whether the path begins at the rectum; else at the caecum.
    pub starts_at_rectum: bool,
    /// Whether the rule leaves no doubt, or someone has said so.
    pub is_sure: bool,
}

impl ColonEnds {
    /// Shortest path that both ends of a colon are named on, mm: a shorter one is part of a colon,
    /// and its ends are where the scan or the gas ends.
    pub const MIN_LENGTH_MM: f64 = 600.0;

    /// Names the ends of a path by their place in the patient: the rectum lies at the pelvic floor
    /// in front of the sacrum, nearer to the feet and to the back than the caecum, also of a
    /// patient who lies on the front. The end that is farther to feet and back, both added, is the
    /// rectum; where feet and back disagree, it is not sure. `None` of a path that is too short
    /// for a colon.
    pub fn of(start_mm: DVec3, end_mm: DVec3, length_mm: f64) -> Option<Self> {
        let by = start_mm - end_mm;
        let (feet, back) = (-by.z, by.y);
        let is_colon = length_mm >= Self::MIN_LENGTH_MM && by.is_finite();
        let is_sure = feet * back > 0.0;
        is_colon.then_some(Self { starts_at_rectum: feet + back >= 0.0, is_sure })
    }

    /// The other way about, as someone has said.
    pub fn swapped(self) -> Self {
        Self { starts_at_rectum: !self.starts_at_rectum, is_sure: true }
    }

    /// Names of the start and of the end; with a question mark where they are not sure.
    pub fn names(self) -> [&'static str; 2] {
        match (self.starts_at_rectum, self.is_sure) {
            (true, true) => ["rectum", "caecum"],
            (false, true) => ["caecum", "rectum"],
            (true, false) => ["rectum?", "caecum?"],
            (false, false) => ["caecum?", "rectum?"],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rectum_is_the_end_towards_feet_and_back_and_a_short_path_has_no_names() {
        let rectum = DVec3::new(2.0, 110.0, -300.0);
        let caecum = DVec3::new(-60.0, 20.0, -220.0);
        let names = |a, b, mm| ColonEnds::of(a, b, mm).map(ColonEnds::names);
        assert_eq!(names(rectum, caecum, 1500.0), Some(["rectum", "caecum"]));
        assert_eq!(names(caecum, rectum, 1500.0), Some(["caecum", "rectum"]));
        assert_eq!(names(rectum, caecum, 300.0), None);
        // A caecum deep in the pelvis: the back decides, and it is not sure.
        let deep = DVec3::new(-40.0, 20.0, -320.0);
        let ends = ColonEnds::of(deep, rectum, 1500.0).unwrap();
        assert_eq!(ends.names(), ["caecum?", "rectum?"]);
        assert_eq!(ends.swapped().names(), ["rectum", "caecum"]);
    }
}
