//! Volumes, fields, centerlines, surfaces and levels of detail on the CPU, beside formulas, brute
//! force and fixtures of other programs.

mod coverage;
mod determinism;
mod ends;
mod flight;
mod fluid_levels;
mod graph;
mod invariance;
mod lesion;
mod lod;
mod lod_determinism;
mod lod_rays;
mod narrowing;
mod oracle_centerline;
mod oracle_lumen;
mod oracle_normals;
mod oracle_route;
mod oracle_segmentation;
mod oracle_surface;
mod oracle_tree;
mod organ;
mod phantoms;
mod radius;
mod shared_data;
mod torsos;
