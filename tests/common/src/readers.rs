//! What fuzz tests call: a file read by its extension, and what must be true of what was read.

use std::path::Path;

use intima::flight::CameraPath;
use intima::formats::{FormatError, ReadOptions, inspect, read_mesh, read_volume};

/// Reads a file by its extension; the error as text.
///
/// # Panics
/// Where what was read is not fit to be worked on.
pub fn read(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let extension = path.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
    match extension.as_str() {
        "json" => CameraPath::parse(bytes).map(drop).map_err(|e| e.to_string()),
        "ply" | "stl" | "obj" | "vtp" => {
            let (mesh, _) = read_mesh(path, None).map_err(|e| e.to_string())?;
            let count = mesh.positions.len();
            assert!(mesh.faces.iter().flatten().all(|v| (*v as usize) < count));
            assert!(mesh.positions.iter().all(|p| p.is_finite()));
            Ok(())
        }
        _ => {
            let _ = inspect(path, &ReadOptions::default());
            let mut volume = read_volume(path, &ReadOptions::default());
            if let Err(FormatError::Segments { .. }) = volume {
                let segments = vec!["Lumen".to_owned()];
                volume = read_volume(path, &ReadOptions { segments, ..Default::default() });
            }
            let volume = volume.map_err(|e| e.to_string())?;
            assert_eq!(volume.samples.len(), volume.grid.len());
            assert!(volume.grid.spacing_mm.min_element() > 0.0);
            Ok(())
        }
    }
}
