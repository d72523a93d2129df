//! Golden frames: written anew on request, believed only after someone has looked.

use crate::Stop;
use crate::run::{cargo, loudly};
use crate::setup::{For, setup};
use crate::suite::with_device;

/// `cargo xtask bless`
pub fn bless() -> Result<(), Stop> {
    setup(For::Testing)?;
    let mut run = cargo(&["test", "--locked", "--features", "faults", "--test", "golden"]);
    loudly(with_device(&mut run, false).env("INTIMA_BLESS", "1"))?;
    eprintln!(
        "The frames under tests/golden/ are new. Look at every one that `git status` lists before \
         committing it, and say in the commit why the pixels changed."
    );
    Ok(())
}
