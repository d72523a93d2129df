//! A series as a box of slices, or the reason why it is none.

use std::path::Path;
use std::sync::Arc;

use glam::{DMat3, DVec2, DVec3};

use super::super::FormatError;
use super::super::affine::grid;
use super::head::Head;
use super::pixels::{SlicePixels, Stored, read_slice};
use super::syntax::{self, Codec};
use super::upright::Upright;
use crate::formats::error::FieldValue;
use crate::volume::{Grid, Rescale, SampleType};

/// Largest angle between the stack's run and the slices' normal, degrees.
const MAX_TILT_DEG: f64 = 0.1;
/// Largest sideways drift of a slice, in pixels.
const MAX_DRIFT_PIXELS: f64 = 0.1;
/// Cosine of 20 degrees: a plane that is turned by more is oblique.
const NEAR_AXIS: f64 = 0.94;
/// Largest distance between the axes of two slices of one stack, both axes together.
pub(super) const MAX_TURNED: f64 = 2e-3;
/// Largest deviation of a step from the usual one, as a fraction.
pub(super) const MAX_UNEVEN: f64 = 0.01;

/// One slice of a stack.
pub(super) struct Slice {
    pub file: Arc<Path>,
    /// Index of the frame in its file, from 0.
    pub frame: usize,
    pub pixels: SlicePixels,
    pub rescale: Rescale,
    pub position_mm: DVec3,
}

/// A series that forms a box: slices in the order of their place along the normal.
pub(super) struct Stack {
    pub grid: Grid,
    pub stored: Stored,
    pub slices: Vec<Slice>,
    /// Resampling of askew or uneven slices onto a box; `None` where the slices form one.
    pub upright: Option<Upright>,
    /// First and last stored value of pixels that were not measured.
    pub padding: Option<[f64; 2]>,
    /// Notes on slices that were left out, sheared or interpolated.
    pub notes: Vec<String>,
}

/// In-plane geometry, the same for all slices.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    /// Direction of growing column number, and of growing row number.
    pub along_row: DVec3,
    pub along_column: DVec3,
    /// Distance between columns and between rows, mm.
    pub pixel_mm: [f64; 2],
}

impl Stack {
    /// Judges a series.
    ///
    /// # Errors
    /// [`FormatError`] says what keeps it from being a box, and by how much.
    pub fn new(path: &Path, heads: &[Head], fill_gaps: bool) -> Result<Self, FormatError> {
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
            if turned > MAX_TURNED {
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
        let mut notes = Vec::new();
        let before = slices.len();
        let slices = without_repeats(slices, place, stored.kind, [first.columns, first.rows])?;
        if slices.len() < before {
            let n = before - slices.len();
            notes.push(format!("{n} slices that repeat another were left out"));
        }
        let places: Vec<f64> = slices.iter().map(place).collect();
        let step = match places.len() {
            1 => SliceStep { mm: thickness(first)?, is_even: true },
            _ => step(path, &places, fill_gaps)?,
        };
        let tilt = tilt(&slices, &plane);
        if let Some(degrees) = tilt {
            notes.push(format!("gantry tilt of {degrees:.1} degrees: slices sheared to a box"));
        }
        if !step.is_even {
            notes.push(format!("uneven slices: interpolated every {:.3} mm", step.mm));
        }
        let (along_row, along_column) = (plane.along_row, plane.along_column);
        let spacing = DVec3::new(plane.pixel_mm[0], plane.pixel_mm[1], step.mm);
        let axes = DMat3::from_cols(along_row, along_column, normal);
        let origin = slices[0].position_mm;
        let is_box = tilt.is_none() && step.is_even;
        let upright = (!is_box).then(|| {
            let shift = |s: &Slice| {
                let by = s.position_mm - origin;
                DVec2::new(by.dot(along_row) / spacing.x, by.dot(along_column) / spacing.y)
            };
            let shifts = slices.iter().map(shift).collect();
            Upright::new([first.columns, first.rows], shifts, places, step.mm)
        });
        let (dims, origin) = match &upright {
            None => ([first.columns, first.rows, slices.len() as u32], origin),
            Some(u) => {
                let [x, y] = u.first.map(|n| n as f64);
                (u.dims, origin + along_row * (x * spacing.x) + along_column * (y * spacing.y))
            }
        };
        let grid = grid(path, dims.map(u64::from), spacing, origin, axes)?;
        let padding = stored.padding(first);
        Ok(Self { grid, stored, slices, upright, padding, notes })
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
    pub fn normal(&self) -> DVec3 {
        self.along_row.cross(self.along_column).normalize_or_zero()
    }

    /// The plane's name in the patient.
    pub fn name(&self) -> &'static str {
        let normal = self.normal().abs();
        let names = [(normal.x, "sagittal"), (normal.y, "coronal"), (normal.z, "axial")];
        names.into_iter().find(|(along, _)| *along > NEAR_AXIS).map_or("oblique", |(_, name)| name)
    }
}

/// Refuses a slice that cannot be read whatever its geometry.
fn refuse_unreadable(h: &Head) -> Result<(), FormatError> {
    let refuse = |what: String| Err(FormatError::unsupported(&h.file, what));
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
    if h.is_mosaic() {
        let what =
            "a mosaic of Siemens, all slices of a volume in one picture; dcm2niix takes it apart";
        return refuse(what.to_owned());
    }
    if !syntax::is_plain(&h.syntax) && Codec::of(&h.syntax).is_none() {
        let name = syntax::describe(&h.syntax);
        return refuse(format!("compressed pixels, transfer syntax {name}"));
    }
    Ok(())
}

pub(super) fn plane(h: &Head) -> Result<Plane, FormatError> {
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
    let pixels = stored.check_pixels(h)?;
    let rescale = Rescale { slope, intercept };
    let (file, position_mm) = (Arc::clone(&h.file), DVec3::from(position));
    Ok(Slice { file, frame: h.frame, pixels, rescale, position_mm })
}

/// Leaves out slices that lie where the one before lies and have its pixels.
fn without_repeats(
    slices: Vec<Slice>,
    place: impl Fn(&Slice) -> f64,
    kind: SampleType,
    side: [u32; 2],
) -> Result<Vec<Slice>, FormatError> {
    let bytes = side[0] as usize * side[1] as usize * kind.size();
    let pixels = |s: &Slice| {
        let mut own = vec![0; bytes];
        read_slice(&mut own, s, kind, side).map(|()| own)
    };
    let mut kept: Vec<Slice> = Vec::with_capacity(slices.len());
    for slice in slices {
        if let Some(last) = kept.last()
            && place(&slice) - place(last) < 1e-3
            && slice.position_mm.distance(last.position_mm) < 1e-3
            && slice.rescale == last.rescale
            && pixels(last)? == pixels(&slice)?
        {
            continue;
        }
        kept.push(slice);
    }
    Ok(kept)
}

/// The angle between the stack's run and the slices' normal, degrees, where the slices drift
/// sideways by more than a box allows.
fn tilt(slices: &[Slice], plane: &Plane) -> Option<f64> {
    let (first, normal) = (slices[0].position_mm, plane.normal());
    let sideways = |s: &Slice| {
        let run = s.position_mm - first;
        (run - normal * run.dot(normal)).length()
    };
    let worst = slices.iter().map(sideways).fold(0.0, f64::max);
    let along = (slices[slices.len() - 1].position_mm - first).dot(normal);
    let degrees = worst.atan2(along).to_degrees();
    let drifts = worst > MAX_DRIFT_PIXELS * plane.pixel_mm[0].min(plane.pixel_mm[1]);
    (degrees > MAX_TILT_DEG || drifts).then_some(degrees)
}

/// The step between the slices of a box.
struct SliceStep {
    mm: f64,
    /// Whether the slices lie at such steps already.
    is_even: bool,
}

/// The step between planes: their own, if it is one; else, where gaps may be filled, the smallest
/// that is more than half of the usual one.
fn step(path: &Path, places: &[f64], fill_gaps: bool) -> Result<SliceStep, FormatError> {
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
    let Some(i) = worst.filter(|&i| miss(steps[i]) > MAX_UNEVEN * usual) else {
        let mean = (places[places.len() - 1] - places[0]) / steps.len() as f64;
        return Ok(SliceStep { mm: rounded_mm(mean), is_even: true });
    };
    if !fill_gaps {
        let what = format!(
            "uneven slices: slices {} and {} are {:.2} mm apart (at {:.2} mm along the normal), \
             the usual step is {usual:.2} mm; --fill-gaps interpolates between them",
            i + 1,
            i + 2,
            steps[i],
            places[i],
        );
        return Err(FormatError::unsupported(path, what));
    }
    let least = sorted.iter().copied().find(|s| *s > 0.5 * usual).unwrap_or(usual);
    Ok(SliceStep { mm: rounded_mm(least), is_even: false })
}

/// A step without the last binary digits: positions are decimal text, and the noise of their
/// difference would make an isotropic volume look anisotropic.
pub(super) fn rounded_mm(mm: f64) -> f64 {
    (mm * 1e9).round() / 1e9
}

/// A single slice has no step; its thickness stands in, then 1 mm.
fn thickness(h: &Head) -> Result<f64, FormatError> {
    let [mm] = h.decimals(0x0018, 0x0050, "SliceThickness")?.unwrap_or([1.0]);
    Ok(if mm > 0.0 { mm } else { 1.0 })
}
