//! Planted faults, to test device loss, full disks and short reads.
//!
//! Compiled in only with the feature `faults`, which no release has. There the environment
//! variable `INTIMA_FAULT` holds `point:n` (comma separated): the n-th passage (from 1) of that
//! point and every later one fails. With `point:n-m` those up to the m-th fail.

/// A place in the code that can be made to fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// Writing to a file: answers as a full disk.
    Write,
    /// Giving a finished file its name: answers as a read-only file system.
    Rename,
    /// Syncing a folder after a file in it took its name: answers as a full disk.
    SyncFolder,
    /// Reading a file: ends early.
    Read,
    /// Allocating device memory.
    Allocate,
    /// Submitting to a queue: answers as a lost device.
    Submit,
    /// Creating an instance: answers as a machine without a driver.
    Instance,
    /// Error bounds of patches: answers with an eighth of the measured error.
    ErrorBound,
    /// Clearance of exterior cells in the occlusion test: answers with the largest there is.
    Occlusion,
    /// Creating the device and its parts: answers as exhausted host memory.
    Create,
    /// Waiting for the device: answers as a device that takes longer.
    Wait,
    /// A barrier between launches: is left out, so that validation has a hazard to report.
    Barrier,
}

#[cfg(feature = "faults")]
mod planted {
    use super::Point;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU32, Ordering};

    /// Name, first and last failing passage, number of passages so far.
    type Plant = (String, [u32; 2], AtomicU32);
    static PLANTS: OnceLock<Vec<Plant>> = OnceLock::new();

    pub fn hit(point: Point) -> bool {
        let plants = PLANTS.get_or_init(|| {
            let spec = std::env::var("INTIMA_FAULT").unwrap_or_default();
            spec.split(',')
                .filter_map(|p| p.split_once(':'))
                .map(|(name, n)| {
                    let (first, last) = n.split_once('-').unwrap_or((n, ""));
                    let passages = [first.parse().unwrap_or(1), last.parse().unwrap_or(u32::MAX)];
                    (name.to_owned(), passages, AtomicU32::new(0))
                })
                .collect()
        });
        let name = format!("{point:?}").to_lowercase();
        plants.iter().filter(|(at, _, _)| *at == name).any(|(_, [first, last], passed)| {
            (*first..=*last).contains(&(passed.fetch_add(1, Ordering::Relaxed) + 1))
        })
    }
}

/// Whether the fault planted at `point` strikes now. Always false without the feature.
#[inline]
pub fn hit(point: Point) -> bool {
    #[cfg(feature = "faults")]
    return planted::hit(point);
    #[cfg(not(feature = "faults"))]
    {
        let _ = point;
        false
    }
}
