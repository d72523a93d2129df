//! Faces into clusters that fit a page.

use glam::Vec3;
use rayon::prelude::*;

use super::draft::{Draft, Lies, Parts};
use super::partition;
use crate::geometry::Mesh;
use crate::geometry::median_split::KeyedPoint;
use crate::lod::{PAGE_TRIANGLES, PAGE_VERTICES};

/// Faces of a cluster as first cut. Two thirds of a page: smaller clusters need finer levels where
/// they are near only, and less of them is drawn beyond the edge of the picture.
const FILL: usize = 60;
/// Faces of a cluster once its rim is evened out.
const MOST: usize = 64;
// [`Lies`] has a bit for each.
const _: () = assert!(MOST <= PAGE_TRIANGLES && MOST <= 64);

/// Clusters of the original's own faces.
pub fn finest(mesh: &Mesh, beside: &[[u32; 3]]) -> Vec<Draft> {
    let centre = |f: u32| {
        let [a, b, c] = mesh.faces[f as usize].map(|v| mesh.positions[v as usize]);
        (a + b + c) / 3.0
    };
    let (mut ids, parts) = clusters_of(&mesh.faces, beside, &centre);
    let own = cut_up(&mut ids, parts);
    own.into_par_iter()
        .map(|ids| {
            ids.sort_unstable();
            let faces: Vec<[u32; 3]> = ids.iter().map(|f| mesh.faces[*f as usize]).collect();
            let whole = (0..).zip(ids.iter()).map(|(t, face)| Lies::on(*face, t)).collect();
            Draft { whole, back: vec![0.0; faces.len()], ..draft(&faces) }
        })
        .collect()
}

/// A cluster of at most [`PAGE_TRIANGLES`] faces, which stands for nothing yet.
pub fn draft(faces: &[[u32; 3]]) -> Draft {
    let vertices = vertices_of(faces.iter().copied());
    let place = |v: u32| vertices.binary_search(&v).unwrap_or(0) as u8;
    let triangles = faces.iter().map(|f| f.map(place)).collect();
    Draft {
        triangles,
        vertices,
        whole: Vec::new(),
        parts: Parts::default(),
        back: Vec::new(),
        error: 0.0,
    }
}

/// Each vertex once, ascending.
fn vertices_of(faces: impl Iterator<Item = [u32; 3]>) -> Vec<u32> {
    let mut all: Vec<u32> = faces.flatten().collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Neighbouring parts of so many.
fn cut_up(all: &mut [u32], sizes: impl IntoIterator<Item = usize>) -> Vec<&mut [u32]> {
    let mut rest = all;
    let part = |n| rest.split_off_mut(..n).unwrap_or_default();
    sizes.into_iter().map(part).collect()
}

/// Sorts faces into clusters that fit a page: their ids cluster after cluster, ascending in each,
/// and how many each takes.
pub fn clusters_of(
    faces: &[[u32; 3]],
    beside: &[[u32; 3]],
    centre: &(impl Fn(u32) -> Vec3 + Sync),
) -> (Vec<u32>, Vec<usize>) {
    let all = (0..faces.len() as u32).into_par_iter().with_min_len(8192);
    let mut placed: Vec<KeyedPoint> = all.map(|f| KeyedPoint::new(centre(f), f)).collect();
    let mut sizes = partition::split(&mut placed, FILL);
    let mut part = vec![0u32; faces.len()];
    let mut first = 0;
    for (n, id) in sizes.iter().zip(0..) {
        placed[first..first + n].iter().for_each(|f| part[f.id() as usize] = id);
        first += n;
    }
    let mut order: Vec<u32> = placed.iter().map(KeyedPoint::id).collect();
    partition::smooth(&mut part, &mut sizes, MOST, beside);
    let mut fill = vec![0; sizes.len()];
    for i in 1..sizes.len() {
        fill[i] = fill[i - 1] + sizes[i - 1];
    }
    for (f, p) in (0..).zip(&part) {
        order[fill[*p as usize]] = f;
        fill[*p as usize] += 1;
    }
    let parts = cut_up(&mut order, sizes.into_iter().filter(|n| *n > 0));
    let fit = parts.into_par_iter().map(|own| {
        // Loose triangles have more vertices than faces.
        if vertices_of(own.iter().map(|f| faces[*f as usize])).len() > PAGE_VERTICES {
            let mut placed: Vec<_> = own.iter().map(|f| KeyedPoint::new(centre(*f), *f)).collect();
            let sizes = partition::split(&mut placed, PAGE_VERTICES / 3);
            own.iter_mut().zip(placed).for_each(|(f, p)| *f = p.id());
            sizes
        } else {
            vec![own.len()]
        }
    });
    let fit: Vec<Vec<usize>> = fit.collect();
    let fit = fit.concat();
    (order, fit)
}
