//! Analytic phantoms with their truth.
