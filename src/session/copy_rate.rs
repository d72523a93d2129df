//! Copy bandwidth of a device's memory: the rate that kernels are compared with.

use super::SessionError;
use crate::compute::Plan;
use crate::device::Device;
use crate::kernels::copy::{Bindings, KERNEL, Params};

/// Times of a copy.
#[derive(Clone, Debug, serde::Serialize)]
pub struct CopyRate {
    /// Bytes read, and as many written.
    pub bytes: u64,
    /// Seconds of each copy, ascending: on a GPU from timestamp queries.
    #[serde(skip)]
    pub seconds: Vec<f64>,
    /// Rate of the median copy, bytes read and written, 10⁹ a second; 0 without timestamps.
    pub gb_per_s: f64,
}

/// Copies of `bytes` (made whole quads of 16, and fewer where a buffer may not be so large) from
/// one buffer of the device to another, timed as any kernel.
///
/// Both have been written before the first timed copy: memory that the system has yet to give, or
/// gives as one shared page of zeros, is not what is measured.
///
/// # Errors
/// The device's.
pub fn copy_rate(device: &mut Device, bytes: u64, runs: usize) -> Result<CopyRate, SessionError> {
    let quads = (bytes.min(device.max_buffer_bytes()) / 16) as usize;
    let mut plan = Plan::new();
    let (a, b) = (plan.zeroed("a", quads), plan.undefined("b", quads));
    for i in 0..runs + 2 {
        let (source, copied) = if i % 2 == 0 { (a, b) } else { (b, a) };
        let params = Params { quads: quads as u32 };
        plan.launch(&KERNEL, Bindings { source, copied }, params, quads, quads);
    }
    let out = device.run(&plan)?;
    let mut seconds: Vec<f64> = out.times.iter().skip(2).map(|t| t.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let bytes = 16 * quads as u64;
    let median = seconds.get(seconds.len() / 2).copied().unwrap_or(0.0);
    let gb_per_s = if median > 0.0 { 2e-9 * bytes as f64 / median } else { 0.0 };
    Ok(CopyRate { bytes, seconds, gb_per_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_timed_copy_is_counted_and_the_rate_is_that_of_the_median() {
        let rate = copy_rate(&mut Device::Cpu, 1_000_007, 3).unwrap();
        assert_eq!((rate.bytes, rate.seconds.len()), (1_000_000, 3));
        assert!(rate.seconds.is_sorted());
        assert!((rate.gb_per_s * rate.seconds[1] - 2e-3).abs() < 1e-9, "{rate:?}");
    }
}
