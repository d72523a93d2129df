//! `cargo bench`: every kernel on every device, as `intima bench` does it. Arguments after `--` go
//! to that command, for example `cargo bench -- --size 256 --json`.

use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    let given = std::env::args_os().skip(1).filter(|a| a != "--bench");
    intima::cli::main_with(["intima", "bench"].map(OsString::from).into_iter().chain(given))
}
