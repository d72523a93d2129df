//! Frames of a flight, one by one.

use std::sync::{Arc, Mutex, PoisonError};

use intima::formats::VideoWriter;
use intima::session::{FrameStream, SessionError};
use intima::task::CancelToken;
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;

use crate::call::call;
use crate::session::Process;

/// An iterator over the frames of a flight: arrays of (height, width, 3), 8 bits each of red, green
/// and blue.
#[pyclass(frozen, module = "intima._intima")]
pub struct Frames {
    stream: Arc<Mutex<FrameStream>>,
    cancel: CancelToken,
    process: Process,
    count: usize,
}

impl Frames {
    /// Frames that are drawn as they are asked for.
    pub fn new(stream: FrameStream, cancel: CancelToken, process: Process) -> Self {
        let count = stream.count();
        Self { stream: Arc::new(Mutex::new(stream)), cancel, process, count }
    }
}

#[pymethods]
impl Frames {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    /// Number of frames of the whole flight.
    fn __len__(&self) -> usize {
        self.count
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.process.check()?;
        let next = || {
            let mut stream = self.stream.lock().unwrap_or_else(PoisonError::into_inner);
            stream.next_frame()
        };
        let Some(frame) = call(py, &self.cancel, next)? else { return Ok(None) };
        let [width, height] = frame.size.map(|n| n as usize);
        Ok(Some(frame.rgb.into_pyarray(py).reshape([height, width, 3])?.into_any()))
    }
}

/// Draws all frames into a video; their number.
pub fn write_video(
    mut stream: FrameStream,
    path: &std::path::Path,
    fps: f64,
) -> Result<usize, SessionError> {
    let spares = stream.spares();
    let mut video: Option<VideoWriter> = None;
    while let Some(frame) = stream.next_frame()? {
        let video = match &mut video {
            Some(video) => video,
            None => {
                let [width, height] = frame.size;
                video.insert(VideoWriter::create(path, width, height, fps)?)
            }
        };
        video.frame(&frame.rgb)?;
        spares.give(frame.rgb);
    }
    if let Some(video) = video {
        video.finish()?;
    }
    Ok(stream.count())
}
