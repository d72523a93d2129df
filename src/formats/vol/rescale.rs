//! Applying a rescale, for formats that have no field for it.

use std::borrow::Cow;

use crate::volume::{Rescale, Sample, SampleType, Samples, Volume, with_samples};

/// The real values of a volume in the smallest type that holds them: 16 or 32-bit integers where
/// every value is one, otherwise 32-bit floats for 8 and 16-bit samples and floats, 64-bit
/// floats for the rest.
pub(super) fn real_samples(volume: &Volume) -> Cow<'_, Samples> {
    let Rescale { slope, intercept } = volume.rescale;
    if volume.rescale == Rescale::IDENTITY {
        return Cow::Borrowed(&volume.samples);
    }
    let kind = volume.samples.sample_type();
    let whole = kind.is_integer() && slope.fract() == 0.0 && intercept.fract() == 0.0;
    let within = |lo: f64, hi: f64| {
        whole && volume.range().is_some_and(|(least, most)| least >= lo && most <= hi)
    };
    Cow::Owned(if within(f64::from(i16::MIN), f64::from(i16::MAX)) {
        map(volume, |v| v as i16).into()
    } else if within(f64::from(i32::MIN), f64::from(i32::MAX)) {
        map(volume, |v| v as i32).into()
    } else if kind.size() <= 2 || kind == SampleType::F32 {
        map(volume, |v| v as f32).into()
    } else {
        map(volume, |v| v).into()
    })
}

fn map<U>(volume: &Volume, to: impl Fn(f64) -> U) -> Vec<U> {
    fn over<T: Sample, U>(s: &[T], rescale: Rescale, to: impl Fn(f64) -> U) -> Vec<U> {
        s.iter().map(|v| to(rescale.real(v.to_f64()))).collect()
    }
    with_samples!(&volume.samples, |s| over(s, volume.rescale, to))
}
