//! Selection of voxels by stored value: thresholds and labels, in the stored type.

use glam::UVec3;

use super::{BitVolume, LumenError};
use crate::volume::{Sample, Volume, with_samples};

/// Set of real values (after rescale) that count as inside.
#[derive(Clone, Debug, PartialEq)]
pub enum IntensitySelection {
    /// Inclusive range; infinite ends are open.
    Range {
        /// Lower end.
        lo: f64,
        /// Upper end.
        hi: f64,
    },
    /// Any of these label values; empty means every non-zero value.
    Labels(Vec<i64>),
}

impl IntensitySelection {
    /// Whether a real value is inside. NaN never is.
    pub fn holds(&self, real: f64) -> bool {
        match self {
            Self::Range { lo, hi } => *lo <= real && real <= *hi,
            Self::Labels(l) if l.is_empty() => real != 0.0 && !real.is_nan(),
            Self::Labels(l) => l.iter().any(|&v| v as f64 == real),
        }
    }

    /// Every voxel of a volume that is inside, whatever it is connected to.
    pub fn select(&self, volume: &Volume) -> BitVolume {
        with_samples!(&volume.samples, |s| select(&self.stored(volume, s), s, volume.grid.dims))
    }

    /// The selection as a test on stored values.
    pub(super) fn stored<T: Sample>(&self, volume: &Volume, _: &[T]) -> StoredSelection<T> {
        let r = volume.rescale;
        match self {
            Self::Range { lo, hi } => {
                let (a, b) = (r.stored(*lo), r.stored(*hi));
                let (lo, hi) = if r.slope < 0.0 { (b, a) } else { (a, b) };
                StoredSelection::range(lo, hi).without(volume.padding)
            }
            Self::Labels(l) if l.is_empty() => {
                let zero = r.stored(0.0);
                let held = narrow::<T>(zero, true).filter(|z| z.to_f64() == zero);
                held.map_or(StoredSelection::Number, StoredSelection::Not)
            }
            Self::Labels(l) => {
                let mut stored: Vec<f64> = l.iter().map(|&v| r.stored(v as f64)).collect();
                stored.sort_by(f64::total_cmp);
                // One label, or labels without a gap, are a range: the common case, and fast.
                let dense = T::TYPE.is_integer() && stored.windows(2).all(|w| w[1] - w[0] == 1.0);
                match (stored.first(), stored.last()) {
                    (Some(&a), Some(&b)) if dense || a == b => StoredSelection::range(a, b),
                    _ => StoredSelection::Any(stored),
                }
            }
        }
    }
}

/// A selection in stored units of type `T`.
pub(super) enum StoredSelection<T> {
    /// Inclusive range; `None` when no value of the type can be inside.
    Range(Option<(T, T)>),
    /// Inclusive range less a second one.
    Without((T, T), (T, T)),
    /// All values except one, and except NaN.
    Not(T),
    /// All values except NaN.
    Number,
    Any(Vec<f64>),
}

impl<T: Sample> StoredSelection<T> {
    /// Ends are rounded inwards to values the type has. A relative slack of 1e-12 keeps a bound
    /// that went through the rescale from missing the value it came from.
    fn range(lo: f64, hi: f64) -> Self {
        let slack = |v: f64| if v.is_finite() { 1e-12 * v.abs().max(1.0) } else { 0.0 };
        let (lo, hi) = (lo - slack(lo), hi + slack(hi));
        Self::Range(narrow::<T>(lo, true).zip(narrow::<T>(hi, false)).filter(|(a, b)| a <= b))
    }

    /// A range without another, where they overlap.
    fn without(self, other: Option<[f64; 2]>) -> Self {
        let (Self::Range(Some(range)), Some([first, last])) = (&self, other) else { return self };
        match Self::range(first, last) {
            Self::Range(Some(other)) if other.0 <= range.1 && range.0 <= other.1 => {
                Self::Without(*range, other)
            }
            _ => self,
        }
    }

    #[inline]
    pub fn holds(&self, v: T) -> bool {
        match self {
            Self::Range(Some((lo, hi))) => *lo <= v && v <= *hi,
            Self::Range(None) => false,
            Self::Without((lo, hi), (a, b)) => *lo <= v && v <= *hi && !(*a <= v && v <= *b),
            Self::Not(value) => is_number(v) & (v != *value),
            Self::Number => is_number(v),
            Self::Any(l) => l.contains(&v.to_f64()),
        }
    }
}

/// Smallest value of `T` not below `bound` (`up`), or largest not above it.
fn narrow<T: Sample>(bound: f64, up: bool) -> Option<T> {
    use crate::volume::SampleType as S;
    fn cast<T: Sample, U: bytemuck::Pod>(v: U) -> T {
        *bytemuck::from_bytes(bytemuck::bytes_of(&v))
    }
    macro_rules! int {
        ($t:ty) => {{
            let v = if up { bound.ceil() } else { bound.floor() };
            if v.is_nan() || (up && v > <$t>::MAX as f64) || (!up && v < <$t>::MIN as f64) {
                return None;
            }
            cast(v as $t) // saturates at the open end
        }};
    }
    if bound.is_nan() {
        return None;
    }
    Some(match T::TYPE {
        S::U8 => int!(u8),
        S::I8 => int!(i8),
        S::U16 => int!(u16),
        S::I16 => int!(i16),
        S::U32 => int!(u32),
        S::I32 => int!(i32),
        S::U64 => int!(u64),
        S::I64 => int!(i64),
        S::F32 => cast(bound as f32),
        S::F64 => cast(bound),
    })
}

impl<T: Sample> StoredSelection<T> {
    /// Bits of up to 64 samples, the first in the lowest place.
    #[inline]
    pub fn word(&self, samples: &[T]) -> u64 {
        match self {
            Self::Range(Some((lo, hi))) => pack(samples, |v| (*lo <= v) & (v <= *hi)),
            Self::Range(None) => 0,
            Self::Without((lo, hi), (a, b)) => {
                pack(samples, |v| (*lo <= v) & (v <= *hi) & !((*a <= v) & (v <= *b)))
            }
            Self::Not(value) => pack(samples, |v| is_number(v) & (v != *value)),
            w => pack(samples, |v| w.holds(v)),
        }
    }
}

/// Not NaN.
#[inline]
#[allow(clippy::eq_op)]
fn is_number<T: PartialEq + Copy>(v: T) -> bool {
    v == v
}

fn select<T: Sample>(selection: &StoredSelection<T>, samples: &[T], dims: UVec3) -> BitVolume {
    let (nx, ny) = (dims.x as usize, dims.y as usize);
    BitVolume::from_rows(dims, |y, z, words| {
        let start = nx * (y as usize + ny * z as usize);
        for (word, voxels) in words.iter_mut().zip(samples[start..start + nx].chunks(64)) {
            *word = selection.word(voxels);
        }
    })
}

/// Comparisons fill a byte each, which compilers turn into lanes; a product then brings eight
/// bytes of 0 or 1 together in the top one.
#[inline]
fn pack<T: Copy>(samples: &[T], inside: impl Fn(T) -> bool) -> u64 {
    let mut bytes = [0u8; 64];
    match <&[T; 64]>::try_from(samples) {
        Ok(samples) => {
            for (b, v) in bytes.iter_mut().zip(samples) {
                *b = u8::from(inside(*v));
            }
        }
        Err(_) => {
            for (b, v) in bytes.iter_mut().zip(samples) {
                *b = u8::from(inside(*v));
            }
        }
    }
    let mut word = 0;
    for (i, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        let top = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        word |= top << (8 * i);
    }
    word
}

/// The voxel a seed names.
///
/// # Errors
/// [`LumenError::SeedOutside`] when it is not in the volume, [`LumenError::SeedValue`] when its
/// value is not in the selection.
pub(super) fn check_seed(
    volume: &Volume,
    selection: &IntensitySelection,
    seed: UVec3,
) -> Result<(), LumenError> {
    if seed.cmpge(volume.grid.dims).any() {
        return Err(LumenError::SeedOutside { seed, dims: volume.grid.dims });
    }
    let value = volume.real(volume.grid.index(seed));
    let is_padding = volume.is_padding(volume.samples.get(volume.grid.index(seed)));
    if is_padding || !selection.holds(value) {
        return Err(LumenError::SeedValue { seed, value, selection: selection.clone() });
    }
    Ok(())
}

impl std::fmt::Display for IntensitySelection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Range { lo, hi } => match (lo.is_finite(), hi.is_finite()) {
                (true, true) => write!(f, "threshold {lo}:{hi}"),
                (true, false) => write!(f, "threshold {lo}:"),
                (false, true) => write!(f, "threshold :{hi}"),
                (false, false) => write!(f, "threshold :"),
            },
            Self::Labels(l) if l.is_empty() => write!(f, "any label"),
            Self::Labels(l) => {
                let l: Vec<String> = l.iter().map(i64::to_string).collect();
                write!(f, "label {}", l.join(","))
            }
        }
    }
}
