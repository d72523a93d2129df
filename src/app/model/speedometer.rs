//! Speed of the eye as it was flown.

use std::collections::VecDeque;

/// Time over which the speed is averaged, s.
const WINDOW_S: f64 = 0.4;

/// Lengths flown in the last moments. Jumps are not flown.
#[derive(Default)]
pub(super) struct Speedometer {
    /// Length flown since time passed last, mm.
    mm: f64,
    /// Seconds and millimetres of the last steps.
    steps: VecDeque<(f64, f64)>,
}

impl Speedometer {
    /// The eye has flown a length, mm.
    pub fn fly(&mut self, mm: f64) {
        self.mm += mm.abs();
    }

    /// Time has passed, s. An eye that has not moved meanwhile stands still.
    pub fn pass(&mut self, dt: f64) {
        let mm = std::mem::take(&mut self.mm);
        if mm == 0.0 {
            self.steps.clear();
            return;
        }
        self.steps.push_back((dt, mm));
        while self.steps.iter().skip(1).map(|s| s.0).sum::<f64>() >= WINDOW_S {
            self.steps.pop_front();
        }
    }

    /// Returns the speed, mm/s; `None` of an eye that stands still.
    pub fn mm_per_s(&self) -> Option<f64> {
        let (seconds, mm) = self.steps.iter().fold((0.0, 0.0), |s, t| (s.0 + t.0, s.1 + t.1));
        (seconds > 0.0).then(|| mm / seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_is_that_of_the_last_moments_and_ends_when_the_eye_stands() {
        let mut speed = Speedometer::default();
        assert_eq!(speed.mm_per_s(), None);
        for _ in 0..30 {
            speed.fly(1.0);
            speed.pass(0.1);
        }
        for _ in 0..5 {
            speed.fly(-0.5);
            speed.pass(0.1);
        }
        assert!((speed.mm_per_s().unwrap() - 5.0).abs() < 1e-9);
        speed.pass(0.1);
        assert_eq!(speed.mm_per_s(), None);
    }
}
