//! The program, its window and its session from outside.

mod behind;
mod cli;
mod cohort;
mod memory;
mod desktop;
mod examples;
mod interrupt;
mod session;
mod simplify;
mod window;
