//! Flags of the frames of a flight.

use std::path::{Path, PathBuf};

use super::CliError;
use crate::flight::{CameraPath, Frames};
use crate::formats::read_plain;
use crate::lod::vds::Scheme;
use crate::render::View;
use crate::session::{
    Antialiasing, FlightRoute, FlightSettings, LevelSettings, Lod, check_frame_rate,
    check_frame_size,
};

/// Flags of the frames.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Frames")]
pub struct FrameArgs {
    /// Number of frames, equal steps in flight time (default 120)
    #[arg(long, value_name = "N", conflicts_with_all = ["speed"])]
    pub frames: Option<usize>,
    /// Cruising speed; the flight is slower where it is narrow or turns
    #[arg(long, value_name = "MM_PER_S")]
    pub speed: Option<f64>,
    /// Frames a second
    #[arg(long, value_name = "F", default_value_t = 25.0)]
    pub fps: f64,
    /// Pixels of a frame
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: String,
    /// View that a frame shows
    #[arg(long, value_enum, default_value = "inside")]
    pub view: View,
    /// Show so many mm of tissue behind the wall, by its CT numbers; the translucent view alone shows 5
    /// (8 behind an airway)
    #[arg(long, value_name = "MM")]
    pub behind: Option<f32>,
    /// Raise fine relief in views from inside by this share: 0.5 is half as much again
    #[arg(long, value_name = "K", default_value_t = 0.0)]
    pub local_contrast: f32,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "DEG", default_value_t = 90.0)]
    pub fov: f32,
    /// How edges are kept from looking like stairs
    #[arg(long, value_enum, default_value = "auto")]
    pub msaa: Antialiasing,
    /// Fly from the end to the start
    #[arg(long)]
    pub reverse: bool,
    /// Fly the way to the tip of a branch (leaf:N, numbered as in the CSV) or every branch (all);
    /// makes a tree
    #[arg(long, value_name = "leaf:N|all", value_parser = route, conflicts_with = "path")]
    pub route: Option<FlightRoute>,
    /// Write a video too: .mp4 or .gif (needs ffmpeg)
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Fly this camera path instead of our own (intima.path/1)
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["reverse", "speed"])]
    pub path: Option<PathBuf>,
    /// Write the camera path
    #[arg(long, value_name = "FILE.json")]
    pub write_path: Option<PathBuf>,
    #[command(flatten)]
    pub levels: LevelArgs,
}

/// `WxH`.
pub fn frame_size(text: &str) -> Result<[u32; 2], CliError> {
    let size =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size = size.ok_or_else(|| CliError::Usage(format!("--size `{text}`: WxH")))?;
    check_frame_size(size)?;
    Ok(size)
}

/// Parses the branches to fly.
fn route(text: &str) -> Result<FlightRoute, String> {
    let leaf = text.strip_prefix("leaf:").and_then(|n| n.parse().ok());
    match (text, leaf) {
        ("all", _) => Ok(FlightRoute::All),
        (_, Some(branch)) => Ok(FlightRoute::Leaf(branch)),
        _ => Err("leaf:N with the number of a branch, or all".into()),
    }
}

impl FrameArgs {
    /// Settings of the flight; the session checks them, but for the rate of a video.
    pub fn settings(&self) -> Result<FlightSettings, CliError> {
        check_frame_rate(self.fps)?;
        Ok(FlightSettings {
            size: frame_size(&self.size)?,
            frames: match self.speed {
                Some(mm_per_s) => Frames::Speed { mm_per_s, fps: self.fps },
                None => Frames::Count(self.frames.unwrap_or(120)),
            },
            view: self.view,
            behind_mm: self.behind,
            local_contrast: self.local_contrast,
            fov_y_rad: self.fov.to_radians(),
            antialiasing: self.msaa,
            reverse: self.reverse,
            route: self.route.unwrap_or_default(),
            script: self.path.as_deref().map(read_script).transpose()?,
            script_frames: self.frames,
        })
    }
}

/// Flags of level of detail.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Level of detail")]
pub struct LevelArgs {
    /// Level of detail of the wall; auto is culled, with faces near the eye split onto the smooth wall
    #[arg(long, value_enum, default_value = "auto")]
    pub lod: Lod,
    /// Subdivision scheme of --lod vds
    #[arg(long, value_enum, default_value = "1-to-4")]
    pub scheme: Scheme,
    /// Pixels that a drawn edge may sag from the smooth wall (auto), or vds be away from the mesh
    #[arg(long, value_name = "T", default_value_t = 1.0)]
    pub pixel_error: f32,
}

impl LevelArgs {
    /// Settings of the levels.
    pub fn settings(&self) -> Result<LevelSettings, CliError> {
        let Self { lod, scheme, pixel_error } = *self;
        let levels = LevelSettings { lod, scheme, pixel_error };
        levels.check()?;
        Ok(levels)
    }
}

fn read_script(path: &Path) -> Result<CameraPath, CliError> {
    Ok(CameraPath::parse(&read_plain(path, crate::flight::MAX_BYTES as u64 + 1)?)?)
}
