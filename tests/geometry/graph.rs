//! The graph of the lumen: topology against the surface's, loops, rings, pieces, and what must not
//! change a path.

use common::curves::{route, route_with, run};
use common::volumes::shared_file;
use glam::{DVec3, IVec3, UVec3, Vec3Swizzles};
use intima::centerline::complex::{CellComplex, collapse};
use intima::centerline::{Loops, RouteOptions};
use intima::field::Sampler;
use intima::flight::{Flight, FlightError, FlightOptions, Frames};
use intima::geometry::{Centerline, CenterlinePoint};
use intima::lumen::{BitVolume, IntensitySelection, Lumen};
use intima::session::{
    CenterlineSettings, LumenSettings, Session, Settings, Source, VolumeSource, WallMethod,
};
use intima::volume::Grid;
use intima::volume::phantom::Kind;

fn lumen(dims: [u32; 3], inside: impl Fn(IVec3) -> bool) -> Lumen {
    let grid = Grid::axis_aligned(dims, [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(v.as_ivec3())) {
        bits.set(v.x, v.y, v.z);
    }
    Lumen::of_volume(grid, &bits)
}

fn torus(centre: DVec3, major: f64, minor: f64) -> impl Fn(IVec3) -> bool {
    move |v| {
        let p = v.as_dvec3() - centre;
        (p.truncate().length() - major).hypot(p.z) <= minor
    }
}

/// Euler characteristic of the 6-connected mask: voxels, less pairs that share a face, plus squares
/// of four, less cubes of eight.
fn euler_of_mask(lumen: &Lumen) -> i64 {
    let blocks: Vec<(i64, Vec<IVec3>)> = (0..8)
        .map(|n: i32| {
            let corner = |m: i32| IVec3::new(m & 1, m >> 1 & 1, m >> 2);
            let block = (0..8).filter(|m| m & n == *m).map(corner).collect();
            (if n.count_ones().is_multiple_of(2) { 1 } else { -1 }, block)
        })
        .collect();
    let inside = lumen.elements(&lumen.inside).map(|e| lumen.bricks.voxel(e));
    inside
        .map(|v| {
            let whole = |block: &[IVec3]| block.iter().all(|d| lumen.holds(v + *d));
            blocks.iter().filter(|(_, b)| whole(b)).map(|(sign, _)| sign).sum::<i64>()
        })
        .sum()
}

#[test]
fn loops_of_real_lumens_are_those_of_their_masks_but_for_what_cells_hide() {
    // Loops that thinning of voxels in order of distance leaves.
    let masks = [
        ("colon_label_1", 22),
        ("colon_label_2", 26),
        ("airway_label_lidc4", 19),
        ("brain_vessels_label", 1145),
    ];
    for (name, loops) in masks {
        let Some(path) = shared_file(&format!("{name}.nii.gz")) else { continue };
        // Parts of a label that touch by edges would be joined.
        let select = Some(IntensitySelection::Range { lo: 1.0, hi: f64::INFINITY });
        let wall = WallMethod::Exact;
        let lumen = LumenSettings { select, wall, ..LumenSettings::default() };
        let settings = Settings { lumen, ..Settings::default() };
        let source = Source::Image(VolumeSource::file(path));
        let session = Session::new(source, settings).unwrap();
        let (segmented, fields) = (session.lumen().unwrap(), session.fields().unwrap());
        let complex = CellComplex::new(&segmented.lumen, &fields.distance);
        let mask = euler_of_mask(&segmented.lumen);
        assert_eq!(mask, 1 - loops, "{name}");
        assert_eq!(complex.euler() - complex.euler_within_cells(), mask, "{name}");
        let left = collapse(&complex, &[]);
        let raw = left.contacts.len() as i64 + 1 - left.nodes.len() as i64;
        println!("{name}: {loops} loops, {raw} in the complex, {} shells", left.shells);
        assert_eq!(raw, 1 - complex.euler() + left.shells as i64, "{name}");
    }
}

#[test]
fn a_torus_is_flown_once_round() {
    let centre = DVec3::new(30.0, 30.0, 12.0);
    let case = route(lumen([61, 61, 25], torus(centre, 20.0, 7.0)), false);
    let branch = &case.routed.line.branches[0];
    case.routed.line.check_attachments().unwrap();
    assert_eq!(branch.end.map(|e| (e.branch, e.point)), Some((0, 0)));
    let round = 2.0 * std::f64::consts::PI * 20.0;
    let length = case.routed.line.length_mm();
    assert!((length - round).abs() < 0.02 * round, "{length} of {round}");
    for p in case.points(0) {
        let off = ((p - centre).truncate().length() - 20.0).hypot(p.z - centre.z);
        assert!(off < 0.25, "{p}: {off}");
    }
    // No corner where it closes: steps of half a voxel turn by no more there than elsewhere.
    let all = case.points(0);
    let n = all.len() - 1;
    let step = |i: usize| (all[(i + 1) % n] - all[i % n]).normalize();
    let turns: Vec<f64> = (0..n).map(|i| step(i).angle_between(step(i + 1))).collect();
    let most = turns.iter().copied().fold(0.0, f64::max);
    assert!(most < 0.1, "a turn of {most} rad; an even circle has 0.025");
    assert!(case.routed.loops.iter().all(|l| l.found.ended.is_none()));
}

/// In thin vessels points lay on edges between voxels, and the voxel that they round to outside.
#[test]
fn the_voxel_nearest_to_each_point_of_a_tree_is_inside() {
    let outside = |line: &Centerline, lumen: &Lumen| {
        let to_voxel = lumen.grid.voxel_from_world();
        let points = line.branches.iter().flat_map(|b| &b.points);
        let nearest = points.map(|p| to_voxel.transform_point3(p.position_mm).round().as_ivec3());
        nearest.filter(|v| !lumen.holds(*v)).count()
    };
    // Stairs a voxel wide, and a fork that is as thin.
    let thread = |v: IVec3| {
        let trunk = (v.y == v.x || v.y == v.x - 1) && (3..60).contains(&v.x);
        let arm = (v.y == 60 - v.x || v.y == 61 - v.x) && (30..58).contains(&v.x);
        v.z == 20 && (trunk || arm)
    };
    let case = route(lumen([62, 62, 42], thread), true);
    assert!(case.routed.line.point_count() > 100);
    assert_eq!(outside(&case.routed.line, &case.lumen), 0);
    let Some(path) = shared_file("brain_vessels_label.nii.gz") else { return };
    let centerline = CenterlineSettings { tree: true, ..CenterlineSettings::default() };
    let settings = Settings { centerline, ..Settings::default() };
    let session = Session::new(Source::Image(VolumeSource::file(path)), settings).unwrap();
    let (line, segmented) = (session.centerline().unwrap(), session.lumen().unwrap());
    let points = line.line.point_count();
    assert!(points > 30_000);
    assert_eq!(outside(&line.line, &segmented.lumen), 0, "of {points} points");
}

/// Two tubes that a long bridge joins in the middle and a wide one at the bottom.
fn ladder(v: IVec3) -> bool {
    let tube = |x: i32| ((v.x - x).pow(2) + (v.y - 12).pow(2)) < 64 && (3..90).contains(&v.z);
    let between = (12..=60).contains(&v.x);
    let rung = |z: i32, r: i32| between && (v.y - 12).pow(2) + (v.z - z).pow(2) < r * r;
    tube(12) || tube(60) || rung(14, 8) || rung(62, 4)
}

#[test]
fn a_kept_loop_is_a_branch_that_ends_on_another_and_cut_it_has_a_free_end() {
    let case = route(lumen([73, 25, 93], ladder), true);
    let line = &case.routed.line;
    line.check_attachments().unwrap();
    let graph = line.graph();
    assert_eq!((graph.loops(), line.branches.iter().filter(|b| b.end.is_some()).count()), (1, 1));
    let options = RouteOptions { tree: true, loops: Loops::Cut, ..RouteOptions::default() };
    let cut = route_with(lumen([73, 25, 93], ladder), options).routed;
    assert_eq!(cut.line.graph().loops(), 0);
    assert!(cut.line.branches.iter().all(|b| b.end.is_none()));
    // A half no longer than a twig is none.
    let lengths = [line, &cut.line].map(|l| l.length_mm());
    assert!(cut.line.branches.len() > 1 && lengths[1] > 0.9 * lengths[0], "{lengths:?}");
}

/// Whether a voxel lies in a tube along a segment.
fn in_tube(v: IVec3, a: [f64; 3], b: [f64; 3], radius: f64) -> bool {
    let (p, a, b) = (v.as_dvec3(), DVec3::from(a), DVec3::from(b));
    let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a.lerp(b, t)) <= radius
}

/// A trunk with a short spur that parts into two tubes, whose tips go on below a bridge.
fn bridged_fork(v: IVec3) -> bool {
    let [fork, left, right] = [[60.0, 12.0, 110.0], [30.0, 12.0, 150.0], [90.0, 12.0, 150.0]];
    in_tube(v, [60.0, 12.0, 10.0], fork, 8.0)
        || in_tube(v, [60.0, 12.0, 60.0], [70.0, 12.0, 60.0], 2.5)
        || in_tube(v, fork, left, 5.0)
        || in_tube(v, fork, right, 5.0)
        || in_tube(v, left, [20.0, 12.0, 190.0], 5.0)
        || in_tube(v, right, [100.0, 12.0, 186.0], 5.0)
        || in_tube(v, left, right, 3.0)
}

#[test]
fn a_spur_is_no_branch_and_a_loop_has_the_generation_of_its_nearer_end() {
    let case = route(lumen([121, 25, 201], bridged_fork), true);
    let graph = case.routed.line.graph();
    let tree = graph.tree();
    // Trunk; two tubes; the bridge and two tips.
    assert_eq!(tree.generations, [1, 2, 3], "{tree:?}");
    assert_eq!((tree.branches, tree.terminal_branches, tree.loops), (6, 2, 1), "{tree:?}");
    let root = graph.nodes[graph.roots[0]].position_mm;
    assert!(graph.roots.len() == 1 && root[2] < 20.0, "{root:?}");
    let side = |v: IVec3| in_tube(v, [60.0, 12.0, 10.0], [60.0, 12.0, 110.0], 8.0);
    let spur = |v: IVec3| side(v) || in_tube(v, [60.0, 12.0, 60.0], [70.0, 12.0, 60.0], 2.5);
    let tree = route(lumen([121, 25, 201], spur), true).routed.line.graph().tree();
    assert_eq!((tree.branches, tree.terminal_branches, tree.generations), (1, 1, vec![1]));
}

#[test]
fn a_bronchial_tree_doubles_its_branches_to_the_fourth_generation() {
    let Some(path) = shared_file("airway_label_lidc4.nii.gz") else { return };
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(vec![1]));
    settings.centerline.tree = true;
    let session = Session::new(Source::Image(VolumeSource::file(path)), settings).unwrap();
    let tree = session.tree().unwrap().unwrap();
    println!("{tree}, {:?}, {} loops", tree.generations, tree.loops);
    assert_eq!(tree.generations[..5], [1, 2, 4, 8, 16]);
    assert_eq!(tree.branches, tree.generations.iter().sum::<usize>());
    // Of a tree with two branches at every bifurcation; a loop has a tip less.
    assert!(tree.terminal_branches + tree.loops > tree.branches / 2 - 2, "{tree:?}");
    assert!((8..16).contains(&tree.greatest_generation), "{tree:?}");
}

/// Mean and greatest distance of points to the nearest of a curve, mm.
fn apart(points: &[DVec3], curve: &[DVec3]) -> (f64, f64) {
    let off = |p: &DVec3| curve.iter().map(|q| q.distance(*p)).fold(f64::INFINITY, f64::min);
    let all: Vec<f64> = points.iter().map(off).collect();
    (all.iter().sum::<f64>() / all.len() as f64, all.into_iter().fold(0.0, f64::max))
}

#[test]
fn a_path_is_the_same_after_shifting_swapping_and_mirroring_the_volume() {
    let (case, _) = run(Kind::Colon, 96, 1.0, false);
    let n = 96 + 8;
    let of = |from: &dyn Fn(IVec3) -> IVec3| {
        let moved = lumen([n as u32; 3], |v| case.lumen.holds(from(v)));
        route(moved, false).points(0)
    };
    let home = case.points(0);
    type Map<'a, T> = &'a dyn Fn(T) -> T;
    let checks: [(&str, Map<'_, IVec3>, Map<'_, DVec3>); 4] = [
        ("shift", &|v| v - IVec3::new(1, 2, 3), &|p| p - DVec3::new(1.0, 2.0, 3.0)),
        ("swap", &|v| v.zxy(), &|p| p.zxy()),
        ("mirror", &|v| IVec3::new(n - 1 - v.x, v.y, v.z), &|p| {
            DVec3::new(f64::from(n - 1) - p.x, p.y, p.z)
        }),
        ("both", &|v| IVec3::new(v.y, n - 1 - v.z, v.x) - 2, &|p| {
            DVec3::new(p.y, f64::from(n - 1) - p.z, p.x) - 2.0
        }),
    ];
    for (name, from, back) in checks {
        let points: Vec<DVec3> = of(from).into_iter().map(back).collect();
        let ((mean, most), (other, _)) = (apart(&points, &home), apart(&home, &points));
        println!("{name}: {mean:.3} and {other:.3} voxels in the mean, {most:.2} at most");
        assert!(mean.max(other) < 0.6 && most < 5.3, "{name}: {mean} {other} {most}");
    }
}

#[test]
fn trees_with_loops_are_the_same_at_any_number_of_threads() {
    let shape = lumen([73, 25, 93], ladder);
    let of = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| route(shape.clone(), true).routed)
    };
    let one = of(1);
    for threads in [2, 3, 8] {
        let more = of(threads);
        assert_eq!((&more.line, &more.loops), (&one.line, &one.loops), "{threads} threads");
    }
}

#[test]
fn a_collapsed_colon_is_flown_piece_by_piece_in_order() {
    let (case, truth) = run(Kind::Colon, 96, 1.0, false);
    let axis: Vec<DVec3> =
        truth.branches[0].points.iter().map(|p| DVec3::new(p[0], p[1], p[2])).collect();
    let nearest = |p: DVec3| {
        let off = |i: &usize| axis[*i].distance_squared(p);
        (0..axis.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap() as f64 / axis.len() as f64
    };
    // Two stretches of the colon are empty.
    let gone = |s: f64| (0.3..0.36).contains(&s) || (0.62..0.7).contains(&s);
    let bits = |v: UVec3| case.lumen.holds(v.as_ivec3()) && !gone(nearest(v.as_dvec3()));
    let grid = case.lumen.grid;
    let mut left = BitVolume::new(grid.dims);
    (0..grid.len())
        .map(|i| grid.voxel(i))
        .filter(|v| bits(*v))
        .for_each(|v| left.set(v.x, v.y, v.z));
    let cut = route(Lumen::of_volume(grid, &left), false);
    let line = &cut.routed.line;
    assert_eq!((line.branches.len(), line.pieces().count()), (3, 3));
    let along: Vec<f64> = (0..3)
        .flat_map(|b| {
            let points = cut.points(b);
            [nearest(points[0]), nearest(points[points.len() - 1])]
        })
        .collect();
    let back = along.iter().rev().copied().collect::<Vec<_>>();
    assert!(along.is_sorted() || back.is_sorted(), "{along:?}");
    (0..3).for_each(|b| cut.assert_inside(&cut.points(b), "piece"));

    let paths: Vec<_> = line.pieces().map(|b| &b.points[..]).collect();
    let options = FlightOptions { frames: Frames::Count(60), ..FlightOptions::default() };
    let flight = Flight::along(&paths, &cut.lumen, &cut.distance, options).unwrap();
    assert_eq!((flight.poses.len(), flight.cuts.len()), (60, 2));
    assert!(flight.seconds.is_sorted_by(|a, b| a < b));
    let d = Sampler { lumen: &cut.lumen, field: &cut.distance };
    let world = grid.voxel_from_world();
    for pose in &flight.poses {
        let p = world.transform_point3(pose.position_mm.as_dvec3()) * grid.spacing_mm;
        assert!(d.at(p) > 0.5, "{p} is outside");
    }
    let step = |i: usize| flight.poses[i].position_mm.distance(flight.poses[i - 1].position_mm);
    let jumps = flight.cuts.iter().map(|c| step(*c)).fold(f32::INFINITY, f32::min);
    let steps = (1..60).filter(|i| !flight.cuts.contains(i)).map(step).fold(0.0, f32::max);
    assert!(jumps > steps, "a cut of {jumps} mm among steps of {steps} mm");
}

#[test]
fn specks_beside_the_lumen_are_no_pieces() {
    let tube = |v: IVec3| (v.x - 9).pow(2) + (v.y - 9).pow(2) < 36 && (2..60).contains(&v.z);
    let speck = |v: IVec3| v.x > 18 && v.y < 2 && v.z < 2;
    let case = route(lumen([21, 19, 62], |v| tube(v) || speck(v)), false);
    assert_eq!((case.routed.line.branches.len(), case.routed.unreachable), (1, 8));
}

#[test]
fn a_sheet_of_single_voxels_is_no_piece_and_a_way_without_room_is_left_out_of_the_flight() {
    let tube = |v: IVec3| (v.x - 9).pow(2) + (v.y - 9).pow(2) < 36 && (2..60).contains(&v.z);
    let sheet = |v: IVec3| v.x == 19 && (2..17).contains(&v.y) && (2..60).contains(&v.z);
    let case = route(lumen([21, 19, 62], |v| tube(v) || sheet(v)), false);
    assert_eq!((case.routed.line.branches.len(), case.routed.unreachable), (1, 15 * 58));

    let path = |x: f64| {
        let at = |k: u32| DVec3::new(x, 9.0, f64::from(k));
        let point =
            |k| CenterlinePoint { position_mm: at(k), radius_mm: 1.0, abscissa_mm: f64::from(k) };
        (10..50).map(point).collect::<Vec<_>>()
    };
    let (inside, narrow) = (path(9.0), path(19.0));
    let options = FlightOptions { frames: Frames::Count(12), ..FlightOptions::default() };
    let fly =
        |paths: &[&[CenterlinePoint]]| Flight::along(paths, &case.lumen, &case.distance, options);
    let flight = fly(&[&inside, &narrow, &inside]).unwrap();
    assert_eq!((flight.left_out, flight.poses.len(), flight.cuts.len()), (1, 12, 1));
    assert!(flight.seconds.is_sorted_by(|a, b| a < b));
    let none = fly(&[&narrow, &narrow]).unwrap_err();
    assert!(matches!(none, FlightError::NoRoom { .. }), "{none}");
}
