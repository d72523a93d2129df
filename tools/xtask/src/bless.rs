//! `cargo xtask bless`: writes the golden frames anew.

use crate::TaskError;
use crate::process::{cargo, run};
use crate::setup::{Purpose, setup};
use crate::test_suite::{FEATURES, with_device};

/// `cargo xtask bless`
pub fn bless() -> Result<(), TaskError> {
    setup(Purpose::Testing)?;
    let golden = ["--test", "gpu", "golden::"];
    let mut tests = cargo(&[&["test", "--locked"], &FEATURES[..], &golden].concat());
    run(with_device(&mut tests, false).env("INTIMA_BLESS", "1"))?;
    eprintln!(
        "The frames under tests/golden/ are new. Look at every one that `git status` lists before \
         committing it, and say in the commit why the pixels changed."
    );
    Ok(())
}
