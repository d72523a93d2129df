//! `cargo xtask pictures`: builds intima, installs what is wanted and runs `tools/pictures`.

use crate::TaskError;
use crate::setup::{Purpose, setup};
use crate::truth::judge;

const SCRIPT: &str = "tools/pictures/pictures.py";
const WANTED: &str = "tools/pictures/requirements.txt";
const HELP: &str = "\
usage: cargo xtask pictures [FLAGS]

  --cases A,B          only cases whose name holds A or B (a wrong name lists them)
  --before PATH        a second build of intima, as a column of its own
  --data DIR           the volumes (default: ../shared/data)
  --out DIR            where everything lands (default: out/pictures)
  --python PATH        an interpreter that has tools/pictures/requirements.txt installed
  --intima PATH        this program instead of building one
  --docs               also write docs/pictures.md and its sheets, of volumes whose licence
                       allows it
";

/// `cargo xtask pictures [--python PATH] [--intima PATH] [ARGUMENTS OF pictures.py]`
pub fn pictures(args: &[&str]) -> Result<(), TaskError> {
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{HELP}");
        return Ok(());
    }
    setup(Purpose::Running)?;
    judge(SCRIPT, WANTED, "pictures-venv", args)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::process::root;

    fn text(file: &str) -> String {
        std::fs::read_to_string(root().join(file)).unwrap()
    }

    #[test]
    fn every_package_is_pinned() {
        let text = text(WANTED);
        let mut lines = text.lines().filter(|l| !l.starts_with('#')).peekable();
        assert!(lines.peek().is_some());
        lines.for_each(|l| assert!(l.contains("=="), "{l}"));
    }

    #[test]
    fn every_flag_of_the_script_is_in_the_help() {
        let text = text(SCRIPT);
        let flags: Vec<_> = text.split("add_argument(\"").skip(1).collect();
        assert!(flags.len() > 5, "{SCRIPT} parses no flags");
        for flag in flags.iter().filter_map(|f| f.split('"').next()) {
            assert!(HELP.contains(&format!("  {flag} ")), "{flag}");
        }
    }

    #[test]
    fn the_page_has_a_place_for_the_sheets() {
        let script = text("tools/pictures/sheets.py");
        let marks = script.lines().find_map(|l| l.strip_prefix("MARKS = ")).unwrap();
        let page = text("docs/pictures.md");
        let found: Vec<_> = marks.split('"').skip(1).step_by(2).map(|m| page.find(m)).collect();
        assert!(found.len() == 2 && found[0].is_some() && found[0] < found[1], "{found:?}");
    }
}
