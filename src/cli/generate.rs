//! `intima completions` and `intima man`.

use std::io::Write as _;

use super::{CliError, command};

/// `intima completions SHELL`
#[derive(Debug, clap::Args)]
pub struct CompletionArgs {
    /// Shell to write completions for
    shell: clap_complete::Shell,
}

impl CompletionArgs {
    /// Prints the completions.
    pub fn run(&self) -> Result<(), CliError> {
        let mut out = Vec::new();
        clap_complete::generate(self.shell, &mut command(), "intima", &mut out);
        std::io::stdout().write_all(&out).map_err(CliError::Output)
    }
}

/// Prints the manual page of the program and, after it, of every command.
pub fn man() -> Result<(), CliError> {
    let mut out = Vec::new();
    let mut all = command();
    all.build();
    let render = |c: clap::Command, out: &mut Vec<u8>| {
        clap_mangen::Man::new(c).render(out).map_err(CliError::Output)
    };
    render(all.clone(), &mut out)?;
    for sub in all.get_subcommands().filter(|s| s.get_name() != "help") {
        let name: &'static str = format!("intima-{}", sub.get_name()).leak();
        render(sub.clone().name(name), &mut out)?;
    }
    std::io::stdout().write_all(&out).map_err(CliError::Output)
}
