//! Files that the window exports: pictures, and the page of the report with what its user noted.
//! Nothing of a patient, no name of a file that was opened.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::action::{Pane, Ruler};
use super::error::AppError;
use super::finding;
use super::measure::Measurement;
use super::model::{Bookmark, Model};
use super::slices::{SlicePlane, slice};
use super::wall_outline::draw_wall_outline;
use crate::formats::{FormatError, atomic_file, encode_png, png_size};
use crate::geometry::{CenterlineGraph, TriangleBvh};
use crate::report_page::{Finding, MeasuredValue, ReportPage, SliceView};
use crate::session::{PngPicture, Product, Session, SessionError};
use crate::volume::Volume;

/// Writes a file into a folder, which is made if it is not there; whole or not at all.
pub(super) fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf, AppError> {
    std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
    let path = folder.join(name);
    atomic_file::write_atomic(&path, |out| out.write_all(bytes))?;
    Ok(path)
}

/// A name `STEM-1.png`, `STEM-2.png`, … that no file of the folder has.
pub(super) fn free_name(folder: &Path, stem: &str, extension: &str) -> String {
    let names = (1u32..).map(|i| format!("{stem}-{i}.{extension}"));
    let mut free = names.filter(|n| !folder.join(n).exists());
    free.next().expect("numbers do not end")
}

/// Side of a slice beside a finding, pixels and mm.
const SLICE_PX: usize = 240;
const SLICE_MM: f64 = 80.0;
/// Colour of the cross at the finding's wall.
const CROSS: [u8; 3] = [255, 200, 60];

/// Notes of the window's user.
pub(super) struct Notes {
    findings: Vec<Finding>,
    measurements: Vec<MeasuredValue>,
    category: Option<&'static str>,
    /// Part of the organ that the path starts in, as the window names it.
    start: Option<&'static str>,
    shown_fraction: Option<f64>,
    /// Centre and width of the slices' grey values.
    window: [f64; 2],
}

impl Notes {
    /// Takes the notes of a model.
    ///
    /// * `folder`: that of the session file, where pictures of earlier sessions are.
    pub fn of(model: &Model, folder: Option<&Path>) -> Self {
        let graph = model.products.centerline.as_ref().map(|c| c.line.graph());
        let finding = |b: &Bookmark| {
            let eye = DVec3::from(b.position_mm);
            let looked_at =
                || model.products.triangle_tree.as_ref().and_then(|tree| finding::wall_at(b, tree));
            let branch = || graph.as_ref().and_then(|g| branch_at(g, eye));
            Finding {
                text: b.text.clone(),
                eye_mm: b.position_mm,
                wall_mm: b.wall_mm.or_else(looked_at),
                arc_mm: model.arc_beside(b),
                segment: b.segment.clone().or_else(branch),
                said: said_of(model, b),
                view: picture(b, folder),
                ..Finding::default()
            }
        };
        Self {
            findings: model.bookmarks.iter().map(finding).collect(),
            measurements: model.measurements.iter().map(|m| measured(model, m)).collect(),
            category: finding::category(model),
            start: model.ends.filter(|ends| ends.is_sure).map(|ends| ends.names()[0]),
            shown_fraction: (!model.seen.faces.is_empty()).then_some(model.seen.fraction),
            window: model.window,
        }
    }
}

/// Returns the known fields of a finding: form, mean value, confidence.
fn said_of(model: &Model, b: &Bookmark) -> Vec<(&'static str, String)> {
    let mean = finding::mean_value(model, b).map(|v| format!("{v:.0}"));
    let known = [
        ("Form", b.shape.map(|s| s.name().into())),
        ("Mean value within 3 mm", mean),
        ("Confidence", b.confidence.map(|c| c.name().into())),
    ];
    known.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
}

fn measured(model: &Model, m: &Measurement) -> MeasuredValue {
    let is_length = m.ruler == Ruler::Length;
    let of = model.bookmarks.iter().position(|b| m.finding == Some(b.id));
    let plane = if m.in_slice { " in a slice" } else { "" };
    MeasuredValue {
        name: m.name.clone(),
        text: format!("{}{plane}", m.text()),
        finding: of.map(|i| i + 1),
        points_mm: m.points_mm.clone(),
        is_length,
    }
}

/// The branch of a tree that is nearest to a place; `None` of a single path.
fn branch_at(graph: &CenterlineGraph, p: DVec3) -> Option<String> {
    if graph.edges.len() < 2 {
        return None;
    }
    let off = |q: &[f64; 4]| DVec3::new(q[0], q[1], q[2]).distance_squared(p);
    let places = graph.edges.iter().flat_map(|e| e.points.iter().map(move |q| (off(q), e)));
    let (_, edge) = places.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(format!("Branch of generation {}", edge.generation))
}

/// The picture of a bookmark, from memory or from its file.
pub(super) fn picture(b: &Bookmark, folder: Option<&Path>) -> Option<PngPicture> {
    const MAX_BYTES: u64 = 64 << 20;
    let png = match &b.png {
        Some(png) => png.to_vec(),
        None => {
            let path = folder?.join(b.picture.as_ref()?);
            let is_small = std::fs::metadata(&path).is_ok_and(|m| m.len() <= MAX_BYTES);
            is_small.then(|| std::fs::read(&path).ok()).flatten()?
        }
    };
    let size = png_size(&png)?;
    Some(PngPicture { size, png })
}

/// Three slices through a place of the wall, with a cross there.
fn slices(
    volume: &Volume,
    wall: Option<&TriangleBvh>,
    at: [f64; 3],
    window: [f64; 2],
) -> Vec<SliceView> {
    let size = [SLICE_PX; 2];
    let panes = [("axial", Pane::Axial), ("coronal", Pane::Coronal), ("sagittal", Pane::Sagittal)];
    let of = |(name, pane)| {
        let mm_per_px = SLICE_MM / SLICE_PX as f64;
        let plane = SlicePlane::of(pane, DVec3::from(at), mm_per_px, None)?;
        let mut pixels = slice(volume, None, &plane, size, window, None);
        wall.iter().for_each(|tree| draw_wall_outline(tree, &plane, size, &mut pixels));
        let middle = SLICE_PX / 2;
        for k in (4..14).flat_map(|k| [middle - k, middle + k]) {
            pixels[middle * SLICE_PX + k] = CROSS;
            pixels[k * SLICE_PX + middle] = CROSS;
        }
        let side = SLICE_PX as u32;
        let picture =
            PngPicture { size: [side; 2], png: encode_png(side, side, pixels.as_flattened()) };
        Some(SliceView { name, picture })
    };
    panes.into_iter().filter_map(of).collect()
}

/// The page of what a session has so far, with notes. Waits for its pictures to be drawn; computes no
/// product that the window does not show but the profile along the path.
///
/// # Errors
/// Errors of the profile and of the drawing.
pub(super) fn page(session: &Session, mut notes: Notes) -> Result<String, SessionError> {
    let of = [Product::Volume, Product::TriangleTree, Product::Flight];
    let there = session.products(&of);
    let has_path = there.has(Product::TriangleTree) && there.has(Product::Flight);
    let profile = has_path.then(|| session.lumen_profile()).transpose()?;
    let pictures = has_path.then(|| session.report_pictures(None)).transpose()?;
    for finding in &mut notes.findings {
        finding.start = notes.start.or(profile.as_ref().and_then(|p| p.start));
        if let (Some(volume), Some(at)) = (there.volume(), finding.wall_mm) {
            finding.slices = slices(volume, there.triangle_tree.as_deref(), at, notes.window);
        }
    }
    let report = session.report_so_far(None)?;
    let page = ReportPage {
        report: Some(&report),
        pictures: pictures.as_ref(),
        title: None,
        shown_fraction: notes.shown_fraction,
        findings: &notes.findings,
        measurements: &notes.measurements,
        category: notes.category,
    };
    Ok(page.html())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Branch, Centerline, CenterlinePoint, shapes};
    use crate::volume::{Grid, Samples};
    use std::sync::Arc;

    fn bookmark(png: Option<Vec<u8>>) -> Bookmark {
        Bookmark {
            text: "a fold".into(),
            position_mm: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            fov_deg: 90.0,
            arc_mm: Some(12.0),
            picture: Some("p-1.png".into()),
            png: png.map(Arc::new),
            id: 1,
            wall_mm: None,
            segment: None,
            shape: None,
            confidence: None,
            in_flight: false,
        }
    }

    #[test]
    fn a_finding_has_its_picture_from_memory_or_its_file_and_nothing_else_gets_in() {
        let mut model = Model::new(20.0);
        let png = encode_png(3, 2, &[9; 18]);
        model.bookmarks = vec![bookmark(Some(png.clone())), bookmark(None)];
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "p-1.png", &png).unwrap();
        let views = |model: &Model| -> Vec<Option<[u32; 2]>> {
            let notes = Notes::of(model, Some(dir.path()));
            notes.findings.iter().map(|f| f.view.as_ref().map(|v| v.size)).collect()
        };
        assert_eq!(views(&model), [Some([3, 2]); 2]);
        std::fs::write(dir.path().join("p-1.png"), "secret").unwrap();
        assert_eq!(views(&model), [Some([3, 2]), None], "a file that is no picture");
        assert_eq!(free_name(dir.path(), "p", "png"), "p-2.png");
    }

    #[test]
    fn the_wall_of_a_finding_is_in_the_middle_of_its_view_and_crossed_in_its_slices() {
        let wall = shapes::boxed(2);
        let (low, high) = wall.bounds().unwrap();
        let centre = (0.5 * (low + high)).as_dvec3();
        let eye = Bookmark { position_mm: centre.to_array(), ..bookmark(None) };
        let [x, y, z] = finding::wall_at(&eye, &TriangleBvh::new(&wall)).unwrap();
        assert!((x - centre.x).abs() < 1e-6 && (y - centre.y).abs() < 1e-6);
        assert!((z - f64::from(low.z)).abs() < 1e-6, "a camera looks along -z");
        let grid = Grid::axis_aligned([4, 4, 4], [1.0; 3]);
        let volume = Volume::new(grid, Samples::I16(vec![0i16; 64].into()));
        let three = slices(&volume, None, [1.0; 3], [0.0, 1.0]);
        assert_eq!(
            three.iter().map(|s| s.name).collect::<Vec<_>>(),
            ["axial", "coronal", "sagittal"]
        );
        assert_eq!(png_size(&three[0].picture.png), Some([SLICE_PX as u32; 2]));
    }

    #[test]
    fn a_place_in_a_tree_has_a_generation_and_one_on_a_path_has_none() {
        let point = |x, y| CenterlinePoint {
            position_mm: DVec3::new(x, y, 0.0),
            radius_mm: 1.0,
            abscissa_mm: 0.0,
        };
        let root = Branch {
            points: (0..5).map(|i| point(f64::from(i), 0.0)).collect(),
            ..Branch::default()
        };
        let mut line = Centerline { branches: vec![root] };
        assert_eq!(branch_at(&line.graph(), DVec3::ZERO), None);
        let start = Some(crate::geometry::Attachment { branch: 0, point: 2 });
        let side = vec![point(2.0, 0.0), point(2.0, 3.0)];
        line.branches.push(Branch { start, end: None, points: side });
        let at = |y| branch_at(&line.graph(), DVec3::new(2.0, y, 0.0));
        assert_eq!(at(3.0).as_deref(), Some("Branch of generation 1"));
        let trunk = branch_at(&line.graph(), DVec3::new(0.1, 0.0, 0.0));
        assert_eq!(trunk.as_deref(), Some("Branch of generation 0"));
    }
}
