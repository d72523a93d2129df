//! Readers and writers: what was written, damaged and lying headers, memory.

mod cut_streams;
mod deflated;
mod dicom;
mod dicom_series;
mod fuzz_readers;
mod hostile;
mod in_parts;
mod layers;
mod memory;
mod meshes;
mod others;
mod pictures;
mod segments;
mod volumes;
mod vtk_surfaces;
mod zarr;

use peak_alloc::PeakAlloc;

/// Counts what the process has allocated; a test that reads it runs alone (`common::child`).
#[global_allocator]
static COUNTED: PeakAlloc = PeakAlloc;
