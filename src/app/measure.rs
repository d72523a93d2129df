//! Lengths and angles between places that were clicked.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::action::Ruler;

/// Places farther from the origin are of no scan, mm.
const MAX_MM: f64 = 1e6;

/// Places and what is between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Name that the user gives it; empty for none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Kind of measurement.
    pub ruler: Ruler,
    /// LPS mm: two ends of a length; of an angle the second is its vertex.
    pub points_mm: Vec<[f64; 3]>,
    /// Whether it was measured in a slice, and not between places of the wall.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub in_slice: bool,
    /// Number of the finding that it is of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finding: Option<u64>,
    /// Number that tells it from others; 0 where it has none yet.
    #[serde(default)]
    pub id: u64,
}

impl Ruler {
    /// Points that it takes.
    pub fn points(self) -> usize {
        match self {
            Self::Length => 2,
            Self::Angle => 3,
        }
    }
}

impl Measurement {
    /// A measurement, once there are all of its points.
    pub fn of(ruler: Ruler, points: &[DVec3]) -> Option<Self> {
        let whole = points.len() == ruler.points();
        let points_mm = points.iter().map(DVec3::to_array).collect();
        let name = String::new();
        whole.then_some(Self { name, ruler, points_mm, in_slice: false, finding: None, id: 0 })
    }

    /// Whether it has as many points as it needs, all of them places.
    pub fn is_valid(&self) -> bool {
        self.points_mm.len() == self.ruler.points()
            && self.points().iter().all(|p| p.abs().max_element() < MAX_MM)
    }

    /// LPS mm.
    pub fn points(&self) -> Vec<DVec3> {
        self.points_mm.iter().map(|p| DVec3::from(*p)).collect()
    }

    /// Millimetres or degrees.
    pub fn value(&self) -> f64 {
        match (self.ruler, &self.points()[..]) {
            (Ruler::Length, [a, b]) => a.distance(*b),
            (Ruler::Angle, [a, vertex, b]) => {
                let (u, v) = (*a - *vertex, *b - *vertex);
                // Also where they are nearly in line.
                u.cross(v).length().atan2(u.dot(v)).to_degrees()
            }
            _ => 0.0,
        }
    }

    /// The value with its unit, after the name where there is one.
    pub fn label(&self) -> String {
        format!("{} {}", self.name, self.text()).trim().to_owned()
    }

    /// The value with its unit.
    pub fn text(&self) -> String {
        match self.ruler {
            Ruler::Length => format!("{:.1} mm", self.value()),
            Ruler::Angle => format!("{:.1}°", self.value()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_in_millimetres_and_angles_in_degrees() {
        let (o, x, y) = (DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 4.0);
        let of = |ruler, points: &[DVec3]| Measurement::of(ruler, points).unwrap();
        assert_eq!(of(Ruler::Length, &[x, y]).text(), "5.0 mm");
        assert_eq!(of(Ruler::Angle, &[x, o, y]).text(), "90.0°");
        assert!((of(Ruler::Angle, &[x, o, -x]).value() - 180.0).abs() < 1e-9);
        assert!((of(Ruler::Angle, &[x, o, x + 1e-9 * y]).value()).abs() < 1e-6);
        assert!(Measurement::of(Ruler::Angle, &[x, y]).is_none());
        let mut odd = of(Ruler::Length, &[x, y]);
        odd.points_mm[1] = [f64::NAN; 3];
        assert_eq!(of(Ruler::Length, &[x, y]).label(), "5.0 mm");
        let named = Measurement { name: "polyp".into(), ..of(Ruler::Length, &[x, y]) };
        assert_eq!(named.label(), "polyp 5.0 mm");
        assert!(!odd.is_valid() && of(Ruler::Length, &[x, y]).is_valid());
    }
}
