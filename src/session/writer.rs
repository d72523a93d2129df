//! Writing frames: PNG encoders beside the drawing, and a video.

use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use thread_priority::{ThreadPriority, set_current_thread_priority};

use super::{DrawnFrame, SessionError};
use crate::formats::{FormatError, VideoWriter, atomic_file, encode_png};
use crate::render::Spares;

/// Frames that may wait for each encoder: bounds what waits in memory, and lasts until the drawing
/// leaves the encoders some time.
const QUEUED: usize = 2;

/// Name of a frame's file, counted from 1.
pub fn frame_file(number: usize) -> String {
    format!("frame_{number:05}.png")
}

/// Whether a name is one that a frame's file has.
pub fn is_frame_file(name: &str) -> bool {
    let number = name.strip_prefix("frame_").and_then(|n| n.strip_suffix(".png"));
    number.and_then(|n| n.parse().ok()).is_some_and(|n| frame_file(n) == name)
}

/// Makes the folder if it is not there and removes the frames of an earlier flight: a shorter one
/// would leave the rest of them, perhaps of another patient, behind its own.
pub(super) fn clear_folder(folder: &Path) -> Result<(), SessionError> {
    std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
    for entry in std::fs::read_dir(folder).map_err(|e| FormatError::io(folder, e))? {
        let path = entry.map_err(|e| FormatError::io(folder, e))?.path();
        let name = path.file_name().and_then(|n| n.to_str());
        if name.is_some_and(is_frame_file) && !path.is_dir() {
            std::fs::remove_file(&path).map_err(|e| FormatError::io(&path, e))?;
        }
    }
    Ok(())
}

/// A text as pixels, over the lower left corner of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamp {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Opacity of the text, rows from the top.
    pub opacity: Vec<u8>,
}

impl Stamp {
    /// Grey of the text.
    const TEXT: u32 = 210;

    /// Marks a picture: eight bits each of red, green and blue. The picture under the text
    /// is made half as bright. Where the picture is smaller than the text, the rest of the text is left
    /// out.
    pub fn mark(&self, [width, height]: [u32; 2], rgb: &mut [u8]) {
        let [columns, rows] = self.size;
        let below = rows.saturating_sub(height) as usize;
        let first_row = height.saturating_sub(rows) as usize;
        let stamped = self.opacity.chunks_exact(columns.max(1) as usize).skip(below);
        for (row, text) in rgb.chunks_exact_mut(3 * width as usize).skip(first_row).zip(stamped) {
            for (pixel, opacity) in row.chunks_exact_mut(3).zip(text) {
                let opacity = u32::from(*opacity);
                for value in pixel {
                    let ground = u32::from(*value) / 2;
                    *value = ((ground * (255 - opacity) + Self::TEXT * opacity) / 255) as u8;
                }
            }
        }
    }
}

/// Writes frames as PNG files of a folder, and as a video where one is asked for. Encoders run on
/// threads of the lowest priority: software devices draw on the same cores.
pub struct FrameWriter {
    queues: Vec<SyncSender<DrawnFrame>>,
    encoders: Vec<JoinHandle<Result<(), FormatError>>>,
    video: Option<VideoWriter>,
}

impl FrameWriter {
    /// A writer into `folder`, which has to be there.
    ///
    /// * `threads`: of the session; half of them encode, and of eight or fewer up to four.
    /// * `spares`: where pictures are given back.
    ///
    /// # Errors
    /// As [`VideoWriter::create`]; [`SessionError::System`] without a thread.
    pub fn new(
        folder: &Path,
        size: [u32; 2],
        threads: usize,
        spares: &Spares,
        video: Option<(&Path, f64)>,
    ) -> Result<Self, SessionError> {
        let video = video
            .map(|(path, fps)| VideoWriter::create(path, size[0], size[1], fps))
            .transpose()?;
        let mut writer = Self { queues: Vec::new(), encoders: Vec::new(), video };
        for _ in 0..threads.clamp(1, 4).max(threads / 2) {
            let (send, receive) = sync_channel::<DrawnFrame>(QUEUED);
            let (spares, folder) = (spares.clone(), folder.to_owned());
            let encode = move || -> Result<(), FormatError> {
                // Where that may not be asked for, frames come out all the same.
                let _ = set_current_thread_priority(ThreadPriority::Min);
                for DrawnFrame { index, size: [width, height], rgb, .. } in receive {
                    let png = encode_png(width, height, &rgb);
                    spares.give(rgb);
                    let path = folder.join(frame_file(index + 1));
                    atomic_file::write_atomic(&path, |o| o.write_all(&png))?;
                }
                Ok(())
            };
            let thread = std::thread::Builder::new().name("encoder".into()).spawn(encode);
            writer.encoders.push(thread.map_err(|e| SessionError::System(e.to_string()))?);
            writer.queues.push(send);
        }
        Ok(writer)
    }

    /// Takes a frame; waits while its encoder's queue is full.
    ///
    /// # Errors
    /// The video's. An encoder's error is given by [`FrameWriter::finish`].
    pub fn write(&mut self, frame: DrawnFrame) -> Result<(), SessionError> {
        if let Some(video) = &mut self.video {
            video.frame(&frame.rgb)?;
        }
        // An encoder that failed has closed its queue; `finish` says why.
        let queue = frame.index % self.queues.len();
        let _ = self.queues[queue].send(frame);
        Ok(())
    }

    /// Waits until everything is written.
    ///
    /// # Errors
    /// The first encoder's, or the video's.
    pub fn finish(mut self) -> Result<(), SessionError> {
        self.join()?;
        if let Some(video) = self.video.take() {
            video.finish()?;
        }
        Ok(())
    }

    fn join(&mut self) -> Result<(), SessionError> {
        self.queues.clear();
        let mut outcome = Ok(());
        for encoder in self.encoders.drain(..) {
            let ended = encoder.join();
            let ended = ended.map_err(|_| SessionError::System("a PNG encoder panicked".into()));
            outcome = outcome.and(ended.and_then(|e| e.map_err(SessionError::from)));
        }
        outcome
    }
}

impl Drop for FrameWriter {
    fn drop(&mut self) {
        let _ = self.join();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_marks_the_lower_left_corner_and_nothing_else() {
        let stamp = Stamp { size: [2, 1], opacity: vec![255, 0] };
        let mut rgb = vec![100u8; 3 * 3 * 2];
        stamp.mark([3, 2], &mut rgb);
        assert_eq!(rgb[..9], [100; 9]);
        assert_eq!(rgb[9..], [210, 210, 210, 50, 50, 50, 100, 100, 100]);
        // A picture smaller than the text.
        let mut one = vec![100u8; 3];
        Stamp { size: [2, 2], opacity: vec![0, 0, 255, 255] }.mark([1, 1], &mut one);
        assert_eq!(one, [210; 3]);
    }

    #[test]
    fn every_frame_of_the_longest_flight_has_a_name_that_the_next_run_removes() {
        for number in [1, 99_999, 100_000, crate::flight::MAX_FRAMES] {
            assert!(is_frame_file(&frame_file(number)), "{number}");
        }
        for other in ["frame_1.png", "frame_000001.png", "frame_00001.PNG", "my_00001.png"] {
            assert!(!is_frame_file(other), "{other}");
        }
    }
}
