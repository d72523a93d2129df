use glam::IVec3;

use super::*;
use crate::field::Sampler;
use crate::lumen::{BitVolume, Lumen};
use crate::volume::Grid;

/// A lumen of the voxels of a box that `holds`; component and cavities as they are.
fn lumen(dims: [u32; 3], holds: impl Fn(IVec3) -> bool) -> Lumen {
    let grid = Grid::axis_aligned(dims, [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| holds(v.as_ivec3())) {
        bits.set(v.x, v.y, v.z);
    }
    Lumen::of_volume(grid, &bits)
}

/// Distance to the nearest external voxel centre, by looking at all near ones.
fn distance(lumen: &Lumen) -> Vec<f32> {
    let mut out = vec![0.0; lumen.bricks.field_len()];
    for e in lumen.elements(&lumen.inside) {
        let v = lumen.bricks.voxel(e);
        let ring = |r: i32| {
            let span = -r..=r;
            let all = span.clone().flat_map(move |z| {
                let span = span.clone();
                span.clone().flat_map(move |y| span.clone().map(move |x| IVec3::new(x, y, z)))
            });
            let out = all.filter(|d| !lumen.holds(v + *d));
            out.map(|d| d.length_squared()).min()
        };
        let least = (1..).find_map(|r| ring(r).filter(|d2| *d2 <= r * r)).unwrap_or(0);
        out[e] = (least as f32).sqrt();
    }
    out
}

/// Euler characteristic of the 6-connected mask, voxel by voxel.
fn euler_of_mask(lumen: &Lumen) -> i64 {
    let mut sum = 0;
    for e in lumen.elements(&lumen.inside) {
        let v = lumen.bricks.voxel(e);
        for n in 0..8 {
            let way = IVec3::new(n & 1, n >> 1 & 1, n >> 2);
            let block = (0..8).filter(|m| m & n == *m);
            let whole = block.map(|m| IVec3::new(m & 1, m >> 1 & 1, m >> 2));
            if whole.into_iter().all(|d| lumen.holds(v + d)) {
                sum += if way.element_sum() % 2 == 0 { 1 } else { -1 };
            }
        }
    }
    sum
}

fn random(v: IVec3, seed: u32) -> u32 {
    let mix = |n: u32| (n ^ n >> 16).wrapping_mul(0x045d_9f3b).rotate_left(13);
    mix(mix(mix(v.x as u32 ^ seed) ^ v.y as u32) ^ v.z as u32) >> 8
}

/// Returns the complex of a lumen's cells with its collapsed graph. Checks that the complex of the
/// voxels keeps every loop of the mask.
fn checked(lumen: &Lumen) -> (CellComplex, Collapsed) {
    let distance = distance(lumen);
    let complex = CellComplex::of_cells(lumen, &distance);
    assert_eq!(complex.euler() - euler_of_mask(lumen), complex.euler_within_cells());
    let fine = CellComplex::of_voxels(lumen, &distance);
    assert_eq!((fine.euler(), fine.euler_within_cells()), (euler_of_mask(lumen), 0));
    let of_voxels = collapse(&fine, &[]);
    let components = sweep::NodeContacts::new(&fine, lumen).components();
    let components = components.into_iter().max().map_or(0, |c| c as usize + 1);
    let left = components as i64 - fine.euler() + of_voxels.shells as i64;
    assert_eq!(loops(&of_voxels, components) as i64, left, "loops of the complex of voxels");
    let collapsed = collapse(&complex, &[]);
    (complex, collapsed)
}

/// Loops of the graph that is left.
fn loops(c: &Collapsed, components: usize) -> usize {
    c.contacts.len() + components - c.nodes.len()
}

fn ball(centre: [f32; 3], radius: f32) -> impl Fn(IVec3) -> bool {
    move |v| v.as_vec3().distance(centre.into()) <= radius
}

/// A torus about the z axis through `centre`.
fn torus(centre: [f32; 3], major: f32, minor: f32) -> impl Fn(IVec3) -> bool {
    move |v| {
        let p = v.as_vec3() - glam::Vec3::from(centre);
        (p.truncate().length() - major).hypot(p.z) <= minor
    }
}

#[test]
fn euler_characteristic_of_any_mask_is_that_of_its_complex_and_what_cells_hide() {
    for (seed, dims) in [[24, 17, 30], [9, 8, 7], [16, 16, 16]].into_iter().enumerate() {
        for share in [1u32, 3, 5, 7] {
            let l = lumen(dims, |v| random(v, seed as u32 + 1) % 8 < share);
            let (complex, collapsed) = checked(&l);
            assert!(complex.nodes.len() > 10, "{dims:?} {share}");
            // Removing pairs changes no characteristic; opening a shell lowers it by one.
            let left = collapsed.nodes.len() as i64 - collapsed.contacts.len() as i64;
            assert_eq!(left, complex.euler() - collapsed.shells as i64, "{dims:?} {share}");
        }
    }
}

#[test]
fn loops_of_known_shapes_are_left_and_nothing_else() {
    let eight = |v: IVec3| {
        torus([20.0, 20.0, 10.0], 11.0, 4.0)(v) || torus([42.0, 20.0, 10.0], 11.0, 4.0)(v)
    };
    let tube = |v: IVec3| (v.as_vec3().truncate() - glam::Vec2::splat(15.0)).length() <= 10.0;
    let pillar = |v: IVec3| tube(v) && !((v.z - 30).abs() <= 1 && (v.y - 15).abs() <= 1);
    let rod = |v: IVec3| tube(v) && !((v.x - 15).abs() <= 1 && (v.y - 15).abs() <= 1);
    type Shape<'a> = (&'a str, [u32; 3], &'a dyn Fn(IVec3) -> bool, usize);
    let shapes: [Shape<'_>; 6] = [
        ("ball", [31, 31, 31], &ball([15.0; 3], 12.0), 0),
        ("torus", [45, 45, 21], &torus([22.0, 22.0, 10.0], 14.0, 5.0), 1),
        ("figure of eight", [64, 41, 21], &eight, 2),
        ("tube", [31, 31, 60], &tube, 0),
        ("pillar across a tube", [31, 31, 60], &pillar, 1),
        ("rod along a tube", [31, 31, 60], &rod, 1),
    ];
    for (name, dims, holds, wanted) in shapes {
        let l = lumen(dims, holds);
        let (complex, collapsed) = checked(&l);
        assert_eq!(loops(&collapsed, 1), wanted, "{name}: {:?}", collapsed.nodes.len());
        assert_eq!(complex.euler(), 1 - wanted as i64, "{name}");
        assert_eq!(collapsed.shells, 0, "{name}");
    }
}

#[test]
fn what_is_left_of_a_ball_is_its_middle_and_of_a_torus_its_circle() {
    let l = lumen([31, 31, 31], ball([15.0; 3], 12.0));
    let (complex, collapsed) = checked(&l);
    let [node] = collapsed.nodes[..] else { panic!("{collapsed:?}") };
    let at = l.bricks.voxel(complex.nodes[node as usize].deepest as usize);
    assert!((at - 15).abs().max_element() <= 1, "{at}");
    let l = lumen([45, 45, 21], torus([22.0, 22.0, 10.0], 14.0, 5.0));
    let (complex, collapsed) = checked(&l);
    for n in &collapsed.nodes {
        let p = l.bricks.voxel(complex.nodes[*n as usize].deepest as usize).as_vec3();
        let off = (p.truncate().distance(glam::Vec2::splat(22.0)) - 14.0).hypot(p.z - 10.0);
        assert!(off <= 2.5, "{p}: {off}");
    }
}

#[test]
fn anchors_stay_with_what_joins_them() {
    let tube = |v: IVec3| (v.as_vec3().truncate() - glam::Vec2::splat(7.0)).length() <= 5.0;
    let l = lumen([15, 15, 80], tube);
    let complex = CellComplex::of_cells(&l, &distance(&l));
    let of = |v: IVec3| {
        let holds = |n: &Node| l.bricks.voxel(n.deepest as usize).distance_squared(v) < 9;
        complex.nodes.iter().position(holds).unwrap() as u32
    };
    let anchors = [of(IVec3::new(7, 7, 1)), of(IVec3::new(7, 7, 78))];
    let collapsed = collapse(&complex, &anchors);
    assert!(anchors.iter().all(|a| collapsed.nodes.contains(a)));
    assert_eq!((loops(&collapsed, 1), collapsed.shells), (0, 0));
    // A chain: two ends, all others with two contacts, along the axis.
    let mut degree = vec![0; complex.nodes.len()];
    let ends = |c: &u32| complex.contacts[*c as usize].nodes;
    collapsed.contacts.iter().flat_map(ends).for_each(|n| degree[n as usize] += 1);
    let of_degree = |d: i32| collapsed.nodes.iter().filter(|n| degree[**n as usize] == d).count();
    assert_eq!((of_degree(1), of_degree(2)), (2, collapsed.nodes.len() - 2));
    assert!(collapsed.nodes.len() >= 18, "{}", collapsed.nodes.len());
}

#[test]
fn a_cavity_is_opened_and_counted() {
    let shell = |v: IVec3| ball([15.0; 3], 13.0)(v) && !ball([15.0; 3], 6.0)(v);
    let (complex, collapsed) = checked(&lumen([31, 31, 31], shell));
    assert_eq!((complex.euler(), collapsed.shells, loops(&collapsed, 1)), (2, 1, 0));
}

#[test]
fn no_element_is_deeper_than_what_bounds_it_and_threads_do_not_show() {
    let l = lumen([45, 45, 21], torus([22.0, 22.0, 10.0], 14.0, 5.0));
    let d = distance(&l);
    let complex = CellComplex::of_cells(&l, &d);
    for c in &complex.contacts {
        assert!(c.nodes.iter().all(|n| complex.nodes[*n as usize].key >= c.key));
    }
    for r in &complex.runs {
        assert!(r.contacts.iter().all(|c| complex.contacts[*c as usize].key >= r.key));
    }
    for k in &complex.corners {
        assert!(k.runs.iter().all(|r| complex.runs[*r as usize].key >= k.key));
    }
    assert!(complex.corners.len() > 10);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let again = pool.install(|| CellComplex::of_cells(&l, &d));
        assert_eq!(
            (again.nodes, again.contacts),
            (complex.nodes.clone(), complex.contacts.clone())
        );
        assert_eq!((again.runs, again.corners), (complex.runs.clone(), complex.corners.clone()));
    }
}

/// Hands over the net of a lumen with its tips held, before any rule.
fn with_net<T>(
    l: &Lumen,
    complex_of: impl Fn(&Lumen, &[f32]) -> CellComplex,
    work: impl FnOnce(net::Net<'_>) -> T,
) -> T {
    let field = distance(l);
    let complex = complex_of(l, &field);
    let adjacency = sweep::NodeContacts::new(&complex, l);
    let component = adjacency.components();
    let depth = |n: u32| std::cmp::Reverse(complex.nodes[n as usize].key);
    let deepest = sweep::first_of_each(&component, depth);
    let far = adjacency.lengths(&deepest);
    let roots = sweep::first_of_each(&component, |n| std::cmp::Reverse(far[n as usize]));
    let length = adjacency.lengths(&roots);
    let h = l.grid.spacing_mm.min_element();
    let units = |mm: f64| (mm / adjacency.unit_mm) as u32;
    let width = |n: u32| units(0.5 * h * f64::from(complex.nodes[n as usize].key).sqrt());
    let mut tips = sweep::tips(&adjacency, &length, width, units(5.0));
    tips.extend(&roots);
    tips.sort_unstable();
    tips.dedup();
    let left = collapse(&complex, &tips);
    let net = net::Net::new(&complex, &adjacency, &left, &[], Sampler { lumen: l, field: &field });
    assert_eq!(
        net.loops() as i64,
        component.iter().max().map_or(0, |c| i64::from(*c) + 1) - complex.euler()
            + left.shells as i64
    );
    work(net)
}

/// Loops of the graph with its tips held, before and after the rules; rules that ended loops; ends.
fn pruned(l: &Lumen) -> (usize, usize, Vec<net::Rule>, usize) {
    let work = |mut net: net::Net<'_>| {
        let raw = net.loops();
        let kept = net.prune(net::PruneLimits::default());
        assert_eq!(net.loops(), kept.len());
        let rules: Vec<net::Rule> = net.ended.iter().filter_map(|l| l.ended).collect();
        (raw, kept.len(), rules, net.leaves().len())
    };
    let cells = with_net(l, CellComplex::of_cells, work);
    assert_eq!(with_net(l, CellComplex::of_voxels, work), cells, "cells and voxels");
    cells
}

#[test]
fn ctrl_c_does_not_wait_until_all_loops_are_pruned() {
    use crate::task::{CancelToken, Cancelled, catch_cancelled};
    let torus = lumen([45, 45, 21], torus([22.0, 22.0, 10.0], 14.0, 5.0));
    let cancelled = || {
        with_net(&torus, CellComplex::of_cells, |mut net| {
            let token = CancelToken::default();
            token.enter();
            token.cancel();
            catch_cancelled(|| net.prune(net::PruneLimits::default()))
        })
    };
    // On a thread of its own, which has the token until it ends.
    let outcome = std::thread::scope(|scope| scope.spawn(cancelled).join().unwrap());
    assert_eq!(outcome, Err(Cancelled));
}

/// Two square tubes 15 wide side by side, joined below and by a round hole or bridge of radius `hole`
/// through the wall of `wall` voxels between them.
fn two_tubes(wall: i32, hole: f32) -> Lumen {
    let (a, b) = (10, 25 + wall);
    let dims = [(b + 11) as u32, 25, 80];
    lumen(dims, |v| {
        let tube = |x: i32| (v.x - x).abs() <= 7 && (v.y - 12).abs() <= 7 && (2..78).contains(&v.z);
        let between = (a..=b).contains(&v.x);
        let joint = between && (v.y - 12).abs() <= 5 && (2..14).contains(&v.z);
        let bridge = between && ((v.y - 12) as f32).hypot((v.z - 58) as f32) <= hole;
        tube(a) || tube(b) || joint || bridge
    })
}

#[test]
fn rules_keep_loops_of_organs_and_end_those_of_folds() {
    use net::Rule;
    let torus = lumen([45, 45, 21], torus([22.0, 22.0, 10.0], 14.0, 5.0));
    assert_eq!(pruned(&torus), (1, 1, vec![], 0));
    let tube = |v: IVec3| (v.as_vec3().truncate() - glam::Vec2::splat(15.0)).length() <= 10.0;
    let pillar = |v: IVec3| tube(v) && !((v.z - 30).abs() <= 1 && (v.y - 15).abs() <= 1);
    assert_eq!(pruned(&lumen([31, 31, 90], pillar)), (1, 0, vec![Rule::Local], 2));
    // A long bridge is a branch that comes back; a hole in a thin wall is where folds touch.
    assert_eq!(pruned(&two_tubes(24, 2.5)), (1, 1, vec![], 2));
    assert_eq!(pruned(&two_tubes(2, 0.0)), (1, 0, vec![Rule::Window], 2));
    assert_eq!(pruned(&two_tubes(6, 0.0)), (1, 1, vec![], 2));
    assert_eq!(pruned(&two_tubes(2, 1.0)), (1, 0, vec![Rule::Window], 2));
}

#[test]
fn tips_are_the_ends_of_branches_and_a_sac_has_one() {
    let y = |v: IVec3| {
        let p = v.as_vec3() - glam::Vec3::new(30.0, 10.0, 30.0);
        let along = |x: f32, z: f32| {
            let way = glam::Vec3::new(x, 0.0, z).normalize();
            let t = p.dot(way).clamp(0.0, 26.0);
            (p - way * t).length() <= 5.0
        };
        along(0.0, -1.0) || along(1.0, 1.0) || along(-1.0, 1.0)
    };
    assert_eq!(pruned(&lumen([61, 21, 61], y)), (0, 0, vec![], 3));
    let tube = |v: IVec3| (v.as_vec3().truncate() - glam::Vec2::splat(10.0)).length() <= 6.0;
    assert_eq!(pruned(&lumen([21, 21, 70], tube)), (0, 0, vec![], 2));
    let slab = |v: IVec3| v.cmpge(IVec3::splat(2)).all() && v.x < 50 && v.y < 20 && v.z < 6;
    let (raw, kept, ..) = pruned(&lumen([52, 22, 8], slab));
    assert_eq!((raw, kept), (0, 0));
}

#[test]
fn a_run_left_out_is_a_loop_too_many_and_contacts_merged_one_too_few() {
    let tube = |v: IVec3| (v.as_vec3().truncate() - glam::Vec2::splat(15.0)).length() <= 10.0;
    let l = lumen([31, 31, 60], tube);
    let (whole, collapsed) = checked(&l);
    assert_eq!(loops(&collapsed, 1), 0);
    // A run that bounds no corner, and one that bounds two.
    let bounds = |r: u32| whole.corners.iter().filter(|k| k.runs.contains(&r)).count();
    let run = (0..whole.runs.len() as u32).find(|r| bounds(*r) == 0);
    if let Some(run) = run {
        let mut less = whole.clone();
        less.runs.remove(run as usize);
        for k in &mut less.corners {
            k.runs.iter_mut().filter(|r| **r > run).for_each(|r| *r -= 1);
        }
        assert_eq!(less.euler() - euler_of_mask(&l), less.euler_within_cells() - 1);
        assert_eq!(loops(&collapse(&less, &[]), 1), 1);
    }
    let ring = lumen([45, 45, 21], torus([22.0, 22.0, 10.0], 14.0, 5.0));
    let (whole, collapsed) = checked(&ring);
    assert_eq!(loops(&collapsed, 1), 1);
    // Two contacts taken for one: the identity of Euler characteristics does not hold.
    let mut less = whole.clone();
    less.contacts.pop();
    assert_ne!(less.euler() - euler_of_mask(&ring), less.euler_within_cells());
}
