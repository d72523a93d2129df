//! Files in and out. Volumes: DICOM in; NIfTI, NRRD, MetaImage in and out. Meshes: PLY, STL, OBJ,
//! VTP in and out, glTF out. Centerlines: VTP, CSV and Slicer curve out. Pictures: PNG and, through
//! ffmpeg, video.
//!
//! Coordinates are converted to LPS mm at the door. Every output appears whole or not at all
//! ([`atomic_file`]). Only geometry and intensity fields of an input are kept; no other text of it
//! reaches an output.

mod curve;
mod error;
mod image;
mod json;
mod mesh;
mod video;
mod vol;
pub mod atomic_file;

pub use curve::{write_branches, write_centerline};
pub use error::{FieldValue, FormatError, shown, shown_lines};
pub use image::{encode_png, png_size, read_png, write_png};
pub use json::{to_json, to_pretty_json};
pub use mesh::{Facing, Space, is_mesh, read_mesh, write_mesh, write_wall};
pub use video::{NoFfmpeg, VideoWriter};
pub use vol::{
    ImageInfo, InputInfo, ReadOptions, ScreenText, SegmentDescription, SegmentInfo, SeriesInfo,
    SnomedCode, SourceSeries, VolumeParts, check_data_file, input_files, inspect, names_are_places,
    open_plain, read_plain, read_volume, write_layers, write_segment, write_vector_field,
    write_volume,
};

/// Carried by every image and video that leaves, and by the report.
pub const NOTICE: &str = "Research and education only. Not for diagnosis.";
