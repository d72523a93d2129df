//! Samples in the type they were stored in. Nothing here converts a whole volume to float.

use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// Owner of samples that this crate did not allocate: a mapped file, an array of another language.
/// The slice is requested at every access, so that should cost nothing, and must be the same slice
/// each time.
pub type SharedSamples<T> = Arc<dyn AsRef<[T]> + Send + Sync>;

/// Samples of one type: owned, or borrowed from an owner elsewhere. Cloning borrowed samples copies
/// none; writing to them copies them first.
#[derive(Clone)]
pub enum SampleBuffer<T> {
    /// Samples allocated by this crate.
    Owned(Vec<T>),
    /// Samples of another owner, read only.
    Shared(SharedSamples<T>),
}

impl<T> Deref for SampleBuffer<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        match self {
            Self::Owned(v) => v,
            Self::Shared(s) => (**s).as_ref(),
        }
    }
}

impl<T: Clone> DerefMut for SampleBuffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        if let Self::Shared(s) = self {
            *self = Self::Owned((**s).as_ref().to_vec());
        }
        match self {
            Self::Owned(v) => v,
            Self::Shared(_) => &mut [],
        }
    }
}

impl<T: PartialEq> PartialEq for SampleBuffer<T> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl<T: fmt::Debug> fmt::Debug for SampleBuffer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self[..].fmt(f)
    }
}

impl<T> From<Vec<T>> for SampleBuffer<T> {
    fn from(v: Vec<T>) -> Self {
        Self::Owned(v)
    }
}

/// Stored types that readers may produce.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum SampleType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl SampleType {
    /// Returns the size of a sample, bytes.
    pub fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Whether the samples are integers.
    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// Returns the name used in messages and JSON (`int16`, `float32`, …).
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::U64 => "uint64",
            Self::I64 => "int64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }
}

/// Runs the body with `$s` bound to the typed slice of a [`Samples`].
macro_rules! with_samples {
    ($samples:expr, |$s:ident| $body:expr) => {
        match $samples {
            $crate::volume::Samples::U8($s) => $body,
            $crate::volume::Samples::I8($s) => $body,
            $crate::volume::Samples::U16($s) => $body,
            $crate::volume::Samples::I16($s) => $body,
            $crate::volume::Samples::U32($s) => $body,
            $crate::volume::Samples::I32($s) => $body,
            $crate::volume::Samples::U64($s) => $body,
            $crate::volume::Samples::I64($s) => $body,
            $crate::volume::Samples::F32($s) => $body,
            $crate::volume::Samples::F64($s) => $body,
        }
    };
}
pub(crate) use with_samples;

/// A sample type as a Rust type.
pub trait Sample: Copy + Send + Sync + PartialOrd + bytemuck::Pod + 'static {
    /// Stored type that corresponds to the Rust type.
    const TYPE: SampleType;
    /// Converts to f64; 64-bit integers beyond 2^53 round.
    fn to_f64(self) -> f64;
    /// Reverses the bytes.
    fn swap_bytes(self) -> Self;
}

macro_rules! samples {
    ($($variant:ident $t:ty;)*) => {
        /// All samples of a volume, x fastest.
        #[derive(Clone, Debug, PartialEq)]
        #[allow(missing_docs)]
        pub enum Samples { $($variant(SampleBuffer<$t>),)* }

        $(impl Sample for $t {
            const TYPE: SampleType = SampleType::$variant;
            #[inline]
            fn to_f64(self) -> f64 { self as f64 }
            fn swap_bytes(self) -> Self {
                let mut b = self.to_ne_bytes();
                b.reverse();
                <$t>::from_ne_bytes(b)
            }
        }

        impl From<Vec<$t>> for Samples {
            fn from(v: Vec<$t>) -> Self { Self::$variant(v.into()) }
        }

        impl From<SampleBuffer<$t>> for Samples {
            fn from(s: SampleBuffer<$t>) -> Self { Self::$variant(s) }
        }

        impl From<SharedSamples<$t>> for Samples {
            fn from(s: SharedSamples<$t>) -> Self { Self::$variant(SampleBuffer::Shared(s)) }
        })*

        impl Samples {
            /// Creates zeroed samples of a given type.
            pub fn zeroed(t: SampleType, len: usize) -> Self {
                match t { $(SampleType::$variant => vec![<$t>::default(); len].into(),)* }
            }
        }
    };
}

samples! {
    U8 u8;
    I8 i8;
    U16 u16;
    I16 i16;
    U32 u32;
    I32 i32;
    U64 u64;
    I64 i64;
    F32 f32;
    F64 f64;
}

impl Samples {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        with_samples!(self, |s| s.len())
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the stored type.
    pub fn sample_type(&self) -> SampleType {
        fn of<T: Sample>(_: &[T]) -> SampleType {
            T::TYPE
        }
        with_samples!(self, |s| of(s))
    }

    /// Returns the stored value at linear index `i` as f64.
    #[inline]
    pub fn get(&self, i: usize) -> f64 {
        with_samples!(self, |s| s[i].to_f64())
    }

    /// Returns the smallest and largest finite stored value.
    pub fn range(&self) -> Option<(f64, f64)> {
        self.range_without(None)
    }

    /// Returns the smallest and largest finite stored value outside `skipped`, a range with both
    /// ends.
    pub fn range_without(&self, skipped: Option<[f64; 2]>) -> Option<(f64, f64)> {
        if let Some([first, last]) = skipped {
            let values = (0..self.len()).map(|i| self.get(i));
            let counts = |v: &f64| v.is_finite() && !(first <= *v && *v <= last);
            return values.filter(counts).fold(None, |range: Option<(f64, f64)>, v| {
                Some(range.map_or((v, v), |(lo, hi)| (lo.min(v), hi.max(v))))
            });
        }
        fn of<T: Sample>(s: &[T]) -> Option<(f64, f64)> {
            let finite = |v: &&T| v.to_f64().is_finite();
            let first = *s.iter().find(finite)?;
            let (lo, hi) = s.iter().filter(finite).fold((first, first), |(lo, hi), &v| {
                (if v < lo { v } else { lo }, if v > hi { v } else { hi })
            });
            Some((lo.to_f64(), hi.to_f64()))
        }
        with_samples!(self, |s| of(s))
    }

    /// Returns the samples as native-endian bytes.
    pub fn bytes(&self) -> &[u8] {
        with_samples!(self, |s| bytemuck::cast_slice(s))
    }

    /// Returns the samples as native-endian bytes, to be filled by a reader; borrowed ones are
    /// copied.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        with_samples!(self, |s| bytemuck::cast_slice_mut(s))
    }

    /// Reverses the bytes of every sample in place.
    pub fn swap_bytes(&mut self) {
        with_samples!(self, |s| s.iter_mut().for_each(|v| *v = v.swap_bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Grid, Volume};

    #[test]
    fn borrowed_samples_are_read_in_place_and_copied_only_to_be_written() {
        let owner: Arc<[i16]> = (0..24).collect();
        let shared: SharedSamples<i16> = Arc::new(owner.clone());
        let grid = Grid::axis_aligned([2, 3, 4], [1.0; 3]);
        let mut borrowed = Volume::new(grid, shared.into());
        let owned = Volume::new(grid, owner.to_vec().into());
        assert_eq!(borrowed, owned);
        assert_eq!(borrowed.samples.bytes().as_ptr(), owner.as_ptr().cast());
        let clone = borrowed.clone();
        assert_eq!(clone.samples.bytes().as_ptr(), owner.as_ptr().cast());
        borrowed.samples.bytes_mut()[0] = 7;
        assert_ne!(borrowed, owned);
        assert_eq!((clone, owner[0]), (owned, 0));
    }
}
