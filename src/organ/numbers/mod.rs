//! All numbers by which organs are told from each other, a file an organ: limits, levels, shares. The
//! code beside has none of its own.

pub(super) mod of_airway;
pub(super) mod of_colon;
pub(super) mod of_every_organ;
pub(super) mod of_vessel;
