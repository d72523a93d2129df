//! A centerline as Slicer markups, schema 1.0.3: one curve a branch.

use std::io::{self, Write};

use serde_json::{Value, json};

use crate::formats::json::to_pretty_json;
use crate::geometry::{Branch, Centerline};

const SCHEMA: &str = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";

pub(super) fn write(out: &mut dyn Write, line: &Centerline) -> io::Result<()> {
    let markups: Vec<Value> = line.branches.iter().enumerate().map(|(b, x)| curve(b, x)).collect();
    let text = to_pretty_json(&json!({"@schema": SCHEMA, "markups": markups}))?;
    writeln!(out, "{text}")
}

fn curve(index: usize, branch: &Branch) -> Value {
    let points: Vec<Value> = branch
        .points
        .iter()
        .enumerate()
        .map(|(i, p)| {
            json!({
                "id": (i + 1).to_string(),
                "position": p.position_mm.to_array(),
                "selected": true,
                "locked": true,
                "visibility": true,
                "positionStatus": "defined",
            })
        })
        .collect();
    let radii: Vec<f64> = branch.points.iter().map(|p| p.radius_mm).collect();
    let mean = radii.iter().sum::<f64>() / radii.len().max(1) as f64;
    let length: f64 =
        branch.points.windows(2).map(|w| w[0].position_mm.distance(w[1].position_mm)).sum();
    json!({
        "type": "Curve",
        "name": format!("branch {index}"),
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": true,
        "fixedNumberOfControlPoints": false,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": points.len(),
        "controlPoints": points,
        "measurements": [
            {"name": "length", "enabled": true, "value": length, "units": "mm"},
            {
                "name": "Radius", "enabled": true, "value": mean, "units": "mm",
                "description": "distance to the wall; the value is the mean",
                "controlPointValues": radii,
            },
        ],
    })
}
