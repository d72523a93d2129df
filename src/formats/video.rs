//! Video through an `ffmpeg` in the search path: raw frames go into its standard input.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use super::atomic_file::{AtomicFile, TemporaryFile};
use super::error::FieldValue;
use super::{FormatError, NOTICE};

/// Time between two looks at whether ffmpeg has ended.
const POLL: std::time::Duration = std::time::Duration::from_millis(20);
/// Encoders that may still run.
static ENCODERS: Mutex<Vec<Weak<Mutex<Child>>>> = Mutex::new(Vec::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ends every encoder for good: threads that start or wait for one hang from here on. For a
/// program about to be ended by a signal.
pub(super) fn end_encoders() {
    let all = locked(&ENCODERS);
    for encoder in all.iter().filter_map(Weak::upgrade) {
        let mut child = locked(&encoder);
        let _ = child.kill();
        let _ = child.wait();
        std::mem::forget(child);
        std::mem::forget(encoder.clone());
    }
    std::mem::forget(all);
}

/// Inside of the [`FormatError::Io`] that says why no video can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no ffmpeg in the search path: a video needs it; frames as PNG do not")]
pub struct NoFfmpeg;

#[derive(Clone, Copy, PartialEq)]
enum Container {
    Mp4,
    Gif,
}

impl Container {
    /// Container that a file's extension names.
    fn of(path: &Path) -> Result<Self, FormatError> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("mp4") => Ok(Self::Mp4),
            Some("gif") => Ok(Self::Gif),
            _ => {
                let what = "a video with this extension; there are .mp4 and .gif";
                Err(FormatError::unsupported(path, what))
            }
        }
    }

    /// Refuses a number of frames a second that the container does not hold. A GIF counts hundredths of
    /// a second, and players slow frames of one hundredth down.
    fn check_rate(self, path: &Path, fps: f64) -> Result<(), FormatError> {
        let (most, why) = match self {
            Self::Mp4 => (1000.0, "not in (0, 1000]"),
            Self::Gif => (50.0, "a GIF holds 50 at most; .mp4 holds more"),
        };
        let is_held = fps > 0.0 && fps <= most;
        if is_held { Ok(()) } else { Err(FormatError::field(path, "frames a second", fps, why)) }
    }
}

/// A video being written. It takes its name at [`VideoWriter::finish`]; dropped before that, it
/// leaves nothing behind.
///
/// The same frames give the same bytes with the same build of ffmpeg.
pub struct VideoWriter {
    path: PathBuf,
    container: Container,
    frame_bytes: usize,
    frames: u64,
    child: Arc<Mutex<Child>>,
    /// Standard input of ffmpeg, for the frames.
    stdin: Option<ChildStdin>,
    /// Standard output of ffmpeg, closed when it ends, so that waiting for it holds no lock.
    stdout: Option<ChildStdout>,
    /// Standard error of ffmpeg.
    log: File,
    temporary: TemporaryFile,
}

impl VideoWriter {
    /// Whether there is an ffmpeg to write with.
    pub fn available() -> bool {
        program().is_some()
    }

    /// Checks what can be known of a video before its first frame: its extension, its rate, and that
    /// there is an ffmpeg.
    ///
    /// # Errors
    /// [`FormatError::Unsupported`], [`FormatError::Field`], [`FormatError::Io`] around [`NoFfmpeg`].
    pub fn check(path: &Path, fps: f64) -> Result<(), FormatError> {
        Container::of(path)?.check_rate(path, fps)?;
        program_for(path).map(drop)
    }

    /// Starts a video of 8-bit RGB frames: `.mp4` (H.264, 4:2:0; odd sizes get a black row or
    /// column) or `.gif` (one palette for all frames, which ffmpeg therefore keeps in memory).
    /// `fps` is frames a second, in (0, 1000].
    ///
    /// # Errors
    /// [`FormatError::Io`] around [`NoFfmpeg`] without ffmpeg, [`FormatError::Unsupported`] for
    /// another extension, [`FormatError::Field`] for an unusable size or rate.
    pub fn create(path: &Path, width: u32, height: u32, fps: f64) -> Result<Self, FormatError> {
        let container = Container::of(path)?;
        if ![width, height].iter().all(|s| (1..=16_384).contains(s)) {
            let size = FieldValue::size(width, height);
            return Err(FormatError::field(path, "frame size", size, "not 1 to 16384 a side"));
        }
        container.check_rate(path, fps)?;
        let fail = |e| FormatError::io(path, e);
        let program = program_for(path)?;
        let temporary = TemporaryFile::create(path).map_err(fail)?;
        // Beside the video: the system's folder of temporary files may not be there.
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let log = tempfile::tempfile_in(folder.unwrap_or(Path::new("."))).map_err(fail)?;
        let mut command = Command::new(program);
        command
            .args(arguments(container, width, height, fps))
            // An absolute name cannot be taken for an option or a protocol.
            .arg(std::path::absolute(temporary.path()).map_err(fail)?)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log.try_clone().map_err(fail)?);
        // Ctrl-C reaches every process of a terminal's group; ended by it, ffmpeg would look as if
        // it had failed.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut all = locked(&ENCODERS);
        let mut child = command.spawn().map_err(fail)?;
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take());
        let child = Arc::new(Mutex::new(child));
        all.retain(|e| e.strong_count() > 0);
        all.push(Arc::downgrade(&child));
        drop(all);
        let frame_bytes = 3 * width as usize * height as usize;
        let path = path.to_owned();
        let frames = 0;
        Ok(Self { path, container, frame_bytes, frames, child, stdin, stdout, log, temporary })
    }

    /// Appends a frame: rows from top to bottom, three bytes a pixel.
    ///
    /// # Errors
    /// [`FormatError::Field`] for a frame of another size, [`FormatError::Io`] if ffmpeg stopped.
    pub fn frame(&mut self, rgb: &[u8]) -> Result<(), FormatError> {
        if rgb.len() != self.frame_bytes {
            let why = format!("{} wanted", self.frame_bytes);
            return Err(FormatError::field(&self.path, "bytes of a frame", rgb.len(), why));
        }
        let written = match &mut self.stdin {
            Some(pipe) => pipe.write_all(rgb),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        };
        match written {
            Ok(()) => self.frames += 1,
            Err(_) => return Err(self.complaint()),
        }
        Ok(())
    }

    /// Waits for ffmpeg and gives the file its name.
    ///
    /// # Errors
    /// [`FormatError::Field`] for a video without frames, [`FormatError::Io`] if ffmpeg failed;
    /// nothing is left behind then.
    pub fn finish(mut self) -> Result<(), FormatError> {
        if self.frames == 0 {
            return Err(FormatError::field(&self.path, "frames", 0u32, "a video has one or more"));
        }
        drop(self.stdin.take());
        if let Some(mut stdout) = self.stdout.take() {
            let _ = io::copy(&mut stdout, &mut io::sink());
        }
        // An ffmpeg may close its output and go on: the lock is held for no wait, so that it can be ended.
        let status = loop {
            let ended =
                locked(&self.child).try_wait().map_err(|e| FormatError::io(&self.path, e))?;
            match ended {
                Some(status) => break status,
                None => std::thread::sleep(POLL),
            }
        };
        if !status.success() {
            return Err(self.complaint());
        }
        let mut made =
            File::open(self.temporary.path()).map_err(|e| FormatError::io(&self.path, e))?;
        if made.metadata().map_err(|e| FormatError::io(&self.path, e))?.len() == 0 {
            let why = "ffmpeg ended without an error and wrote nothing";
            return Err(FormatError::io(&self.path, io::Error::other(why)));
        }
        let mut out = AtomicFile::create(&self.path)?;
        let copied = match self.container {
            Container::Mp4 => io::copy(&mut made, &mut out).map(drop),
            Container::Gif => copy_gif(&mut made, &mut out),
        };
        copied.map_err(|e| FormatError::io(&self.path, e))?;
        out.commit()
    }

    fn end(&mut self) {
        drop(self.stdin.take());
        let mut child = locked(&self.child);
        let _ = child.kill();
        let _ = child.wait();
    }

    /// Ends ffmpeg and turns the last line of its log into an error.
    fn complaint(&mut self) -> FormatError {
        self.end();
        let mut text = Vec::new();
        let read = self.log.seek(SeekFrom::Start(0)).and_then(|_| self.log.read_to_end(&mut text));
        let text = String::from_utf8_lossy(&text);
        let last = text.lines().rfind(|l| !l.trim().is_empty()).filter(|_| read.is_ok());
        let last: String = last.unwrap_or("no reason given").chars().take(200).collect();
        FormatError::io(&self.path, io::Error::other(format!("ffmpeg failed: {last}")))
    }
}

impl Drop for VideoWriter {
    fn drop(&mut self) {
        // After `finish` it has ended and this does nothing.
        self.end();
    }
}

/// The first ffmpeg in the search path.
fn program() -> Option<PathBuf> {
    let name = format!("ffmpeg{}", std::env::consts::EXE_SUFFIX);
    std::env::split_paths(&std::env::var_os("PATH")?).map(|d| d.join(&name)).find(|p| p.is_file())
}

/// The ffmpeg that writes the video at `path`.
fn program_for(path: &Path) -> Result<PathBuf, FormatError> {
    let missing = || io::Error::new(io::ErrorKind::Unsupported, NoFfmpeg);
    program().ok_or_else(|| FormatError::io(path, missing()))
}

fn arguments(container: Container, width: u32, height: u32, fps: f64) -> Vec<OsString> {
    let mut list: Vec<String> = Vec::new();
    let mut add = |text: &str| list.extend(text.split(' ').map(str::to_owned));
    add("-hide_banner -loglevel error -y -f rawvideo -pixel_format rgb24");
    add(&format!("-video_size {width}x{height} -framerate {fps} -i pipe:0"));
    match container {
        Container::Mp4 => {
            let even = "pad=ceil(iw/2)*2:ceil(ih/2)*2";
            let exact = "flags=bitexact+accurate_rnd+full_chroma_int";
            add(&format!(
                "-vf {even},scale=out_color_matrix=bt709:out_range=tv:{exact},format=yuv420p"
            ));
            add("-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv");
            // The encoder's result depends on the number of its threads, so it is fixed.
            add("-c:v libx264 -preset medium -crf 18 -threads 4 -movflags +faststart");
        }
        Container::Gif => {
            add("-filter_complex split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=bayer");
            add("-loop 0");
        }
    }
    add("-map_metadata -1 -fflags +bitexact -flags:v +bitexact");
    add(if container == Container::Mp4 { "-f mp4 -metadata" } else { "-f gif -metadata" });
    list.push(format!("comment={NOTICE}"));
    list.into_iter().map(OsString::from).collect()
}

/// Copies a GIF and puts the notice in, for which ffmpeg has no place: as a comment block after
/// the global palette.
fn copy_gif(from: &mut impl Read, to: &mut impl Write) -> io::Result<()> {
    let mut head = [0; 13];
    from.read_exact(&mut head)?;
    to.write_all(&head)?;
    let flags = head[10];
    if flags & 0x80 != 0 {
        io::copy(&mut from.take(3 << ((flags & 7) + 1)), to)?;
    }
    to.write_all(&[0x21, 0xfe, NOTICE.len() as u8])?;
    to.write_all(NOTICE.as_bytes())?;
    to.write_all(&[0])?;
    io::copy(from, to).map(drop)
}
