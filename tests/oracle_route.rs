//! Costs of cheapest routes against SciPy's Dijkstra.

#[path = "common/fixtures.rs"]
mod common;

use common::{int, json, list, lumen, real, voxel};
use intima::centerline::{Graph, NOWHERE, Routes};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, distance};
use intima::lumen::Lumen;
use serde_json::Value;

fn distance_of(lumen: &Lumen) -> Vec<f32> {
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let d = distance(&mut plan, &buffers);
    plan.download(d);
    run_cpu(&plan).get(d).to_vec()
}

fn cases() -> Vec<(String, Value)> {
    let Value::Object(all) = json("route.json") else { panic!("route.json is an object") };
    assert!(all.len() >= 7);
    all.into_iter().collect()
}

/// Checks every target and the sum over all nodes: our cost over theirs, as `least..=most`.
fn assert_costs(
    graph: &Graph<'_>,
    routes: &Routes,
    want: &Value,
    keys: (&str, &str),
    unit: f64,
    (least, most): (f64, f64),
) -> f64 {
    assert_eq!(routes.order.len() as i64, int(&want["reached"]));
    assert_eq!((graph.len() - routes.order.len()) as i64, int(&want["unreached"]));
    let mut worst = 1.0f64;
    let mut check = |got: f64, want: f64| {
        let ratio = if want == 0.0 { 1.0 + got } else { got / want };
        assert!(least <= ratio && ratio <= most, "{got}, not {want}: {ratio}");
        worst = if (ratio - 1.0).abs() > (worst - 1.0).abs() { ratio } else { worst };
    };
    for target in list(&want["targets"]) {
        let node = graph.node_at(voxel(&target["at"])).expect("a target is inside");
        check(f64::from(routes.cost[node as usize]) * unit, real(&target[keys.0]));
    }
    let reached = routes.cost.iter().filter(|c| **c != NOWHERE);
    check(reached.map(|c| f64::from(*c)).sum::<f64>() * unit, real(&want[keys.1]));
    worst
}

#[test]
fn lengths_are_those_of_dijkstra_within_a_hundred_and_twenty_eighth() {
    // A step is rounded to a 64th of the shortest spacing and is at least that spacing long: each
    // is off by a 128th of its length at most, and so is the shortest route.
    for (name, want) in cases() {
        let lumen = lumen(&name);
        let graph = Graph::new(&lumen);
        let source = graph.node_at(voxel(&want["source"])).expect("the source is inside");
        let routes = graph.by_length(&[source]);
        let range = (1.0 - 1.0 / 128.0, 1.0 + 1.0 / 128.0);
        let keys = ("plain_mm", "sum_plain_mm");
        let worst = assert_costs(&graph, &routes, &want, keys, graph.length_unit_mm(), range);
        println!("{name}: {worst:.5}");
    }
}

#[test]
fn centred_costs_are_those_of_dijkstra_and_a_sixty_fourth_more_at_most() {
    // A step's cost is rounded up to the next unit, and the cheapest is worth 64 units; past a
    // depth of 32 voxels units grow coarser, which no fixture reaches.
    for (name, want) in cases() {
        let lumen = lumen(&name);
        let d = distance_of(&lumen);
        let h = lumen.grid.spacing_mm.min_element();
        let deepest = f64::from(d.iter().copied().fold(0.0, f32::max));
        assert!(deepest < 32.0 * h, "{name}");
        let unit = h / (64.0 * (deepest / h).powi(2));
        let graph = Graph::new(&lumen);
        let source = graph.node_at(voxel(&want["source"])).expect("the source is inside");
        let routes = graph.by_centrality(&[source], &d);
        let keys = ("centred", "sum_centred");
        let range = (1.0 - 1e-5, 1.0 + 1.0 / 64.0 + 1e-5);
        let worst = assert_costs(&graph, &routes, &want, keys, unit, range);
        println!("{name}: {worst:.5}");
    }
}
