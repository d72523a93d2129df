//! Speed along a path: slower where it is narrow, slower where the gaze turns.

use super::smoothed_below;

/// Fastest rotation of the gaze, radians a second (30 degrees).
pub const MAX_TURN_RAD_PER_S: f64 = std::f64::consts::PI / 6.0;
/// Slowest share of the cruising speed in a narrow place.
const MIN_SHARE: f64 = 0.25;
/// Slowest share of the cruising speed in a sharp turn; only a gaze that jumps needs it.
const MIN_TURNING: f64 = 0.002;
/// Length over which speed changes, mm.
const EASE_MM: f64 = 3.0;

/// Speed at equally spaced places of a path, and the time each is reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    step_mm: f64,
    speed: Vec<f64>,
    seconds: Vec<f64>,
}

impl Profile {
    /// Plans speeds.
    ///
    /// * `step_mm`: arc length between samples.
    /// * `radius_mm`: room about each sample.
    /// * `turn_rad`: rotation of the gaze between consecutive samples, one fewer than radii.
    /// * `cruise_mm_per_s`: speed where the path is straight and no narrower than its median; it is
    ///   never exceeded. Below the median radius speed falls in proportion, to a quarter.
    pub fn new(step_mm: f64, radius_mm: &[f64], turn_rad: &[f64], cruise_mm_per_s: f64) -> Self {
        let middle = median(radius_mm).max(1e-9);
        let turn = |i: usize| {
            let before = i.checked_sub(1).and_then(|i| turn_rad.get(i));
            f64::max(before.copied().unwrap_or(0.0), turn_rad.get(i).copied().unwrap_or(0.0))
        };
        let allowed: Vec<f64> = (0..radius_mm.len())
            .map(|i| {
                let wide = cruise_mm_per_s * (radius_mm[i] / middle).clamp(MIN_SHARE, 1.0);
                let turning = MAX_TURN_RAD_PER_S * step_mm / turn(i).max(1e-12);
                wide.min(turning.max(MIN_TURNING * cruise_mm_per_s))
            })
            .collect();
        let speed = smoothed_below(&allowed, (EASE_MM / step_mm).round() as usize);
        let mut t = 0.0;
        let seconds = (0..speed.len())
            .map(|i| {
                if i > 0 {
                    t += 0.5 * step_mm * (1.0 / speed[i - 1] + 1.0 / speed[i]);
                }
                t
            })
            .collect();
        Self { step_mm, speed, seconds }
    }

    /// Returns the length of the path, mm.
    pub fn length_mm(&self) -> f64 {
        self.step_mm * self.speed.len().saturating_sub(1) as f64
    }

    /// Returns the time the whole path takes, s.
    pub fn total_seconds(&self) -> f64 {
        self.seconds.last().copied().unwrap_or(0.0)
    }

    /// Returns the speed at an arc length, mm/s; beyond the ends that of the end.
    pub fn speed_at(&self, arc_mm: f64) -> f64 {
        self.sample(&self.speed, arc_mm)
    }

    /// Returns the time at which an arc length is reached, s.
    pub fn seconds_at(&self, arc_mm: f64) -> f64 {
        self.sample(&self.seconds, arc_mm)
    }

    /// Returns the arc length reached after a time, mm: the inverse of [`Profile::seconds_at`].
    pub fn arc_at(&self, seconds: f64) -> f64 {
        let i = self.seconds.partition_point(|t| *t <= seconds);
        if i == 0 {
            return 0.0;
        }
        if i == self.seconds.len() {
            return self.length_mm();
        }
        let (a, b) = (self.seconds[i - 1], self.seconds[i]);
        self.step_mm * ((i - 1) as f64 + (seconds - a) / (b - a))
    }

    fn sample(&self, values: &[f64], arc_mm: f64) -> f64 {
        let (i, t) = place(arc_mm / self.step_mm, values.len());
        match values {
            [] => 0.0,
            [one] => *one,
            _ => values[i] + t * (values[i + 1] - values[i]),
        }
    }
}

/// Returns the segment of a sequence of `len` samples and the fraction in it, clamped to the ends.
pub(super) fn place(at: f64, len: usize) -> (usize, f64) {
    let at = at.clamp(0.0, len.saturating_sub(1) as f64);
    let i = (at as usize).min(len.saturating_sub(2));
    (i, at - i as f64)
}

/// Returns the median; 0 of nothing.
pub(super) fn median(values: &[f64]) -> f64 {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_follows_the_radius_and_never_passes_the_cruise() {
        let n = 401; // 100 mm with a waist of a fifth in the middle
        let radius: Vec<f64> =
            (0..n).map(|i| if (180..220).contains(&i) { 1.0 } else { 5.0 }).collect();
        let p = Profile::new(0.25, &radius, &vec![0.0; n - 1], 20.0);
        assert!((p.speed_at(10.0) - 20.0).abs() < 1e-9 && (p.speed_at(50.0) - 5.0).abs() < 1e-9);
        for (i, r) in radius.iter().enumerate() {
            let s = 0.25 * i as f64;
            assert!(p.speed_at(s) <= 20.0 * (r / 5.0).max(0.25) + 1e-9, "{s}");
            assert!((p.arc_at(p.seconds_at(s)) - s).abs() < 1e-9);
            // smooth: a second's worth of speed takes millimetres to build up
            assert!((p.speed_at(s + 0.25) - p.speed_at(s)).abs() < 3.0, "{s}");
        }
        let straight = Profile::new(0.25, &vec![5.0; n], &vec![0.0; n - 1], 20.0);
        assert!((straight.total_seconds() - 5.0).abs() < 1e-9);
        assert!(p.total_seconds() > 6.0);
        assert_eq!((p.arc_at(-1.0), p.arc_at(1e9)), (0.0, p.length_mm()));
    }

    #[test]
    fn no_stretch_of_time_turns_the_gaze_faster_than_the_limit() {
        let n = 400;
        let turn: Vec<f64> =
            (0..n - 1).map(|i| if i % 97 == 40 { 0.2 } else { 0.001 * (i % 7) as f64 }).collect();
        let p = Profile::new(0.25, &vec![4.0; n], &turn, 30.0);
        for (i, t) in turn.iter().enumerate() {
            let s = 0.25 * i as f64;
            let dt = p.seconds_at(s + 0.25) - p.seconds_at(s);
            assert!(*t <= MAX_TURN_RAD_PER_S * dt * (1.0 + 1e-9), "segment {i}: {t} in {dt} s");
        }
    }
}
