//! Video through ffmpeg.
/// A video being written.
pub struct VideoWriter {}
