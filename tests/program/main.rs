//! The program, its window and its session from outside.

mod accept;
mod behind;
mod cli;
mod cohort;
mod memory;
mod played;
mod desktop;
mod examples;
mod interrupt;
mod session;
mod simplify;
mod window;
mod window_notes;
mod window_pair;
mod window_script;
