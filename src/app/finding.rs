//! What a reader says of a noted place, and what follows from it: size, mean value, distance along the
//! organ, the table of all findings, and the category of a colon.

use glam::{DVec3, IVec3, Quat};
use serde::{Deserialize, Serialize};

use super::action::Ruler;
use super::measure::Measurement;
use super::model::{Bookmark, Model};
use crate::geometry::TriangleBvh;
use crate::lumen::Lumen;
use crate::organ::Organ;
use crate::volume::Volume;

/// Form of a lesion, as colonography reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LesionShape {
    /// Broad-based: wider than it is high.
    Sessile,
    /// On a stalk.
    Pedunculated,
    /// Less high than half of its width, or than 3 mm.
    Flat,
    /// Of 30 mm or more, or around the lumen.
    Mass,
    /// A narrowed lumen.
    Stenosis,
    /// None of these.
    Other,
}

impl LesionShape {
    /// All forms.
    pub const ALL: [Self; 6] =
        [Self::Sessile, Self::Pedunculated, Self::Flat, Self::Mass, Self::Stenosis, Self::Other];

    /// Returns the name of the form.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sessile => "sessile",
            Self::Pedunculated => "pedunculated",
            Self::Flat => "flat",
            Self::Mass => "mass",
            Self::Stenosis => "stenosis",
            Self::Other => "other",
        }
    }
}

/// Confidence of a reader in a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Confidence {
    /// Hardly more than a doubt.
    Low,
    /// Probable.
    Medium,
    /// As good as certain.
    High,
}

impl Confidence {
    /// All grades, the least first.
    pub const ALL: [Self; 3] = [Self::Low, Self::Medium, Self::High];

    /// Returns the name of the grade.
    pub fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Medium => "medium",
            Self::High => "high",
        }
    }
}

/// A change of one field of a finding.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingEdit {
    /// Its name.
    Name(String),
    /// Segment of the organ, or name of the branch.
    Segment(String),
    /// Its form; `None` where nothing is said.
    Shape(Option<LesionShape>),
    /// Confidence of the reader; `None` where nothing is said.
    Confidence(Option<Confidence>),
    /// Whether the flight looks at it in passing.
    InFlight(bool),
}

/// Farthest place from a finding's wall whose measurement is taken for one of the finding, mm.
pub(super) const OWN_REACH_MM: f64 = 60.0;
/// Radius of the ball whose mean value is given, mm.
pub(super) const BALL_MM: f64 = 3.0;

/// Most voxels from the middle of that ball to its surface.
const MAX_REACH: f64 = 12.0;

/// Largest length of each kind that was measured of a finding, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sizes {
    /// Between places of the wall.
    pub wall_mm: Option<f64>,
    /// In a slice.
    pub slice_mm: Option<f64>,
}

impl Sizes {
    /// Returns the larger one.
    pub fn largest_mm(self) -> Option<f64> {
        self.wall_mm.into_iter().chain(self.slice_mm).reduce(f64::max)
    }
}

/// The lengths that were measured of a finding.
fn lengths<'a>(model: &'a Model, finding: &Bookmark) -> impl Iterator<Item = &'a Measurement> {
    let id = finding.id;
    let own = model.measurements.iter().filter(move |m| m.finding == Some(id));
    own.filter(|m| m.ruler == Ruler::Length)
}

pub(super) fn sizes(model: &Model, finding: &Bookmark) -> Sizes {
    let largest = |in_slice| {
        let of = lengths(model, finding).filter(|m| m.in_slice == in_slice);
        of.map(Measurement::value).reduce(f64::max)
    };
    Sizes { wall_mm: largest(false), slice_mm: largest(true) }
}

/// The largest length that was measured of a finding.
pub(super) fn longest<'a>(model: &'a Model, finding: &Bookmark) -> Option<&'a Measurement> {
    lengths(model, finding).max_by(|a, b| a.value().total_cmp(&b.value()))
}

/// Place of the lesion, LPS mm: the middle of its largest length, or the wall that the eye looked at.
pub(super) fn middle(model: &Model, finding: &Bookmark) -> Option<DVec3> {
    let of_length = longest(model, finding).map(|m| 0.5 * (m.points()[0] + m.points()[1]));
    of_length.or(finding.wall_mm.map(DVec3::from))
}

/// The wall in the middle of a bookmark's view.
pub(super) fn wall_at(b: &Bookmark, tree: &TriangleBvh) -> Option<[f64; 3]> {
    /// Farther than any lumen is long.
    const FAR_MM: f64 = 2000.0;
    let rotation = Quat::from_array(b.rotation.map(|v| v as f32));
    let along = (rotation.as_dquat() * DVec3::NEG_Z).try_normalize()?;
    tree.first_hit(DVec3::from(b.position_mm), along * FAR_MM).map(|p| p.to_array())
}

/// Mean value of the tissue in a ball about a finding: voxels of the lumen do not count.
pub(super) fn mean_value(model: &Model, finding: &Bookmark) -> Option<f64> {
    let lumen = model.products.lumen.as_ref().map(|l| &l.lumen);
    mean_in_ball(model.volume()?, lumen, middle(model, finding)?)
}

fn mean_in_ball(volume: &Volume, lumen: Option<&Lumen>, middle: DVec3) -> Option<f64> {
    let values = values_in_ball(volume, lumen, middle);
    let count = values.len();
    (count > 0).then(|| values.into_iter().sum::<f64>() / count as f64)
}

/// Range of values about those in a ball: their mean and three standard deviations.
pub(super) fn range_around(volume: &Volume, middle: DVec3) -> Option<[f64; 2]> {
    let values = values_in_ball(volume, None, middle);
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    let reach = (3.0 * variance.sqrt()).max(1.0);
    mean.is_finite().then(|| [(mean - reach).round(), (mean + reach).round()])
}

/// Values of the voxels within [`BALL_MM`] of a place, those of the lumen left out.
fn values_in_ball(volume: &Volume, lumen: Option<&Lumen>, middle: DVec3) -> Vec<f64> {
    let grid = &volume.grid;
    let (to_voxel, to_world) = (grid.voxel_from_world(), grid.world_from_voxel());
    let centre = to_voxel.transform_point3(middle);
    // Of a volume with the finest voxels the ball is smaller: it is computed in each frame.
    let radius = BALL_MM.min(MAX_REACH * grid.spacing_mm.min_element());
    let reach = (radius / grid.spacing_mm).ceil().as_ivec3();
    let (low, high) = (-reach, reach);
    let mut values = Vec::new();
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let voxel = centre.round().as_ivec3() + IVec3::new(x, y, z);
                let place = to_world.transform_point3(voxel.as_dvec3());
                let is_near = place.distance(middle) <= radius;
                let is_there =
                    voxel.cmpge(IVec3::ZERO).all() && voxel.cmplt(grid.dims.as_ivec3()).all();
                let is_lumen = || {
                    lumen.is_some_and(|l| {
                        let own = l.grid.voxel_from_world().transform_point3(place).round();
                        l.holds(own.as_ivec3())
                    })
                };
                if is_near && is_there && !is_lumen() {
                    values.push(volume.real(grid.index(voxel.as_uvec3())));
                }
            }
        }
    }
    values
}

/// Way along the path to a finding, mm: from a colon's rectum where its ends have names, else from the
/// start of the path; `None` where the path that is flown does not pass the finding.
pub(super) fn distance_mm(model: &Model, finding: &Bookmark) -> Option<f64> {
    let (path, arc) = (model.path.as_ref()?, model.arc_beside(finding)?);
    let from_end = model.ends.is_some_and(|ends| !ends.starts_at_rectum);
    Some(if from_end { path.length_mm() - arc } else { arc })
}

/// Category of a colon by the sizes of its polyps and masses: C1 to C4 of C-RADS (Zalis et al. 2005,
/// doi:10.1148/radiol.2361041926). Whether the examination is complete (C0) is the reader's to say.
///
/// * `sizes`: largest diameters, mm; those under 6 mm do not count.
pub(super) fn c_rads(sizes: &[f64], has_mass: bool) -> &'static str {
    let of = |from: f64, to: f64| sizes.iter().filter(|mm| (from..to).contains(*mm)).count();
    let (intermediate, large) = (of(6.0, 10.0), of(10.0, 30.0));
    match (has_mass || of(30.0, f64::INFINITY) > 0, large > 0 || intermediate >= 3, intermediate) {
        (true, _, _) => "C4: mass",
        (false, true, _) => "C3: polyp of 10 mm or more, or three of 6 to 9 mm",
        (false, false, 0) => "C1: no polyp of 6 mm or more",
        (false, false, _) => "C2: one or two polyps of 6 to 9 mm",
    }
}

/// Returns the category of a colon, if a finding has a size or is a mass.
pub(super) fn category(model: &Model) -> Option<&'static str> {
    let lumen = model.products.lumen.as_ref();
    let organ = lumen.and_then(|l| l.organ.as_ref()).map(|o| o.organ);
    if organ != Some(Organ::Colon) && model.ends.is_none() {
        return None;
    }
    let counts = |b: &&Bookmark| {
        !matches!(b.shape, Some(LesionShape::Stenosis | LesionShape::Other))
            && b.confidence != Some(Confidence::Low)
    };
    let polyps: Vec<_> = model.bookmarks.iter().filter(counts).collect();
    let mm: Vec<f64> = polyps.iter().filter_map(|b| sizes(model, b).largest_mm()).collect();
    let has_mass = polyps.iter().any(|b| b.shape == Some(LesionShape::Mass));
    (!mm.is_empty() || has_mass).then(|| c_rads(&mm, has_mass))
}

/// The findings as a table (RFC 4180), a line each. Lengths are millimetres, places LPS.
pub(super) fn table(model: &Model) -> String {
    let mut out = String::from(
        "number,name,segment,distance_mm,size_on_wall_mm,size_in_slice_mm,shape,mean_value,\
         confidence,eye_x,eye_y,eye_z,wall_x,wall_y,wall_z\r\n",
    );
    let number = |v: Option<f64>| v.map(|v| format!("{v:.2}")).unwrap_or_default();
    for (i, b) in model.bookmarks.iter().enumerate() {
        let Sizes { wall_mm, slice_mm } = sizes(model, b);
        let place = |p: Option<[f64; 3]>| [0, 1, 2].map(|k| number(p.map(|p| p[k])));
        let fields = [
            (i + 1).to_string(),
            quoted(&b.text),
            quoted(b.segment.as_deref().unwrap_or_default()),
            number(distance_mm(model, b)),
            number(wall_mm),
            number(slice_mm),
            b.shape.map_or("", LesionShape::name).into(),
            number(mean_value(model, b)),
            b.confidence.map_or("", Confidence::name).into(),
        ];
        let places = place(Some(b.position_mm)).into_iter().chain(place(b.wall_mm));
        let line: Vec<String> = fields.into_iter().chain(places).collect();
        out += &line.join(",");
        out += "\r\n";
    }
    out
}

/// A text as a field of a table. One that a spreadsheet would take for a formula begins with an
/// apostrophe.
fn quoted(text: &str) -> String {
    let is_formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    let text = if is_formula { format!("'{text}") } else { text.to_owned() };
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::Action;
    use super::super::model::flown_model;
    use super::*;
    use crate::session::FlightRoute;
    use crate::volume::phantom::Kind;
    use crate::volume::{Grid, Samples};

    #[test]
    fn the_category_follows_from_sizes_and_counts() {
        let of = |sizes: &[f64]| &c_rads(sizes, false)[..2];
        assert_eq!(of(&[]), "C1");
        assert_eq!(of(&[5.9]), "C1", "diminutive polyps are not reported");
        assert_eq!(of(&[6.0, 9.9]), "C2");
        assert_eq!(of(&[6.0, 7.0, 8.0]), "C3");
        assert_eq!(of(&[10.0]), "C3");
        assert_eq!(of(&[12.0, 31.0]), "C4");
        assert_eq!(&c_rads(&[8.0], true)[..2], "C4", "a mass around the lumen");
    }

    #[test]
    fn lengths_measured_at_a_selected_finding_are_its_sizes_and_distant_ones_are_not() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        model.step(0.0, &[Action::Bookmark("polyp".into())]);
        let at = DVec3::from(model.bookmarks[0].wall_mm.expect("it looks at a wall"));
        let mark = |offset: f64| Action::Mark((at + DVec3::X * offset).to_array());
        let in_slice = |offset: f64| Action::MarkInSlice((at + DVec3::X * offset).to_array());
        let ruler = Action::Measure(Some(Ruler::Length));
        model.step(0.0, &[ruler.clone(), mark(0.0), mark(7.0)]);
        model.step(0.0, &[ruler.clone(), in_slice(0.0), in_slice(8.5)]);
        model.step(0.0, &[ruler, mark(0.0), mark(500.0)]);
        let sizes = sizes(&model, &model.bookmarks[0]);
        let near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 1e-9;
        assert!(near(sizes.wall_mm, 7.0) && near(sizes.slice_mm, 8.5), "{sizes:?}");
        assert_eq!(model.measurements.iter().filter(|m| m.finding.is_none()).count(), 1);
        // What is measured of a finding goes with it.
        model.step(0.0, &[Action::RemoveBookmark(0)]);
        assert_eq!(model.measurements.len(), 1);
        model.step(0.0, &[Action::Undo]);
        assert_eq!((model.bookmarks.len(), model.measurements.len()), (1, 3));
    }

    #[test]
    fn the_mean_value_of_a_ball_leaves_out_what_lies_outside_the_volume() {
        let grid = Grid::axis_aligned([9, 9, 9], [1.0; 3]);
        let value = |i: usize| if grid.voxel(i).x < 4 { 10i16 } else { 30 };
        let samples = Samples::I16((0..grid.len()).map(value).collect::<Vec<_>>().into());
        let volume = Volume::new(grid, samples);
        let at = |x: f64| mean_in_ball(&volume, None, DVec3::new(x, 4.0, 4.0));
        assert_eq!(at(0.0), Some(10.0));
        assert_eq!(at(8.0), Some(30.0));
        // Of the 123 voxels of the ball 47 lie in planes before the middle one: 1 + 9 + 21 and so on.
        let mixed = at(4.0).unwrap();
        assert!(mixed > 20.0 && mixed < 30.0, "{mixed}");
        assert_eq!(at(100.0), None);
    }

    /// The table gave the nearest place of a path in another bronchus.
    #[test]
    fn a_finding_of_another_branch_has_no_length_along_this_path() {
        let (mut model, session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let near_end = 0.95 * model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(near_end), Action::Bookmark("left".into())]);
        assert!((distance_mm(&model, &model.bookmarks[0]).unwrap() - near_end).abs() < 1e-6);
        let route = FlightRoute::Leaf(1);
        let flight = session.flight_along(route).unwrap();
        let sections = session.sections_along(&flight).unwrap();
        model.take_branch(flight, &sections, route);
        assert_eq!(distance_mm(&model, &model.bookmarks[0]), None);
        let row = table(&model);
        assert!(row.contains("\r\n1,left,,,"), "{row}");
    }

    #[test]
    fn a_table_of_findings_quotes_texts_and_makes_no_formula_of_them() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        for text in ["a, \"b\"", "=1+1"] {
            model.step(0.0, &[Action::Bookmark(text.into())]);
        }
        let shape = FindingEdit::Shape(Some(LesionShape::Flat));
        model.step(0.0, &[Action::EditFinding(1, shape)]);
        let table = table(&model);
        let lines: Vec<&str> = table.trim_end().split("\r\n").collect();
        assert!(lines[1].starts_with("1,\"a, \"\"b\"\"\",,"), "{}", lines[1]);
        assert!(lines[2].starts_with("2,'=1+1,,"), "{}", lines[2]);
        assert!(lines[2].contains(",flat,"), "{}", lines[2]);
        let columns = lines[0].split(',').count();
        assert_eq!((lines.len(), lines[2].split(',').count()), (3, columns));
    }
}
