//! Decisions as measured values beside their limits.

use super::{Organ, OrganError};

/// The gates an organ passed, and by how much.
#[derive(Clone)]
pub(super) struct Gates {
    organ: Organ,
    /// Least margin so far.
    pub confidence: f64,
    /// A line for each.
    pub reasons: Vec<String>,
}

impl Gates {
    pub fn new(organ: Organ) -> Self {
        Self { organ, confidence: 1.0, reasons: Vec::new() }
    }

    /// A value that must not lie below a limit.
    ///
    /// * `sure`: the value at which nothing is in doubt any more.
    pub fn at_least(
        &mut self,
        what: &str,
        value: f64,
        limit: f64,
        sure: f64,
    ) -> Result<(), OrganError> {
        self.pass(what, value, ("at least", limit, sure))
    }

    /// A value that must not lie above a limit.
    pub fn at_most(
        &mut self,
        what: &str,
        value: f64,
        limit: f64,
        sure: f64,
    ) -> Result<(), OrganError> {
        self.pass(what, value, ("at most", limit, sure))
    }

    fn pass(
        &mut self,
        what: &str,
        value: f64,
        (side, limit, sure): (&str, f64, f64),
    ) -> Result<(), OrganError> {
        let line = format!("{what} {}, {side} {}", short(value), short(limit));
        let margin = (value - limit) / (sure - limit);
        if margin.is_nan() || margin < 0.0 {
            return Err(self.refuse(line));
        }
        self.confidence = self.confidence.min(margin);
        self.reasons.push(line);
        Ok(())
    }

    /// What was measured or chosen, without a limit.
    pub fn note(&mut self, line: String) {
        self.reasons.push(line);
    }

    /// What no measure decides: confidence is at most this.
    pub fn doubt(&mut self, line: String, most: f64) {
        self.confidence = self.confidence.min(most);
        self.reasons.push(line);
    }

    /// The organ was not found.
    pub fn refuse(&self, why: impl Into<String>) -> OrganError {
        OrganError::NotFound { organ: self.organ, why: why.into() }
    }
}

/// Three digits, more for large numbers.
fn short(v: f64) -> String {
    if v.abs() >= 100.0 || v == v.round() { format!("{v:.0}") } else { format!("{v:.2}") }
}
