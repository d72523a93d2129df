//! What the oracle tests share: the fixtures of tools/oracle, and devices to run plans on.

use std::path::PathBuf;

use intima::device::{Device, DeviceChoice};
use intima::formats::{ReadOptions, read_volume};
use intima::lumen::{BitVolume, IntensitySelection, Lumen};
use intima::volume::Volume;
use serde_json::Value;

pub fn path(name: &str) -> PathBuf {
    crate::root().join("tests/fixtures").join(name)
}

pub fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

pub fn json(name: &str) -> Value {
    serde_json::from_slice(&bytes(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

pub fn volume(name: &str) -> Volume {
    read_volume(&path(name), &ReadOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Names of the label volumes with their counts.
pub fn masks() -> Vec<(String, Value)> {
    let Value::Object(all) = json("counts.json") else { panic!("counts.json is an object") };
    assert!(all.len() >= 19);
    all.into_iter().collect()
}

pub fn mask(name: &str) -> Volume {
    volume(&format!("mask/{name}.mask.nrrd"))
}

/// Every voxel of a label volume, as it is.
pub fn selected(volume: &Volume) -> BitVolume {
    IntensitySelection::Labels(Vec::new()).select(volume)
}

pub fn lumen(name: &str) -> Lumen {
    let volume = mask(name);
    Lumen::of_volume(volume.grid, &selected(&volume))
}

pub fn int(v: &Value) -> i64 {
    v.as_i64().unwrap_or_else(|| panic!("{v} is no integer"))
}

pub fn real(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("{v} is no number"))
}

pub fn list(v: &Value) -> &[Value] {
    v.as_array().unwrap_or_else(|| panic!("{v} is no list"))
}

pub fn ints(v: &Value) -> Vec<i64> {
    list(v).iter().map(int).collect()
}

pub fn voxel(v: &Value) -> glam::IVec3 {
    let v = ints(v);
    glam::IVec3::new(v[0] as i32, v[1] as i32, v[2] as i32)
}

/// The CPU and, where one opens, a Vulkan device. With `INTIMA_REQUIRE_GPU=1` one must.
pub fn devices() -> Vec<Device> {
    let mut all = vec![Device::Cpu];
    match Device::open(DeviceChoice::Gpu) {
        Ok(gpu) => {
            println!("device: {}", gpu.name());
            all.push(gpu);
        }
        Err(e) if e.is_no_device() && std::env::var("INTIMA_REQUIRE_GPU") != Ok("1".into()) => {
            println!("skipped on Vulkan: {e}");
        }
        Err(e) => panic!("{e}"),
    }
    all
}
