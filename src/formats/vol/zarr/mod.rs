//! OME-Zarr in (OME-NGFF 0.4 and 0.5: Zarr 2 and 3), and plain arrays of three axes.
//!
//! A folder of chunks, each a file, so that any box of the volume can be read without the rest. The
//! reader is ours: of the crates there are, one builds C and C++ and 165 others, and takes memory
//! for what a chunk claims before it is known (`docs/decisions/048-zarr-reader.md`).

mod array;
mod blosc;
mod codec;
mod decompress;
mod read;

use std::path::{Component, Path, PathBuf};

use glam::{DMat3, DVec3};
use serde_json::Value;

use super::FormatError;
use super::affine::grid_from_steps;
use super::text::mm_per;
use crate::volume::{Grid, Volume};
use array::{Meta, ZarrArray, metadata};

/// Files that say of a folder that it is a Zarr group or array.
const METADATA: [&str; 4] = ["zarr.json", ".zattrs", ".zgroup", ".zarray"];

/// A volume in a Zarr array, with its place in the patient.
pub(super) struct ZarrImage {
    /// Folder that was asked for.
    pub path: PathBuf,
    pub format: &'static str,
    pub grid: Grid,
    pub notes: Vec<String>,
    array: ZarrArray,
    /// Axes of the array that are x, y and z.
    axes: [usize; 3],
}

/// Folders between a level and the group that describes it, at most.
const MAX_NESTED: usize = 4;

/// File of a group's attributes, and the attributes.
type GroupAttributes = (PathBuf, Value);

/// Whether a folder is a Zarr group or array.
pub(super) fn is_zarr(path: &Path) -> bool {
    METADATA.iter().any(|name| path.join(name).is_file())
}

impl ZarrImage {
    /// Opens the first level of an image, or the level that the path names.
    ///
    /// # Errors
    /// [`FormatError`] names the metadata at fault.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let image = match ZarrArray::open(path)? {
            Some(array) => match image_above(path)? {
                Some((group, name)) => Self::of_level(path, array, &group, Some(&name))?,
                None => Self::plain(path, array)?,
            },
            None => Self::of_group(path, path)?,
        };
        image.array.check_size(path)?;
        Ok(image)
    }

    /// The first level of the image in a group, or of the first image of a collection of them.
    fn of_group(path: &Path, dir: &Path) -> Result<Self, FormatError> {
        let absent = || FormatError::unsupported(path, "a Zarr group without `multiscales`");
        let group = attributes(dir)?.ok_or_else(absent)?;
        let scales = multiscales(&group.1);
        if scales.is_null() {
            let is_collection = !group.1["bioformats2raw.layout"].is_null();
            if is_collection && dir == path && is_zarr(&dir.join("0")) {
                let mut image = Self::of_group(path, &dir.join("0"))?;
                image.notes.push("a collection of images: the first one is read".to_owned());
                return Ok(image);
            }
            return Err(absent());
        }
        let meta = Meta { file: &group.0, value: scales };
        let level = scales[0]["datasets"][0]["path"].as_str();
        let level = level.ok_or_else(|| meta.bad("datasets", "the first has no path"))?;
        let relative = Path::new(level);
        let is_inside = !level.is_empty()
            && relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        if !is_inside {
            return Err(meta.bad("path of a dataset", "must be relative, without `..`"));
        }
        let array = ZarrArray::open(&dir.join(relative))?;
        let array = array.ok_or_else(|| meta.bad("path of a dataset", "no array is there"))?;
        Self::of_level(path, array, &group, None)
    }

    /// An array that a group describes.
    ///
    /// * `level`: path of the array within the group; the first one where `None`.
    fn of_level(
        path: &Path,
        array: ZarrArray,
        group: &(PathBuf, Value),
        level: Option<&str>,
    ) -> Result<Self, FormatError> {
        let meta = Meta { file: &group.0, value: multiscales(&group.1) };
        let scales = &meta.value[0];
        let datasets = scales["datasets"].as_array().map(Vec::as_slice).unwrap_or_default();
        let is_level = |d: &&Value| level.is_none_or(|level| d["path"] == level);
        let dataset = datasets.iter().find(is_level);
        let dataset = dataset.ok_or_else(|| meta.bad("datasets", "the array is none of them"))?;
        let rank = array.shape.len();
        let axes = axes(&meta, &scales["axes"], rank)?;
        let mut map =
            Scaling { scale: vec![1.0; rank], translation: vec![0.0; rank], is_said: false };
        for list in [&dataset["coordinateTransformations"], &scales["coordinateTransformations"]] {
            map.follow(&meta, list)?;
        }
        let mut notes = Vec::new();
        if !map.is_said {
            notes.push("the file gives no scale; voxels of one unit are assumed".to_owned());
        }
        let directions = directions(&meta, &axes, &mut notes)?;
        let places = spatial(&meta, &axes, &array.shape)?;
        let unit_mm = units(&meta, &axes, places, &mut notes)?;
        let (mut steps, mut origin) = (DMat3::ZERO, DVec3::ZERO);
        for k in 0..3 {
            let unit = directions[k] * unit_mm[k];
            *steps.col_mut(k) = unit * map.scale[places[k]];
            origin += unit * map.translation[places[k]];
        }
        let dims = places.map(|a| array.shape[a]);
        let grid = grid_from_steps(meta.file, dims, steps, origin, DVec3::ONE)?;
        Ok(Self { path: path.to_owned(), format: "OME-Zarr", grid, notes, array, axes: places })
    }

    /// An array that nothing describes: its last three axes are z, y and x.
    fn plain(path: &Path, array: ZarrArray) -> Result<Self, FormatError> {
        let rank = array.shape.len();
        if rank < 3 || array.shape[..rank - 3].iter().any(|n| *n != 1) {
            let what = format!("a Zarr array of {rank} axes; a volume has 3");
            return Err(FormatError::unsupported(path, what));
        }
        let axes = [rank - 1, rank - 2, rank - 3];
        let dims = axes.map(|a| array.shape[a]);
        let grid = grid_from_steps(path, dims, DMat3::IDENTITY, DVec3::ZERO, DVec3::ONE)?;
        let notes = vec!["the array gives no spacing; 1 mm is assumed".to_owned()];
        Ok(Self { path: path.to_owned(), format: "Zarr", grid, notes, array, axes })
    }

    /// Stored type of the samples.
    pub fn sample_type(&self) -> crate::volume::SampleType {
        self.array.sample_type
    }

    /// Shape of the boxes that are read at once, x, y, z: the chunks'.
    pub fn block(&self) -> [u32; 3] {
        let shape = &self.array.chunk.shape;
        let dims = self.grid.dims.to_array();
        [0, 1, 2].map(|k| shape[self.axes[k]].min(u64::from(dims[k])) as u32)
    }

    /// Reads all samples.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn load(self) -> Result<Volume, FormatError> {
        let samples = self.read([0; 3], self.grid.dims.to_array())?;
        Ok(Volume::new(self.grid, samples))
    }

    /// Every file that reading may look at.
    pub fn files(&self) -> Result<Vec<PathBuf>, FormatError> {
        let dirs = [Some(&*self.path), Some(&*self.array.dir), self.array.dir.parent()];
        let mut files = self.array.files()?;
        for dir in dirs.into_iter().flatten() {
            files.extend(METADATA.iter().map(|name| dir.join(name)).filter(|f| f.is_file()));
        }
        files.sort();
        files.dedup();
        Ok(files)
    }
}

/// Attributes of a group, and the file they are in.
fn attributes(dir: &Path) -> Result<Option<GroupAttributes>, FormatError> {
    if let Some(mut value) = metadata(dir, "zarr.json")? {
        let mut own = value["attributes"].take();
        // 0.5 keeps its own under a name; before that they stood among the rest.
        if own["ome"].is_object() {
            own = own["ome"].take();
        }
        return Ok(Some((dir.join("zarr.json"), own)));
    }
    Ok(metadata(dir, ".zattrs")?.map(|value| (dir.join(".zattrs"), value)))
}

/// Attributes of the image that a level belongs to, and the name of the level in it: of the group above
/// the level, or of one farther above that lists the level.
fn image_above(level: &Path) -> Result<Option<(GroupAttributes, String)>, FormatError> {
    let whole = std::path::absolute(level).map_err(|e| FormatError::io(level, e))?;
    for (depth, above) in whole.ancestors().skip(1).take(MAX_NESTED).enumerate() {
        let name = whole.strip_prefix(above).unwrap_or(&whole);
        let name = name.to_string_lossy().replace('\\', "/");
        let group = match depth {
            0 => attributes(above)?,
            _ => attributes(above).ok().flatten(),
        };
        let Some(group) = group else { continue };
        let images = multiscales(&group.1).as_array().into_iter().flatten();
        let mut levels = images.filter_map(|image| image["datasets"].as_array()).flatten();
        let is_listed = levels.any(|level| level["path"] == name.as_str());
        if is_listed || (depth == 0 && !multiscales(&group.1).is_null()) {
            return Ok(Some((group, name)));
        }
    }
    Ok(None)
}

fn multiscales(attributes: &Value) -> &Value {
    &attributes["multiscales"]
}

/// Scale and translation of each axis.
struct Scaling {
    scale: Vec<f64>,
    translation: Vec<f64>,
    /// Whether a scale was among the transformations.
    is_said: bool,
}

impl Scaling {
    /// Applies transformations after those before.
    fn follow(&mut self, meta: &Meta, list: &Value) -> Result<(), FormatError> {
        for item in list.as_array().map(Vec::as_slice).unwrap_or_default() {
            let kind = item["type"].as_str();
            let numbers = match kind {
                Some("identity") => continue,
                Some(kind @ ("scale" | "translation")) => item[kind].as_array(),
                _ => return Err(meta.unsupported("a transformation but scale and translation")),
            };
            let numbers: Option<Vec<f64>> =
                numbers.and_then(|n| n.iter().map(Value::as_f64).collect());
            let numbers = numbers.filter(|n| n.len() == self.scale.len());
            let why = "expected a list of a number an axis";
            let numbers = numbers.ok_or_else(|| meta.bad("coordinateTransformations", why))?;
            self.is_said |= kind == Some("scale");
            for (k, n) in numbers.into_iter().enumerate() {
                if kind == Some("scale") {
                    self.scale[k] *= n;
                    self.translation[k] *= n;
                } else {
                    self.translation[k] += n;
                }
            }
        }
        Ok(())
    }
}

/// An axis of an image.
struct NamedAxis<'a> {
    name: &'a str,
    is_space: bool,
    unit: Option<&'a str>,
    /// Direction in a body (RFC 4), such as `left-to-right`.
    orientation: Option<&'a str>,
}

/// The axes of an image; those of versions before 0.4 have names only, or none.
fn axes<'a>(meta: &Meta, list: &'a Value, rank: usize) -> Result<Vec<NamedAxis<'a>>, FormatError> {
    let named = |name: &'a str, item: &'a Value| NamedAxis {
        name,
        is_space: item["type"].as_str().map_or(["x", "y", "z"].contains(&name), |t| t == "space"),
        unit: item["unit"].as_str(),
        orientation: item["orientation"]["value"].as_str(),
    };
    let axes: Option<Vec<NamedAxis>> = match list.as_array() {
        None => Some(["t", "c", "z", "y", "x"].map(|n| named(n, &Value::Null)).into()),
        Some(list) => list
            .iter()
            .map(|item| Some(named(item.as_str().or_else(|| item["name"].as_str())?, item)))
            .collect(),
    };
    let axes = axes.filter(|axes| axes.len() == rank);
    axes.ok_or_else(|| meta.bad("axes", "not one with a name for each axis of the array"))
}

/// The axes x, y and z: by their names, else the last three of space, z first. All others have
/// one sample.
fn spatial(meta: &Meta, axes: &[NamedAxis], shape: &[u64]) -> Result<[usize; 3], FormatError> {
    let space: Vec<usize> = (0..axes.len()).filter(|a| axes[*a].is_space).collect();
    let [a, b, c] = <[usize; 3]>::try_from(space).map_err(|space| {
        meta.unsupported(format!("{} axes of space; a volume has 3", space.len()))
    })?;
    for (axis, n) in shape.iter().enumerate().filter(|(axis, _)| ![a, b, c].contains(axis)) {
        if *n != 1 {
            let what = format!("{n} samples along axis {axis}, which is none of space");
            return Err(meta.unsupported(what));
        }
    }
    let place =
        |name: &str| [a, b, c].into_iter().find(|k| axes[*k].name.eq_ignore_ascii_case(name));
    Ok(match (place("x"), place("y"), place("z")) {
        (Some(x), Some(y), Some(z)) => [x, y, z],
        _ => [c, b, a],
    })
}

/// Millimetres in the unit of each axis of space.
fn units(
    meta: &Meta,
    axes: &[NamedAxis],
    places: [usize; 3],
    notes: &mut Vec<String>,
) -> Result<[f64; 3], FormatError> {
    if places.iter().any(|a| axes[*a].unit.is_none()) {
        notes.push("the file gives no unit; mm is assumed".to_owned());
    }
    let mm = |a: usize| axes[a].unit.map_or(Some(1.0), mm_per);
    let bad = || meta.bad("unit of an axis", "not a unit of length");
    Ok([
        mm(places[0]).ok_or_else(bad)?,
        mm(places[1]).ok_or_else(bad)?,
        mm(places[2]).ok_or_else(bad)?,
    ])
}

/// Directions in LPS of the axes x, y and z.
fn directions(
    meta: &Meta,
    axes: &[NamedAxis],
    notes: &mut Vec<String>,
) -> Result<[DVec3; 3], FormatError> {
    let mut out = [DVec3::X, DVec3::Y, DVec3::Z];
    let space: Vec<&NamedAxis> = axes.iter().filter(|a| a.is_space).collect();
    if space.iter().any(|a| a.orientation.is_none()) {
        notes.push("the file gives no orientation; LPS is assumed".to_owned());
        return Ok(out);
    }
    for (own, name) in out.iter_mut().zip(["x", "y", "z"]) {
        let axis = space.iter().find(|a| a.name.eq_ignore_ascii_case(name));
        *own = match axis.and_then(|a| a.orientation) {
            Some("right-to-left") => DVec3::X,
            Some("left-to-right") => DVec3::NEG_X,
            Some("anterior-to-posterior") => DVec3::Y,
            Some("posterior-to-anterior") => DVec3::NEG_Y,
            Some("inferior-to-superior") => DVec3::Z,
            Some("superior-to-inferior") => DVec3::NEG_Z,
            _ => return Err(meta.unsupported("this orientation of an axis")),
        };
    }
    Ok(out)
}
