//! Named segments of a segmentation, and which of them are read.

use std::path::Path;

use super::FormatError;
use super::info::SegmentInfo;
use super::layout::{Layout, zeroed};
use crate::volume::{Sample, SampleType, Samples, Volume, with_samples};

/// Longest name that is kept, in characters.
const MAX_NAME: usize = 128;

/// A segment's name as it is shown and compared: one line, not too long.
pub(super) fn printable(name: &str) -> String {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    let short: String = name.chars().take(MAX_NAME).map(plain).collect();
    short.trim().to_owned()
}

/// The segments with the wanted names, as they are spelled or else in any case; of equal names all.
///
/// # Errors
/// [`FormatError::Segments`] for a name that no segment has.
pub(super) fn chosen<'a>(
    file: &Path,
    segments: &'a [SegmentInfo],
    names: &[String],
) -> Result<Vec<&'a SegmentInfo>, FormatError> {
    let refuse = |why| FormatError::Segments { file: file.to_owned(), why };
    let mut out = Vec::new();
    for name in names {
        let name = name.trim();
        if segments.is_empty() {
            return Err(refuse(format!("names no segments, so there is no segment `{name}`")));
        }
        let before = out.len();
        out.extend(segments.iter().filter(|s| s.name == name));
        if out.len() == before {
            let lower = name.to_lowercase();
            out.extend(segments.iter().filter(|s| s.name.to_lowercase() == lower));
        }
        if out.len() == before {
            let n = segments.len();
            let why = format!("no segment is called `{name}`; `intima info` lists its {n} names");
            return Err(refuse(why));
        }
    }
    Ok(out)
}

/// Segments that may overlap, and nobody said which is wanted.
pub(super) fn overlapping(file: &Path, n: usize) -> FormatError {
    let why = match n {
        0 => "its layers may overlap and have no names to choose from".to_owned(),
        _ => format!(
            "its {n} segments may overlap: choose with --segment; `intima info` lists their names"
        ),
    };
    FormatError::Segments { file: file.to_owned(), why }
}

/// Reads what lies in a file: its one layer as it is, or, where segments are chosen, 1 in any of
/// them and 0 elsewhere.
pub(super) fn read(layout: Layout, names: &[String]) -> Result<Volume, FormatError> {
    let chosen = chosen(&layout.path, &layout.segments, names)?;
    if chosen.is_empty() {
        return match layout.layers {
            1 => layout.load(),
            _ => Err(overlapping(&layout.path, layout.segments.len())),
        };
    }
    // Of each layer the wanted labels, ascending.
    let mut labels = vec![Vec::new(); layout.layers];
    for s in chosen {
        let Some(own) = labels.get_mut(s.layer) else {
            let why = format!("the file has {} layers", layout.layers);
            return Err(FormatError::field(
                &layout.path,
                "layer of a segment",
                s.layer as u64,
                why,
            ));
        };
        own.push(s.label);
    }
    for own in &mut labels {
        own.sort_unstable();
        own.dedup();
    }
    let samples = layout.samples()?;
    let mut inside = zeroed(&layout.path, SampleType::U8, layout.grid.len())?;
    if let Samples::U8(inside) = &mut inside {
        with_samples!(&samples, |s| mark(inside, s, &labels));
    }
    Ok(Volume::new(layout.grid, inside))
}

/// Sets the voxels in which a layer has one of its labels.
///
/// * `labels`: of each layer, ascending.
fn mark<T: Sample>(inside: &mut [u8], samples: &[T], labels: &[Vec<i64>]) {
    let is_chosen = |(value, own): (&T, &Vec<i64>)| {
        let value = value.to_f64();
        // A fraction is no label.
        value.fract() == 0.0 && own.binary_search(&(value as i64)).is_ok()
    };
    let layers = labels.len();
    for (to, from) in inside.chunks_mut(1 << 20).zip(samples.chunks(layers << 20)) {
        crate::task::checkpoint();
        for (to, voxel) in to.iter_mut().zip(from.chunks_exact(layers)) {
            *to = u8::from(voxel.iter().zip(labels).any(is_chosen));
        }
    }
}
