use glam::IVec3;

use super::*;
use crate::lumen::{BitVolume, Lumen};
use crate::volume::Grid;

/// A lumen of the voxels of a box that `holds`; component and cavities as they are.
fn lumen(dims: [u32; 3], holds: impl Fn(IVec3) -> bool) -> Lumen {
    let grid = Grid::axis_aligned(dims, [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| holds(v.as_ivec3())) {
        bits.set(v.x, v.y, v.z);
    }
    Lumen::new(grid, &bits)
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
    let mix = |n: u32| (n ^ n >> 16).wrapping_mul(0x45d9_f3b).rotate_left(13);
    mix(mix(mix(v.x as u32 ^ seed) ^ v.y as u32) ^ v.z as u32) >> 8
}

fn checked(lumen: &Lumen) -> (CellComplex, Collapsed) {
    let complex = CellComplex::new(lumen, &distance(lumen));
    assert_eq!(complex.euler() - euler_of_mask(lumen), complex.euler_within_cells());
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
    let shapes: [(&str, [u32; 3], &dyn Fn(IVec3) -> bool, usize); 6] = [
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
    let complex = CellComplex::new(&l, &distance(&l));
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
    let complex = CellComplex::new(&l, &d);
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
        let again = pool.install(|| CellComplex::new(&l, &d));
        assert_eq!(
            (again.nodes, again.contacts),
            (complex.nodes.clone(), complex.contacts.clone())
        );
        assert_eq!((again.runs, again.corners), (complex.runs.clone(), complex.corners.clone()));
    }
}
