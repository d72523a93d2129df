//! A centerline as SWC, the table of trees that neuron tracers use: one point a row with its
//! radius and the point that it follows (R. C. Cannon, D. A. Turner, G. K. Pyapali, H. V. Wheal:
//! An on-line archive of reconstructed hippocampal neurons, J. Neurosci. Methods 84 (1998) 49–54,
//! doi:10.1016/S0165-0270(98)00091-0).

use std::io::{self, Write};

use crate::geometry::Centerline;

/// Kind of every point: undefined, as none of a neuron's parts is meant.
const KIND: u32 = 0;

/// Each branch follows the point of its parent at which it starts, which is written once. A loop
/// stays open: a tree has none.
pub(super) fn write(out: &mut dyn Write, line: &Centerline) -> io::Result<()> {
    writeln!(out, "# SPACE=LPS, mm")?;
    let open = line.branches.iter().filter(|b| b.end.is_some()).count();
    if open > 0 {
        writeln!(out, "# {open} loops are open")?;
    }
    writeln!(out, "# id kind x y z radius parent")?;
    // Row of each branch's first point, which may be its parent's, and of its second.
    let mut rows_of: Vec<[usize; 2]> = Vec::with_capacity(line.branches.len());
    let mut rows = 0;
    for branch in &line.branches {
        let start = branch.start.map(|at| {
            let [first, second] = rows_of[at.branch];
            let row = if at.point == 0 { first } else { second + at.point - 1 };
            (row, line.branches[at.branch].points[at.point].position_mm)
        });
        let shared = start.filter(|s| branch.points.first().is_some_and(|p| p.position_mm == s.1));
        rows_of.push(match shared {
            Some((row, _)) => [row, rows + 1],
            None => [rows + 1, rows + 2],
        });
        let mut parent = start.map_or("-1".to_owned(), |(row, _)| row.to_string());
        for p in &branch.points[usize::from(shared.is_some())..] {
            rows += 1;
            let [x, y, z] = p.position_mm.to_array();
            writeln!(out, "{rows} {KIND} {x} {y} {z} {} {parent}", p.radius_mm)?;
            parent = rows.to_string();
        }
    }
    Ok(())
}
