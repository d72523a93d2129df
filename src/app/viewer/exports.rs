//! Files that the viewer exports: the inside view, the flight, the report.

use std::path::Path;

use super::super::computation::TaskKind;
use super::super::error::AppError;
use super::super::export::{self, Notes};
use super::super::finding;
use super::super::saved_flight::save_flight;
use super::open_case::OpenCase;
use crate::flight::Frames;
use crate::formats::{encode_png, shown};
use crate::session::SessionError;
use crate::vk::Gpu;

/// Says where a file was written. A window shows no working folder: the whole path is named.
pub(super) fn wrote(path: &Path) -> String {
    let whole = std::path::absolute(path);
    format!("wrote {}", shown(whole.as_deref().unwrap_or(path)))
}

impl OpenCase {
    /// The inside view as PNG, where it shows something.
    pub(super) fn inside_png(&self, gpu: &mut Gpu) -> Result<Option<Vec<u8>>, AppError> {
        if !self.panes.has_pictures() {
            return Ok(None);
        }
        let ([width, height], rgb) = self.panes.inside_picture(gpu)?;
        Ok(Some(encode_png(width, height, &rgb)))
    }

    /// Writes the inside view as it is seen: marks, scales and notice included.
    ///
    /// * `scale`: pixels a point of the window.
    pub(super) fn export_view(&mut self, gpu: &mut Gpu, scale: f32) -> Result<(), AppError> {
        if self.panes.has_pictures() {
            let (picture, size) = (self.panes.inside(), self.panes.inside_size());
            let picture = (picture, self.panes.is_inside_fine());
            let rgb = self.marked_view.draw(gpu, &self.model, picture, (size, scale.max(0.5)))?;
            self.write_picture_file("view", size, &rgb);
        }
        Ok(())
    }

    /// Writes a picture of the window, RGB.
    pub(super) fn export_window(&mut self, size: [u32; 2], rgb: &[u8]) {
        self.write_picture_file("window", size, rgb);
    }

    /// Writes a picture, RGB, under a name that no file of the export folder has.
    fn write_picture_file(&mut self, kind: &str, [width, height]: [u32; 2], rgb: &[u8]) {
        let name = export::free_name(&self.options.export, &self.file_stem(kind), "png");
        let png = encode_png(width, height, rgb);
        let written = export::write(&self.options.export, &name, &png);
        self.show_written(written.map(|path| wrote(&path)));
    }

    /// Writes the page of the report, with the notes as they are now, beside those written before.
    pub(super) fn export_report(&mut self) -> Result<(), SessionError> {
        let notes = Notes::of(&self.model, self.beside_notes().map(|f| f.0));
        let (folder, stem) = (self.options.export.clone(), self.file_stem("report"));
        self.spawn(TaskKind::Report, move |session| {
            let page = export::page(session, notes).map_err(AppError::from);
            let name = export::free_name(&folder, &stem, "html");
            let written = page.and_then(|p| export::write(&folder, &name, p.as_bytes()));
            let message = match written {
                Ok(path) => wrote(&path),
                Err(e) => format!("the report is not written: {e}"),
            };
            Box::new(move |model| model.message = Some(message))
        })
    }

    /// Writes the table of the findings, beside those written before.
    pub(super) fn export_findings(&mut self) {
        let (folder, stem) = (&self.options.export, self.file_stem("findings"));
        let name = export::free_name(folder, &stem, "csv");
        let table = finding::table(&self.model);
        let written = export::write(folder, &name, table.as_bytes());
        self.show_written(written.map(|path| wrote(&path)));
    }

    /// Draws the flight that is shown, its branch and its gazes included, into a new folder of the export
    /// folder. If ffmpeg is installed, a video is written too. One flight at a time.
    pub(super) fn export_flight(&mut self) -> Result<(), SessionError> {
        let Frames::Speed { fps, .. } = self.options.settings.flight.frames else { return Ok(()) };
        if self.is_saving() {
            return Ok(());
        }
        let (folder, stem) = (self.options.export.clone(), self.file_stem("flight"));
        self.model.message = None;
        let flight = self.model.flown_flight();
        self.spawn(TaskKind::SavedFlight, move |session| {
            let saved = save_flight(session, (&folder, &stem), flight, fps);
            let message = saved.unwrap_or_else(|e| match e {
                SessionError::Cancelled => "saving was stopped; no frame is left".into(),
                e => format!("the flight is not written: {e}"),
            });
            Box::new(move |model| model.message = Some(message))
        })
    }

    /// Shows what became of a file that was to be written.
    pub(super) fn show_written(&mut self, written: Result<String, AppError>) {
        self.model.message = Some(written.unwrap_or_else(|e| {
            tracing::error!("{e}");
            e.to_string()
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_file_is_named_with_its_folder() {
        let here = std::env::current_dir().unwrap();
        let whole = here.join("intima-export").join("view-1.png");
        let said = wrote(Path::new("intima-export/view-1.png"));
        assert_eq!(said, format!("wrote {}", shown(&whole)));
    }
}
