//! Products, frames and report written to a folder.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::folder_lock::FolderLocks;
use super::writer::{FrameWriter, Stamp, clear_folder};
use super::{
    FlightRoute, FrameStream, Product, Report, ReportPictures, Session, SessionError, locked,
    written_mesh,
};
use crate::flight::{CameraPath, Flight};
use crate::formats::{
    FormatError, atomic_file, to_pretty_json, write_branches, write_centerline, write_layers,
    write_wall,
};
use crate::geometry::Mesh;
use crate::lumen::Lumen;

/// Name of the report in a folder.
pub const REPORT_FILE: &str = "report.json";

/// Name of the report as a page of HTML.
pub const PAGE_FILE: &str = "report.html";

/// Name of the simplified wall in a folder.
const BASE_FILE: &str = "base.ply";

/// Names of all files of a run in its folder; frames have a folder of their own.
pub const RUN_FILES: [&str; 11] = [
    REPORT_FILE,
    PAGE_FILE,
    "mask.nrrd",
    "distance.nrrd",
    "surface.ply",
    BASE_FILE,
    "centerline.vtp",
    "centerline.csv",
    "centerline.mrk.json",
    "branches.vtp",
    "unseen.csv",
];

/// Files of a recorded flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Folder of the frames; made if it is not there, and rid of the frames of an earlier flight.
    pub frames: PathBuf,
    /// File of the video, and its frames a second.
    pub video: Option<(PathBuf, f64)>,
    /// Flight that is drawn instead of the session's, and the route that it follows.
    pub flight: Option<(FlightRoute, Arc<Flight>)>,
    /// Text over each frame.
    pub stamp: Option<Stamp>,
    /// File of the camera path.
    pub camera_path: Option<PathBuf>,
    /// Whether pictures are kept and drawn for the page of the report.
    pub pictures: bool,
    /// Whether the simplified wall is made and written.
    pub base: bool,
    /// Whether a run drops products that it needs no more. They are made anew for who asks later.
    pub release_products: bool,
}

/// A run whose files are written, save its report.
pub struct RunOutcome {
    /// The report.
    pub report: Report,
    /// The frames, all drawn.
    pub stream: FrameStream,
    /// Pictures for the page of the report, where they were asked for.
    pub pictures: Option<ReportPictures>,
}

impl Session {
    /// Computes what frames need and draws all of them, writing nothing: what `--repeat` times.
    ///
    /// # Errors
    /// What the stages and the drawing fail with.
    pub fn draw_all(&self) -> Result<FrameStream, SessionError> {
        let mut stream = self.frames()?;
        let spares = stream.spares();
        self.progress.begin_frames(stream.count());
        let outcome = loop {
            match self.next_frame(&mut stream, &None) {
                Ok(Some(frame)) => {
                    self.progress.frames(frame.index + 1);
                    spares.give(frame.rgb);
                }
                Ok(None) => break Ok(()),
                Err(e) => break Err(e),
            }
        };
        self.progress.end_frames();
        outcome?;
        self.record_frames(&mut self.clock(), &stream);
        Ok(stream)
    }

    /// Computes everything that [`Session::run_to_folder`] writes and draws all frames, writing
    /// nothing.
    ///
    /// # Errors
    /// What the stages and the drawing fail with.
    pub fn compute_all(&self) -> Result<FrameStream, SessionError> {
        self.expect(&self.products_of_folder(false));
        self.prepare(&self.products_of_recording())?;
        let needs = [Product::Coverage, Product::LumenProfile];
        let products = || self.prepare(&needs);
        if self.pool.current_num_threads() == 1 {
            products()?;
            return self.draw_all();
        }
        std::thread::scope(|scope| {
            let products = scope.spawn(products);
            let stream = self.draw_all();
            let products = products.join();
            let products = products.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            stream.and_then(|stream| products.map(|()| stream))
        })
    }

    /// Draws all frames and writes them.
    ///
    /// # Errors
    /// What the stages, the drawing and the writing fail with; [`SessionError::FolderInUse`].
    pub fn record(&self, to: &Recording) -> Result<FrameStream, SessionError> {
        // Before anything is computed, and again once it was made.
        let mut locks = FolderLocks::default();
        locks.claim(&to.frames)?;
        self.progress.begin_work();
        self.prepare(&self.products_of_recording())?;
        self.write_camera_path(to, &to.frames)?;
        make_folder(&to.frames)?;
        locks.claim(&to.frames)?;
        clear_folder(&to.frames)?;
        self.draw_to_files(to)
    }

    /// The first thing written: where it fails, no folder was made, save that of the run where the
    /// path belongs in it.
    fn write_camera_path(&self, to: &Recording, folder: &Path) -> Result<(), SessionError> {
        let Some(path) = &to.camera_path else { return Ok(()) };
        let whole = |p: &Path| std::path::absolute(p).map_err(|e| FormatError::io(p, e));
        if let Some(parent) = whole(path)?.parent().filter(|p| !p.exists())
            && parent.starts_with(whole(folder)?)
        {
            std::fs::create_dir_all(parent).map_err(|e| FormatError::io(parent, e))?;
        }
        let json = CameraPath::from(&*self.flight()?).to_json();
        Ok(atomic_file::write_atomic(path, |o| o.write_all(json.as_bytes()))?)
    }

    fn draw_to_files(&self, to: &Recording) -> Result<FrameStream, SessionError> {
        let mut stream = self.frames_along(to.flight.clone())?;
        let video = to.video.as_ref().map(|(path, fps)| (path.as_path(), *fps));
        let threads = self.pool.current_num_threads();
        let size = self.settings.flight.size;
        let mut writer = FrameWriter::new(&to.frames, size, threads, &stream.spares(), video)?;
        self.progress.begin_frames(stream.count());
        let outcome = loop {
            match self.next_frame(&mut stream, &to.flight) {
                Ok(None) => break Ok(()),
                Ok(Some(mut frame)) => {
                    to.stamp.iter().for_each(|stamp| stamp.mark(frame.size, &mut frame.rgb));
                    self.progress.frames(frame.index + 1);
                    if to.pictures {
                        let count = stream.count();
                        stream.kept.offer(&frame, count);
                    }
                    if let Err(e) = writer.write(frame) {
                        break Err(e);
                    }
                }
                Err(e) => break Err(e),
            }
        };
        self.progress.end_frames();
        outcome?;
        writer.finish()?;
        self.record_frames(&mut self.clock(), &stream);
        Ok(stream)
    }

    /// Everything into one folder: products, frames, and the report last, so that where there is a
    /// report all is there and of one run. Products are computed and written beside the drawing.
    ///
    /// Nobody else writes a run into the folder until [`Session::write_report`] or the end of this
    /// session.
    ///
    /// # Errors
    /// What the stages, the drawing and the writing fail with; [`SessionError::FolderInUse`].
    pub fn run_to_folder(
        &self,
        folder: &Path,
        recording: &Recording,
    ) -> Result<RunOutcome, SessionError> {
        let outcome = self.fill_folder(folder, recording);
        if outcome.is_err() {
            self.release_folders();
        }
        outcome
    }

    fn release_folders(&self) {
        *locked(&self.folders) = FolderLocks::default();
    }

    fn fill_folder(
        &self,
        folder: &Path,
        recording: &Recording,
    ) -> Result<RunOutcome, SessionError> {
        let folders: [&Path; 2] = [folder, &recording.frames];
        // Before anything is computed, and again once they were made.
        folders.iter().try_for_each(|f| locked(&self.folders).claim(f))?;
        self.expect(&self.products_of_folder(recording.base));
        self.prepare(&self.products_of_recording())?;
        self.write_camera_path(recording, folder)?;
        for folder in folders {
            make_folder(folder)?;
            locked(&self.folders).claim(folder)?;
        }
        remove_file(&folder.join(REPORT_FILE))?;
        remove_file(&folder.join(PAGE_FILE))?;
        remove_file(&folder.join(BASE_FILE))?;
        clear_folder(&recording.frames)?;
        let mut stream = if self.pool.current_num_threads() == 1 {
            let stream = self.draw_to_files(recording)?;
            self.write_products(folder, recording)?;
            stream
        } else {
            std::thread::scope(|scope| {
                let products = scope.spawn(|| self.write_products(folder, recording));
                let stream = self.draw_to_files(recording);
                let products = products.join();
                let products = products.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                stream.and_then(|stream| products.map(|()| stream))
            })?
        };
        if recording.release_products {
            stream.end();
            self.release(&[Product::TriangleTree, Product::Exterior, Product::Levels]);
        }
        let pictures =
            recording.pictures.then(|| self.report_pictures(Some(&mut stream))).transpose()?;
        Ok(RunOutcome { report: self.report(Some(&stream))?, stream, pictures })
    }

    /// Writes the report of a run, which ends it.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write_report(&self, folder: &Path, report: &Report) -> Result<(), SessionError> {
        let text = to_pretty_json(report).map_err(|e| SessionError::System(e.to_string()))?;
        let path = folder.join(REPORT_FILE);
        atomic_file::write_atomic(&path, |o| o.write_all(text.as_bytes()))?;
        self.release_folders();
        Ok(())
    }

    /// Products that a recorded flight needs before its first frame. The hash of the volume is among
    /// them, though only the report shows it: nothing else keeps the volume in memory by then.
    fn products_of_recording(&self) -> Vec<Product> {
        let mut products = self.products_of_frames();
        products.push(Product::Inputs);
        products
    }

    /// Products that a folder holds beside frames.
    fn products_of_folder(&self, with_base: bool) -> Vec<Product> {
        let mut products = vec![Product::Coverage, Product::LumenProfile];
        products.extend(with_base.then_some(Product::Base));
        products
    }

    /// Computes and writes everything that is no picture: what is there already while the rest is
    /// computed.
    fn write_products(&self, folder: &Path, recording: &Recording) -> Result<(), SessionError> {
        let needs = self.products_of_folder(recording.base);
        let write = || {
            let mut clock = self.clock().fork();
            let written =
                clock.time("write", "files", || self.write_files(folder, recording), |_| 7);
            self.clock().merge(clock);
            written
        };
        if self.pool.current_num_threads() == 1 {
            self.prepare(&needs)?;
            write()?;
        } else {
            std::thread::scope(|scope| {
                let written = scope.spawn(write);
                let computed = self.prepare(&needs);
                let written = written.join();
                computed.and(written.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            })?;
        }
        if recording.base {
            self.write_mesh(&folder.join(BASE_FILE), &*self.base()?)?;
        }
        let mut clock = self.clock().fork();
        let written = clock.time(
            "write",
            "files",
            || {
                let csv = self.unseen_csv()?;
                let path = folder.join("unseen.csv");
                Ok(atomic_file::write_atomic(&path, |o| o.write_all(csv.as_bytes()))?)
            },
            |_| 1,
        );
        self.clock().merge(clock);
        written
    }

    fn write_mesh(&self, path: &Path, mesh: &Mesh) -> Result<(), SessionError> {
        let mesh = written_mesh(mesh, self.settings.wall.open_ends);
        Ok(write_wall(path, &mesh, self.settings.wall.facing)?)
    }

    /// Writes what a flight needs too. The distance comes first: nothing else keeps it in memory.
    fn write_files(&self, out: &Path, recording: &Recording) -> Result<(), SessionError> {
        let segmented = self.lumen()?;
        let lumen: &Lumen = &segmented.lumen;
        let grid = &lumen.stored_grid();
        let fields = self.fields()?;
        write_layers(&out.join("distance.nrrd"), grid, |put| {
            lumen.each_layer(&fields.distance, 0.0, put)
        })?;
        drop(fields);
        if recording.release_products {
            self.release(&[Product::Fields, Product::Distance]);
        }
        let classes = lumen.class_field();
        write_layers(&out.join("mask.nrrd"), grid, |put| lumen.each_layer(&classes, 0, put))?;
        drop(classes);
        let (wall, centered) = (self.wall()?, self.centerline()?);
        self.write_mesh(&out.join("surface.ply"), &wall.mesh)?;
        for name in ["centerline.vtp", "centerline.csv", "centerline.mrk.json"] {
            write_centerline(&out.join(name), &centered.line)?;
        }
        Ok(write_branches(&out.join("branches.vtp"), &centered.line)?)
    }
}

fn make_folder(folder: &Path) -> Result<(), FormatError> {
    std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))
}

fn remove_file(path: &Path) -> Result<(), FormatError> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(FormatError::io(path, e)),
        _ => Ok(()),
    }
}
