//! Decisions as measured values beside their limits.

use super::{Organ, OrganError};

/// Gates that an organ passed, with the least margin.
#[derive(Clone)]
pub(super) struct Gates {
    organ: Organ,
    /// Least margin so far.
    pub confidence: f64,
    /// Lines of the report, one for each gate and note.
    pub reasons: Vec<String>,
}

impl Gates {
    pub fn new(organ: Organ) -> Self {
        Self { organ, confidence: 1.0, reasons: Vec::new() }
    }

    /// Checks that a value is not below a limit.
    ///
    /// * `sure`: value at which confidence is 1.
    pub fn at_least(
        &mut self,
        what: &str,
        value: f64,
        limit: f64,
        sure: f64,
    ) -> Result<(), OrganError> {
        self.pass(what, value, ("at least", limit, sure))
    }

    /// Checks that a value is not above a limit.
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
        let line = format!("{what}: {} ({side} {})", short(value), short(limit));
        let margin = (value - limit) / (sure - limit);
        if margin.is_nan() || margin < 0.0 {
            return Err(self.refuse(line));
        }
        self.confidence = self.confidence.min(margin);
        self.reasons.push(line);
        Ok(())
    }

    /// Adds a line on a measurement or a choice that has no limit.
    pub fn note(&mut self, line: String) {
        self.reasons.push(line);
    }

    /// Adds a line on a doubt that no measure settles, and limits confidence to `most`.
    pub fn doubt(&mut self, line: String, most: f64) {
        self.confidence = self.confidence.min(most);
        self.reasons.push(line);
    }

    /// Returns the error for an organ that was not found.
    pub fn refuse(&self, why: impl Into<String>) -> OrganError {
        OrganError::NotFound { organ: self.organ, why: why.into() }
    }
}

/// Formats a number with no decimals from 100 on or if it is whole, else with two.
fn short(v: f64) -> String {
    if v.abs() >= 100.0 || v == v.round() { format!("{v:.0}") } else { format!("{v:.2}") }
}
