//! A centerline as a table.

use std::io::{self, Write};

use crate::geometry::Centerline;

/// Numbers are written with as many digits as it takes to read the same number back.
pub(super) fn write(out: &mut dyn Write, line: &Centerline) -> io::Result<()> {
    writeln!(out, "x,y,z,radius,abscissa,branch,parent")?;
    for (b, branch) in line.branches.iter().enumerate() {
        let parent = branch.parent().map_or(-1, |p| p as i64);
        for p in &branch.points {
            let [x, y, z] = p.position_mm.to_array();
            writeln!(out, "{x},{y},{z},{},{},{b},{parent}", p.radius_mm, p.abscissa_mm)?;
        }
    }
    Ok(())
}
