//! The flight as files: frames in a folder of their own, and a video where there is ffmpeg. All of
//! it or nothing.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::notice::notice_stamp;
use crate::flight::Flight;
use crate::formats::{FormatError, VideoWriter, shown};
use crate::session::{FlightRoute, Recording, Session, SessionError, is_frame_file};

/// Draws a flight into a new folder `STEM-1`, `STEM-2`, … and a video of that name; returns where both
/// are. A flight that is not drawn to its end leaves no file, and flights that were saved before stay.
///
/// * `flight`: the session's flight where `None`.
///
/// # Errors
/// As [`Session::record`]; [`FormatError::Io`] if there can be no folder.
pub(super) fn save_flight(
    session: &Session,
    (folder, stem): (&Path, &str),
    flight: Option<(FlightRoute, Arc<Flight>)>,
    fps: f64,
) -> Result<String, SessionError> {
    let (frames, path) = new_folder(folder, stem)?;
    let video = VideoWriter::available().then(|| (path.clone(), fps));
    let stamp = Some(notice_stamp(session.settings().flight.size));
    let to = Recording { frames: frames.clone(), video, flight, stamp, ..Recording::default() };
    let recorded = session.record(&to);
    let count = match recorded {
        Ok(stream) => stream.report().count,
        Err(e) => {
            remove_frames(&frames);
            return Err(e);
        }
    };
    let absolute = |path: &Path| {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        shown(&path).to_string()
    };
    let of_video = match to.video {
        Some((video, _)) => format!("{} and ", absolute(&video)),
        None => "no video, as there is no ffmpeg; ".into(),
    };
    Ok(format!("wrote {of_video}{count} frames to {}", absolute(&frames)))
}

/// Makes a folder that nothing is in; returns it, and a video of its name that is not there.
fn new_folder(folder: &Path, stem: &str) -> Result<(PathBuf, PathBuf), FormatError> {
    std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
    for i in 1u32.. {
        let (path, video) =
            (folder.join(format!("{stem}-{i}")), folder.join(format!("{stem}-{i}.mp4")));
        if video.exists() {
            continue;
        }
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok((path, video)),
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(FormatError::io(&path, e)),
        }
    }
    unreachable!("numbers do not end")
}

/// Removes frames, and their folder if nothing else is in it.
fn remove_frames(folder: &Path) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries {
        if entry.file_name().to_str().is_some_and(is_frame_file) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    let _ = std::fs::remove_dir(folder);
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::flight::Frames;
    use crate::formats::read_png;
    use crate::session::{Settings, Source, VolumeSource};
    use crate::volume::phantom::{Kind, Phantom};

    /// A session whose flight has a hundred small frames.
    fn session() -> Session {
        let mask = Phantom::new(Kind::Tube, 32, [1.0; 3]).unwrap().mask();
        let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
        let mut settings = Settings::default();
        settings.flight.frames = Frames::Count(100);
        settings.flight.size = [64, 48];
        Session::new(source, settings).unwrap()
    }

    fn has_device() -> bool {
        let is_there = crate::vk::Gpu::open(crate::vk::Choice::Any).is_ok();
        assert!(is_there || std::env::var_os("INTIMA_REQUIRE_GPU").is_none(), "a device");
        is_there
    }

    #[test]
    fn a_flight_whose_saving_was_stopped_leaves_no_frame_and_the_one_before_stays() {
        if !has_device() {
            return;
        }
        let tmp = tempfile::tempdir().unwrap();
        let session = session();
        let said = save_flight(&session, (tmp.path(), "flight"), None, 25.0).unwrap();
        let first = tmp.path().join("flight-1");
        assert!(said.contains("100 frames") && said.contains(&*first.to_string_lossy()), "{said}");
        let names = || -> Vec<String> {
            let entries = std::fs::read_dir(tmp.path()).unwrap();
            let mut all: Vec<String> =
                entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
            all.sort();
            all
        };
        let before = names();
        let cancel = session.cancel_token();
        let stopped = std::thread::scope(|scope| {
            let saving = scope.spawn(|| save_flight(&session, (tmp.path(), "flight"), None, 25.0));
            // Once some frames are drawn.
            while !saving.is_finished()
                && session.progress().frames.is_none_or(|(done, _)| done < 3)
            {
                std::thread::sleep(Duration::from_millis(1));
            }
            cancel.cancel();
            saving.join().unwrap()
        });
        assert!(matches!(stopped, Err(SessionError::Cancelled)), "{stopped:?}");
        assert_eq!(names(), before);
        assert_eq!(std::fs::read_dir(&first).unwrap().count(), 100);
        // After a stop a flight can be saved again, and another flight as well.
        cancel.reset();
        let mut other = (*session.flight().unwrap()).clone();
        other.poses.truncate(10);
        let other = Some((FlightRoute::Trunk, Arc::new(other)));
        save_flight(&session, (tmp.path(), "flight"), other, 25.0).unwrap();
        let second = tmp.path().join("flight-2");
        assert_eq!(std::fs::read_dir(&second).unwrap().count(), 10);
        // The notice is in the picture, and nothing else is changed.
        let (width, height, rgb) = read_png(&second.join("frame_00001.png")).unwrap();
        let drawn = session.frames().unwrap().next_frame().unwrap().unwrap();
        let stamp = notice_stamp([width, height]);
        let stamped = 3 * (width * (height - stamp.size[1])) as usize;
        assert_eq!(rgb[..stamped], drawn.rgb[..stamped]);
        assert_ne!(rgb[stamped..], drawn.rgb[stamped..]);
    }
}
