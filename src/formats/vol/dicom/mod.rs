//! DICOM in and, of segmentations, out: one series of slices, single files or frames, plain or compressed, from a folder or a
//! file.
//!
//! Only the elements of an allowlist are ever decoded ([`element`]); no text of the patient gets
//! past that point. A series that is not a box of even slices is refused with the size of the
//! miss, never read as if it were one.

mod bare;
mod charset;
mod codec;
mod data_set;
mod element;
mod fragments;
mod head;
mod jpeg_scan;
mod pixels;
mod segment_write;
mod segmentation;
mod source_series;
mod split;
mod stack;
mod syntax;
mod upright;
mod walk;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::info::{ImageInfo, InputInfo, ScreenText, SeriesInfo};
use super::segments::printable;
use super::{FormatError, ReadOptions, segments};
use crate::volume::{Acquisition, Rescale, Volume};
pub use source_series::SourceSeries;

use head::Head;
use segmentation::Segmentation;
use stack::Stack;

/// Most slices of a series beside another one that does not stop a run: a reference picture, a dose
/// sheet.
const STRAY_SLICES: usize = 2;
/// More files than any series; a folder beyond it is not one.
const MAX_FILES: usize = 100_000;

/// Whether a SOP class is that of images captured from a screen, single or multi-frame.
fn is_capture(class: &str) -> bool {
    let rest = class.strip_prefix("1.2.840.10008.5.1.4.1.1.7");
    rest.is_some_and(|r| r.is_empty() || r.starts_with('.'))
}

/// Heads of one series.
struct Series {
    number: i64,
    uid: String,
    heads: Vec<Head>,
}

impl Series {
    fn acquisition(&self) -> Acquisition {
        let hash = || blake3::hash(self.uid.as_bytes()).to_hex()[..16].to_owned();
        let modality = self.heads.first().map_or("other", |head| head.modality);
        Acquisition { modality, series_hash: (self.uid != head::UNNAMED).then(hash) }
    }

    fn is_segmentation(&self) -> bool {
        self.heads.first().is_some_and(Head::is_segmentation)
    }

    /// Refuses a volume of which a file is missing: the frames of a concatenation are spread over
    /// several (PS3.3 C.7.6.16.1), and a last part would not be missed by its places.
    fn refuse_missing_parts(&self) -> Result<(), FormatError> {
        let mut parts = BTreeMap::<String, BTreeSet<i64>>::new();
        for h in &self.heads {
            let uid = h.text(0x0020, 0x9161);
            if let (false, Some(part)) = (uid.is_empty(), h.int(0x0020, 0x9162)) {
                parts.entry(uid).or_default().insert(part);
            }
        }
        for h in &self.heads {
            let Some(found) = parts.get(&h.text(0x0020, 0x9161)) else { continue };
            // The number of parts may be left away; no part has a greater number.
            let total = h.int(0x0020, 0x9163);
            let all = total.max(found.last().copied()).unwrap_or(0);
            if (found.len() as i64) < all {
                let why = format!("{} of its parts are there", found.len());
                let name = "InConcatenationTotalNumber";
                return Err(FormatError::field(&h.file, name, all, why));
            }
        }
        Ok(())
    }

    fn refuse_identifying(&self, options: &ReadOptions) -> Result<(), FormatError> {
        match self.identifying() {
            Some((slice, what)) if !options.allow_burned_in => {
                let why = format!(
                    "the pixels may show who the patient is ({what}); --allow-burned-in reads them"
                );
                Err(FormatError::text(&slice.file, "pixels", why))
            }
            _ => Ok(()),
        }
    }

    /// A slice whose pixels may say who the patient is, by its own word: text was burned into
    /// them, a face can be recognised, or they were captured from a screen.
    fn identifying(&self) -> Option<(&Head, &'static str)> {
        let yes = |h: &Head, element| h.text(0x0028, element).eq_ignore_ascii_case("YES");
        self.heads.iter().find_map(|h| {
            let why = match () {
                () if yes(h, 0x0301) => "BurnedInAnnotation",
                () if yes(h, 0x0302) => "RecognizableVisualFeatures",
                () if is_capture(&h.text(0x0008, 0x0016)) => "Secondary Capture",
                () => return None,
            };
            Some((h, why))
        })
    }
}

/// Series of a folder or file, with notes of the files passed over.
struct Found {
    series: Vec<Series>,
    notes: Vec<String>,
}

impl Found {
    /// Notes on the stray series beside the one that is taken without being named.
    fn strays(&self, options: &ReadOptions) -> Option<String> {
        let main = main_series(&self.series)
            .filter(|_| options.series.is_none() && options.volume.is_none())?;
        let others = (0..self.series.len()).filter(|i| *i != main);
        let named = others.map(|i| {
            let s = &self.series[i];
            format!("{i} ({}, {} slices)", s.heads[0].modality, s.heads.len())
        });
        let named: Vec<String> = named.collect();
        let passed = format!("passed over series {}; --series takes one", named.join(", "));
        (!named.is_empty()).then_some(passed)
    }
}

/// Whether a file begins as a data set without preamble does.
pub(super) fn is_bare(head: &[u8]) -> bool {
    bare::syntax_of(head).is_some()
}

pub(super) fn read(path: &Path, options: &ReadOptions) -> Result<Volume, FormatError> {
    let found = find(path)?;
    for note in found.notes.iter().chain(&found.strays(options)) {
        tracing::warn!("DICOM: {note}");
    }
    let chosen = choose(path, &found.series, options)?;
    let series = &found.series[chosen];
    series.refuse_missing_parts()?;
    if series.is_segmentation() {
        let segmentation = Segmentation::new(path, &series.heads)?;
        series.refuse_identifying(options)?;
        let volume = segmentation.read(&options.segments)?;
        return Ok(Volume { acquisition: Some(series.acquisition()), ..volume });
    }
    segments::chosen(path, &[], &options.segments)?;
    let stack = Stack::new(path, &series.heads, options.fill_gaps)?;
    series.refuse_identifying(options)?;
    for note in &stack.notes {
        tracing::warn!("DICOM: {note}");
    }
    Ok(Volume { acquisition: Some(series.acquisition()), ..pixels::read(path, &stack)? })
}

pub(super) fn inspect(path: &Path, options: &ReadOptions) -> Result<InputInfo, FormatError> {
    let found = find(path)?;
    let series = list(path, &found.series, options);
    let mut notes = found.notes.clone();
    notes.extend(found.strays(options));
    let open = options.series.is_none()
        && options.volume.is_none()
        && found.series.len() > 1
        && main_series(&found.series).is_none();
    let mut segments = Vec::new();
    let mut acquisition = None;
    let image = if open {
        None
    } else {
        let chosen = &found.series[choose(path, &found.series, options)?];
        if let Some((_, name)) = chosen.identifying() {
            notes.push(format!("its pixels may show who the patient is ({name})"));
        }
        acquisition = Some(chosen.acquisition());
        if chosen.is_segmentation() {
            segments = chosen.heads[0].segments.to_vec();
            let seg = Segmentation::new(path, &chosen.heads)?;
            Some(ImageInfo::of(&seg.grid, seg.sample_type(), Rescale::IDENTITY))
        } else {
            let stack = Stack::new(path, &chosen.heads, options.fill_gaps)?;
            notes.extend(stack.notes.iter().cloned());
            let image = ImageInfo::of(&stack.grid, stack.sample_type(), stack.shared_rescale());
            Some(ImageInfo { reading_bytes: stack.reading_bytes(), ..image })
        }
    };
    Ok(InputInfo { format: "DICOM".to_owned(), image, series, segments, notes, acquisition })
}

/// Reads the heads of all files and sorts them into series.
fn find(path: &Path) -> Result<Found, FormatError> {
    // A directory file stands for the folder that it lists.
    let is_directory = path.file_name().is_some_and(|n| n.eq_ignore_ascii_case("DICOMDIR"));
    let path = match path.parent() {
        Some(parent) if is_directory && path.is_file() => match parent.as_os_str().is_empty() {
            true => Path::new("."),
            false => parent,
        },
        _ => path,
    };
    let folder = path.is_dir();
    let files = if folder { files_in(path)? } else { vec![path.to_owned()] };
    let heads: Vec<_> = files.par_iter().map(|f| head::read(f)).collect();
    let (mut other, mut without_pixels, mut localizers) = (0, 0, 0);
    let (mut damaged, mut unsupported) = (None, Vec::new());
    let mut series = BTreeMap::<(Arc<str>, bool), Vec<Head>>::new();
    for (file, result) in files.iter().zip(heads) {
        match result {
            Ok(Some(heads)) => {
                let Some(first) = heads.first() else { continue };
                if first.pixels.is_none() {
                    without_pixels += 1;
                    if !folder {
                        let what = match first.is_parametric_map() {
                            true => "a parametric map, whose pixels are of floating point".into(),
                            false => {
                                let modality = first.modality;
                                format!("a DICOM file without pixels (modality {modality})")
                            }
                        };
                        return Err(FormatError::unsupported(path, what));
                    }
                } else if folder && first.is_localizer() {
                    localizers += 1;
                } else {
                    let key = (Arc::clone(&first.series_uid), first.is_segmentation());
                    series.entry(key).or_default().extend(heads);
                }
            }
            Ok(None) if folder => other += 1,
            Ok(None) => {
                let why = "a DICOM file holds `DICM` at byte 128";
                return Err(FormatError::field(path, "magic", "absent", why));
            }
            // A dose or a film beside the series that is wanted.
            Err(e @ FormatError::Unsupported { .. }) if folder && !head::is_volume(file) => {
                unsupported.push(e);
            }
            Err(e) => {
                damaged.get_or_insert(e);
            }
        }
    }
    // A slice that cannot be read would be a hole in its series.
    if let Some(e) = damaged {
        return Err(e);
    }
    if series.is_empty() {
        if !unsupported.is_empty() {
            return Err(unsupported.swap_remove(0));
        }
        let what = format!("a folder without DICOM images ({} files)", files.len());
        return Err(FormatError::unsupported(path, what));
    }
    let mut notes = Vec::new();
    if other > 0 {
        notes.push(format!("{other} files that are not DICOM were passed over"));
    }
    if without_pixels > 0 {
        notes.push(format!("{without_pixels} DICOM files without pixels were passed over"));
    }
    if let Some(FormatError::Unsupported { what, .. }) = unsupported.first() {
        let n = unsupported.len();
        notes.push(format!("{n} DICOM files were passed over, the first: {what}"));
    }
    if localizers > 0 {
        notes.push(format!("{localizers} localizers were passed over"));
    }
    let mut series: Vec<Series> = series
        .into_iter()
        .flat_map(|((uid, _), heads)| {
            let number = heads[0].series_number;
            let parts = match heads[0].is_segmentation() {
                true => vec![heads],
                false => split::stacks(heads),
            };
            parts.into_iter().map(move |heads| Series { number, uid: uid.to_string(), heads })
        })
        .collect();
    // A segmentation beside the images it was drawn on is no choice for a volume.
    if series.iter().any(|s| !s.is_segmentation()) {
        let before = series.len();
        series.retain(|s| !s.is_segmentation());
        match before - series.len() {
            0 => {}
            n => {
                notes.push(format!("{n} segmentations were passed over; --mask takes their files"))
            }
        }
    }
    series.sort_by(|a, b| (a.number, &a.uid).cmp(&(b.number, &b.uid)));
    Ok(Found { series, notes })
}

/// Folders below the one that is opened: media have patient, study and series.
const MAX_DEPTH: usize = 8;

/// Plain files in a folder and those below it, in the order of their names. A folder that links
/// lead to again is read once, at the place that is found first.
pub(super) fn files_in(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let mut files = Vec::new();
    let mut folders = VecDeque::from([(folder.to_owned(), 0)]);
    let mut seen = BTreeSet::new();
    let mut entries = 0;
    while let Some((at, depth)) = folders.pop_front() {
        let io = |e| FormatError::io(&at, e);
        if !seen.insert(at.canonicalize().map_err(io)?) {
            continue;
        }
        let mut below = Vec::new();
        for entry in std::fs::read_dir(&at).map_err(io)? {
            let entry = entry.map_err(io)?.path();
            if entry.is_dir() && depth < MAX_DEPTH {
                below.push(entry);
            } else if entry.is_file() {
                files.push(entry);
            }
            entries += 1;
            if entries > MAX_FILES {
                let what = format!("a folder of more than {MAX_FILES} files");
                return Err(FormatError::unsupported(folder, what));
            }
        }
        below.sort();
        folders.extend(below.into_iter().map(|f| (f, depth + 1)));
    }
    files.sort();
    Ok(files)
}

/// The only series with more slices than a stray picture has.
fn main_series(series: &[Series]) -> Option<usize> {
    let mut long = (0..series.len()).filter(|i| series[*i].heads.len() > STRAY_SLICES);
    long.next().filter(|_| long.next().is_none())
}

fn choose(path: &Path, series: &[Series], options: &ReadOptions) -> Result<usize, FormatError> {
    if series.len() == 1 && options.series.is_none() && options.volume.unwrap_or(0) == 0 {
        return Ok(0);
    }
    let listed = list(path, series, options);
    let fail = |why: String| {
        // By what tells them apart at a glance. A UID is for machines and leads to the patient; the
        // description is text of the input, which no message shows.
        let line = |s: &SeriesInfo| {
            let [x, y, _] = s.dims;
            let of = Some(s.distinction()).filter(|words| !words.is_empty());
            let of = of.map_or_else(String::new, |words| format!(" of {words}"));
            format!("\n  {}  {}  {x}x{y}, {} slices{of}", s.index, s.modality, s.slices)
        };
        let list = listed.iter().map(line).collect();
        FormatError::Series { file: path.to_owned(), why, list }
    };
    let stacks_of =
        |uid: &str| -> Vec<usize> { (0..series.len()).filter(|i| series[*i].uid == uid).collect() };
    let stacks = match options.series.as_deref().map(str::trim) {
        Some(wish) => {
            let index = wish.parse().ok().filter(|&i: &usize| i < series.len());
            match (stacks_of(wish), index) {
                (stacks, _) if !stacks.is_empty() => stacks,
                // With a volume, an index stands for its whole series.
                (_, Some(i)) if options.volume.is_some() => stacks_of(&series[i].uid),
                (_, Some(i)) => vec![i],
                (_, None) => return Err(fail("holds no series of that UID or index".into())),
            }
        }
        None if series.iter().all(|s| s.uid == series[0].uid) => (0..series.len()).collect(),
        None => match main_series(series) {
            Some(main) => vec![main],
            None => return Err(fail(format!("holds {} series", series.len()))),
        },
    };
    let (count, main) = (stacks.len(), main_series(series).filter(|i| stacks.contains(i)));
    match (options.volume, main) {
        (Some(n), _) => stacks.get(n).copied().ok_or_else(|| {
            fail(format!("holds {count} volumes of that series, counted from 0: there is no {n}"))
        }),
        (None, _) if count == 1 => Ok(stacks[0]),
        (None, Some(main)) => Ok(main),
        (None, None) => {
            // Stacks of one shape differ in time, echo or phase, the others in orientation or size.
            let shape = |i: &usize| (listed[*i].dims, listed[*i].plane);
            let are_alike = stacks.iter().all(|i| shape(i) == shape(&stacks[0]));
            Err(fail(match are_alike {
                true => {
                    let last = count - 1;
                    format!("holds {count} volumes of one series; --volume 0 to {last} takes one")
                }
                false => format!("holds {count} series"),
            }))
        }
    }
}

fn list(path: &Path, series: &[Series], options: &ReadOptions) -> Vec<SeriesInfo> {
    let info = |(index, s): (usize, &Series)| {
        let first = &s.heads[0];
        let grid = match s.is_segmentation() {
            true => Segmentation::new(path, &s.heads).ok().map(|seg| seg.grid),
            false => Stack::new(path, &s.heads, options.fill_gaps).ok().map(|stack| stack.grid),
        };
        let slices = match grid {
            Some(grid) if s.is_segmentation() => grid.dims.z as usize,
            _ => s.heads.len(),
        };
        let thickness = first.decimals::<1>(0x0018, 0x0050, "SliceThickness");
        SeriesInfo {
            index,
            uid: s.uid.clone(),
            modality: first.modality.to_owned(),
            dims: [first.columns, first.rows, slices as u32],
            spacing_mm: grid.map(|grid| grid.spacing_mm.to_array()),
            slices,
            description: ScreenText(printable(&first.text(0x0008, 0x103e))),
            kernel: ScreenText(printable(&first.text(0x0018, 0x1210).replace('\\', " "))),
            thickness_mm: thickness.ok().flatten().map(|[mm]| mm),
            plane: stack::plane(first).map_or("", |plane| plane.name()),
        }
    };
    series.iter().enumerate().map(info).collect()
}
