//! Costs of cheapest routes against SciPy's Dijkstra.

use common::fixtures::{int, json, list, lumen, real, voxel};
use glam::DVec3;
use intima::centerline::{Ends, RouteOptions, centerline};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, Sampler, distance, smooth};
use intima::lumen::Lumen;
use intima::paper::{NOWHERE, VoxelRoutes};
use serde_json::Value;

/// The exact distance, mm, and the same after a Gaussian of a voxel.
fn fields_of(lumen: &Lumen) -> (Vec<f32>, Vec<f32>) {
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let d = distance(&mut plan, &buffers);
    let f = smooth(&mut plan, &buffers, d, lumen.grid.spacing_mm.min_element(), None);
    plan.download(d);
    plan.download(f);
    let out = run_cpu(&plan);
    (out.get(d).to_vec(), out.get(f).to_vec())
}

fn cases() -> Vec<(String, Value)> {
    let Value::Object(all) = json("route.json") else { panic!("route.json is an object") };
    assert!(all.len() >= 7);
    all.into_iter().collect()
}

/// Checks every target and the sum over all nodes: our cost over theirs, as `least..=most`.
fn assert_costs(
    lumen: &Lumen,
    routes: &VoxelRoutes,
    want: &Value,
    keys: (&str, &str),
    (least, most): (f64, f64),
) -> f64 {
    let unit = routes.unit_mm;
    let reached: Vec<f64> =
        routes.length.iter().filter(|l| **l != NOWHERE).map(|l| f64::from(*l)).collect();
    assert_eq!(reached.len() as i64, int(&want["reached"]));
    assert_eq!(lumen.inside_voxels() as i64 - reached.len() as i64, int(&want["unreached"]));
    let mut worst = 1.0f64;
    let mut check = |got: f64, want: f64| {
        let ratio = if want == 0.0 { 1.0 + got } else { got / want };
        assert!(least <= ratio && ratio <= most, "{got}, not {want}: {ratio}");
        worst = if (ratio - 1.0).abs() > (worst - 1.0).abs() { ratio } else { worst };
    };
    for target in list(&want["targets"]) {
        let at = lumen.bricks.element(voxel(&target["at"])).expect("a target is inside");
        check(f64::from(routes.length[at]) * unit, real(&target[keys.0]));
    }
    check(reached.iter().sum::<f64>() * unit, real(&want[keys.1]));
    worst
}

#[test]
fn lengths_are_those_of_dijkstra_within_a_hundred_and_twenty_eighth() {
    // A step is rounded to a 64th of the shortest spacing and is at least that spacing long: each
    // is off by a 128th of its length at most, and so is the shortest route.
    for (name, want) in cases() {
        let lumen = lumen(&name);
        let source = lumen.bricks.element(voxel(&want["source"])).expect("the source is inside");
        let routes = VoxelRoutes::from(&lumen, source);
        let range = (1.0 - 1.0 / 128.0, 1.0 + 1.0 / 128.0);
        let keys = ("plain_mm", "sum_plain_mm");
        let worst = assert_costs(&lumen, &routes, &want, keys, range);
        println!("{name}: {worst:.5}");
    }
}

#[test]
fn curves_between_given_ends_cost_little_more_than_the_cheapest_route_over_voxels() {
    // SciPy's route is the cheapest of those over voxel centres; a curve may cut their corners, and
    // is centred instead of cheap.
    let (mut most, mut judged) = (0.0f64, 0);
    for (name, want) in cases() {
        let lumen = lumen(&name);
        let (d, f) = fields_of(&lumen);
        let h = lumen.grid.spacing_mm.min_element();
        let world = lumen.grid.world_from_voxel();
        let at = |v| world.transform_point3(voxel(v).as_dvec3());
        let sampler = Sampler { lumen: &lumen, field: &d };
        let (mut worst, mut ended) = (0.0f64, 0);
        for target in list(&want["targets"]) {
            let (from, to) = (at(&want["source"]), at(&target["at"]));
            let least = real(&target["centred"]);
            if real(&target["plain_mm"]) < 10.0 * h {
                continue;
            }
            let ends = Ends { from: Some(from), to: Some(to) };
            let options = RouteOptions { ends, ..RouteOptions::default() };
            let routed = centerline(&lumen, &d, &f, options).unwrap();
            ended = routed.loops.iter().filter(|l| l.found.ended.is_some()).count();
            let local = lumen.grid.voxel_from_world();
            let points = routed.line.branches[0].points.iter();
            let points: Vec<DVec3> = points
                .map(|p| local.transform_point3(p.position_mm) * lumen.grid.spacing_mm)
                .collect();
            let cost = |w: &[DVec3]| {
                let of = |p| (h / sampler.at(p).max(h)).powi(2);
                w[0].distance(w[1]) * 0.5 * (of(w[0]) + of(w[1]))
            };
            let cost: f64 = points.windows(2).map(cost).sum();
            worst = worst.max(cost / least);
        }
        println!("{name}: {worst:.3}, {ended} loops cut");
        // Where a rule cut a loop the way may go round the other side.
        if ended == 0 {
            (most, judged) = (most.max(worst), judged + usize::from(worst > 0.0));
        }
    }
    assert!(most < 1.1 && judged >= 3, "{most} of {judged}");
}
