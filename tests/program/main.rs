//! The program, its window and its session from outside.

mod cli;
mod desktop;
mod examples;
mod interrupt;
mod session;
mod simplify;
mod window;
