//! `intima completions` and `intima man`.

use std::io::Write as _;

use super::{CliError, command};
use crate::formats::atomic_file::write_atomic;

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

/// `intima man`
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Folder for one file a command, intima.1 and intima-COMMAND.1; without it all are printed
    #[arg(long, value_name = "DIR")]
    out: Option<std::path::PathBuf>,
}

impl ManArgs {
    /// Prints or writes the manual page of the program and of every command.
    pub fn run(&self) -> Result<(), CliError> {
        let pages = man_pages()?;
        let Some(folder) = &self.out else {
            let all: Vec<u8> = pages.into_iter().flat_map(|p| p.1).collect();
            return std::io::stdout().write_all(&all).map_err(CliError::Output);
        };
        for (name, page) in pages {
            write_atomic(&folder.join(format!("{name}.1")), |f| f.write_all(&page))?;
        }
        Ok(())
    }
}

/// Name and text of each manual page, the program's first.
fn man_pages() -> Result<Vec<(String, Vec<u8>)>, CliError> {
    let mut all = command();
    all.build();
    let render = |name: String, c: clap::Command| {
        let mut page = Vec::new();
        clap_mangen::Man::new(c).render(&mut page).map_err(CliError::Output)?;
        Ok::<_, CliError>((name, page))
    };
    let mut pages = vec![render("intima".to_owned(), all.clone())?];
    for sub in all.get_subcommands().filter(|s| s.get_name() != "help") {
        let name: &'static str = format!("intima-{}", sub.get_name()).leak();
        pages.push(render(name.to_owned(), sub.clone().name(name))?);
    }
    Ok(pages)
}
