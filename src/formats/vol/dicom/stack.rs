//! A series as a box of slices, or the reason why it is none.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::super::FormatError;
use super::super::affine::grid;
use super::head::Head;
use super::pixels::Stored;
use super::syntax;
use crate::formats::error::FieldValue;
use crate::volume::{Grid, Rescale};

/// Largest angle between the stack's run and the slices' normal, degrees.
const MOST_TILT_DEG: f64 = 0.1;
/// Largest sideways drift of a slice, in pixels.
const MOST_DRIFT_PIXELS: f64 = 0.1;
/// Largest deviation of a step from the usual one, as a fraction.
const MOST_UNEVEN: f64 = 0.01;

/// One slice of a stack.
pub(super) struct Slice {
    pub file: PathBuf,
    pub offset: u64,
    pub rescale: Rescale,
    position_mm: DVec3,
}

/// A series that forms a box: slices in the order of their place along the normal.
pub(super) struct Stack {
    pub grid: Grid,
    pub stored: Stored,
    pub slices: Vec<Slice>,
}

/// In-plane geometry, the same for all slices.
#[derive(Clone, Copy)]
struct Plane {
    /// Direction of growing column number, and of growing row number.
    along_row: DVec3,
    along_column: DVec3,
    /// Distance between columns and between rows, mm.
    pixel_mm: [f64; 2],
}

impl Stack {
    /// Judges a series.
    ///
    /// # Errors
    /// [`FormatError`] says what keeps it from being a box, and by how much.
    pub fn new(path: &Path, heads: &[Head]) -> Result<Self, FormatError> {
        let Some(first) = heads.first() else {
            return Err(FormatError::unsupported(path, "a series without slices"));
        };
        refuse_unreadable(first)?;
        let stored = Stored::of(first)?;
        let plane = plane(first)?;
        let mut slices = Vec::with_capacity(heads.len());
        for h in heads {
            refuse_unreadable(h)?;
            if (h.rows, h.columns) != (first.rows, first.columns) {
                let what = format!("slices of {}x{} pixels", first.columns, first.rows);
                let value = FieldValue::size(h.columns, h.rows);
                return Err(FormatError::field(&h.file, "Columns x Rows", value, what));
            }
            if Stored::of(h)? != stored {
                let what = "slices that differ in bits or sign";
                return Err(FormatError::unsupported(&h.file, what));
            }
            let other = self::plane(h)?;
            let turned = (other.along_row - plane.along_row).length()
                + (other.along_column - plane.along_column).length();
            if turned > 2e-3 {
                let degrees = plane.normal().angle_between(other.normal()).to_degrees();
                let what =
                    format!("mixed orientations in one series: planes {degrees:.1} degrees apart");
                return Err(FormatError::unsupported(path, what));
            }
            let scale = |i: usize| (other.pixel_mm[i] / plane.pixel_mm[i] - 1.0).abs();
            if scale(0).max(scale(1)) > 1e-3 {
                let value = FieldValue::numbers(&other.pixel_mm);
                let why = format!("the series has {:?} mm", plane.pixel_mm);
                return Err(FormatError::field(&h.file, "PixelSpacing", value, why));
            }
            slices.push(slice(h, stored)?);
        }
        let normal = plane.normal();
        let place = |s: &Slice| s.position_mm.dot(normal);
        slices.sort_by(|a, b| place(a).total_cmp(&place(b)));
        let places: Vec<f64> = slices.iter().map(place).collect();
        refuse_tilt(path, &slices, normal, plane.pixel_mm)?;
        let step_mm = match places.len() {
            1 => thickness(first)?,
            _ => even_step(path, &places)?,
        };
        let dims = [first.columns.into(), first.rows.into(), slices.len() as u64];
        let spacing = DVec3::new(plane.pixel_mm[0], plane.pixel_mm[1], step_mm);
        let axes = DMat3::from_cols(plane.along_row, plane.along_column, normal);
        let grid = grid(path, dims, spacing, slices[0].position_mm, axes)?;
        Ok(Self { grid, stored, slices })
    }

    /// The rescale of all slices, or the identity where they differ and it is applied on reading.
    pub fn shared_rescale(&self) -> Rescale {
        if self.rescale_differs() { Rescale::IDENTITY } else { self.slices[0].rescale }
    }

    /// Whether slices carry different rescales, as PET does.
    pub fn rescale_differs(&self) -> bool {
        self.slices.iter().any(|s| s.rescale != self.slices[0].rescale)
    }
}

impl Plane {
    fn normal(&self) -> DVec3 {
        self.along_row.cross(self.along_column).normalize_or_zero()
    }
}

/// What cannot be read whatever its geometry.
fn refuse_unreadable(h: &Head) -> Result<(), FormatError> {
    let refuse = |what: String| Err(FormatError::unsupported(&h.file, what));
    let frames = h.int(0x0028, 0x0008).unwrap_or(1);
    let enhanced = ["1.2.840.10008.5.1.4.1.1.2.1", "1.2.840.10008.5.1.4.1.1.4.1"];
    if frames > 1 || enhanced.contains(&h.text(0x0008, 0x0016).as_str()) {
        return refuse(format!("a multi-frame (enhanced) file of {frames} frames"));
    }
    match (h.int(0x0028, 0x0002).unwrap_or(1), h.text(0x0028, 0x0004).as_str()) {
        (1, "MONOCHROME2" | "") => {}
        (1, "MONOCHROME1") => {
            return refuse("MONOCHROME1, where large values are dark".to_owned());
        }
        (_, "PALETTE COLOR") => return refuse("palette colour".to_owned()),
        (n, space) if space == "RGB" || space.starts_with("YBR_") => {
            return refuse(format!("colour, {n} samples a pixel"));
        }
        (n, _) => return refuse(format!("{n} samples a pixel in an unknown colour space")),
    }
    if !syntax::is_plain(&h.syntax) {
        let name = syntax::describe(&h.syntax);
        return refuse(format!("compressed pixels, transfer syntax {name}"));
    }
    Ok(())
}

fn plane(h: &Head) -> Result<Plane, FormatError> {
    let need = |name: &str| FormatError::field(&h.file, name, "absent", "needed");
    let name = "PixelSpacing";
    let [between_rows, between_columns] =
        h.decimals(0x0028, 0x0030, name)?.ok_or_else(|| need(name))?;
    if between_rows <= 0.0 || between_columns <= 0.0 {
        let value = FieldValue::numbers(&[between_rows, between_columns]);
        return Err(FormatError::field(&h.file, name, value, "not positive"));
    }
    let name = "ImageOrientationPatient";
    let v: [f64; 6] = h.decimals(0x0020, 0x0037, name)?.ok_or_else(|| need(name))?;
    let (row, column) = (DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]));
    let unit = |v: DVec3| (v.length() - 1.0).abs() < 1e-2;
    if !(unit(row) && unit(column) && row.dot(column).abs() < 1e-2) {
        let value = FieldValue::numbers(&v);
        return Err(FormatError::field(&h.file, name, value, "not two square unit vectors"));
    }
    let pixel_mm = [between_columns, between_rows];
    Ok(Plane { along_row: row.normalize(), along_column: column.normalize(), pixel_mm })
}

fn slice(h: &Head, stored: Stored) -> Result<Slice, FormatError> {
    let name = "ImagePositionPatient";
    let missing = || FormatError::field(&h.file, name, "absent", "needed");
    let position: [f64; 3] = h.decimals(0x0020, 0x0032, name)?.ok_or_else(missing)?;
    let one = |element, name, none| {
        Ok::<f64, FormatError>(h.decimals::<1>(0x0028, element, name)?.map_or(none, |v| v[0]))
    };
    let slope = one(0x1053, "RescaleSlope", 1.0)?;
    let intercept = one(0x1052, "RescaleIntercept", 0.0)?;
    if slope == 0.0 {
        let why = "every value would be the same";
        return Err(FormatError::field(&h.file, "RescaleSlope", slope, why));
    }
    let offset = stored.check_pixels(h)?;
    let rescale = Rescale { slope, intercept };
    Ok(Slice { file: h.file.clone(), offset, rescale, position_mm: DVec3::from(position) })
}

/// Slices whose first pixels do not lie above each other along the normal make a sheared stack.
fn refuse_tilt(
    path: &Path,
    slices: &[Slice],
    normal: DVec3,
    pixel_mm: [f64; 2],
) -> Result<(), FormatError> {
    let first = slices[0].position_mm;
    let sideways = |s: &Slice| {
        let run = s.position_mm - first;
        (run - normal * run.dot(normal)).length()
    };
    let worst = slices.iter().map(sideways).fold(0.0, f64::max);
    let along = (slices[slices.len() - 1].position_mm - first).dot(normal);
    // Slices all in one place are duplicates, told as such later.
    if along < 1e-3 {
        return Ok(());
    }
    let degrees = worst.atan2(along).to_degrees();
    if degrees > MOST_TILT_DEG || worst > MOST_DRIFT_PIXELS * pixel_mm[0].min(pixel_mm[1]) {
        let what = format!(
            "gantry tilt or shear: slices drift sideways by up to {worst:.2} mm over {along:.1} \
             mm ({degrees:.1} degrees); resample the series first"
        );
        return Err(FormatError::unsupported(path, what));
    }
    Ok(())
}

/// The step between planes, mm, if it is one step.
fn even_step(path: &Path, places: &[f64]) -> Result<f64, FormatError> {
    let steps: Vec<f64> = places.windows(2).map(|w| w[1] - w[0]).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let twice = steps.iter().filter(|s| **s < 1e-3).count();
    if twice > 0 {
        let at = places[steps.iter().position(|s| *s < 1e-3).unwrap_or(0)];
        let what = format!(
            "duplicate slices: {twice} of {} share a place with another, first at {at:.2} mm \
             along the normal",
            places.len()
        );
        return Err(FormatError::unsupported(path, what));
    }
    let usual = sorted[sorted.len() / 2];
    let miss = |s: f64| (s - usual).abs();
    let worst = (0..steps.len()).max_by(|&a, &b| miss(steps[a]).total_cmp(&miss(steps[b])));
    if let Some(i) = worst.filter(|&i| miss(steps[i]) > MOST_UNEVEN * usual) {
        let what = format!(
            "uneven slices: slices {} and {} are {:.2} mm apart (at {:.2} mm along the normal), \
             the usual step is {usual:.2} mm",
            i + 1,
            i + 2,
            steps[i],
            places[i],
        );
        return Err(FormatError::unsupported(path, what));
    }
    // Positions are decimal text; the last binary digits of their difference are noise that would
    // make an isotropic volume look anisotropic.
    let mean = (places[places.len() - 1] - places[0]) / steps.len() as f64;
    Ok((mean * 1e9).round() / 1e9)
}

/// A single slice has no step; its thickness stands in, then 1 mm.
fn thickness(h: &Head) -> Result<f64, FormatError> {
    let [mm] = h.decimals(0x0018, 0x0050, "SliceThickness")?.unwrap_or([1.0]);
    Ok(if mm > 0.0 { mm } else { 1.0 })
}
