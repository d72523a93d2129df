//! Notes of the viewer and their file: read once the volume is known, saved as they are made, asked
//! about before they are lost.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::action::Request;
use super::super::error::AppError;
use super::super::export;
use super::super::opening::{Opening, SavedLumen};
use super::super::panes::Detail;
use super::super::session_file::SessionFile;
use super::Viewer;
use super::exports::wrote;
use crate::session::Product;
use crate::vk::Gpu;

impl Viewer {
    /// Sets the model as the session file says, once the volume is known.
    ///
    /// # Errors
    /// [`AppError::SessionFile`] if it is of another volume.
    pub fn apply_notes(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let Some(identity) = self.model.products.identity.clone() else { return Ok(()) };
        let Some(notes) = &self.notes else { return Ok(()) };
        if self.is_lumen_to_restore() && notes.input == *identity {
            let request = notes.lumen.as_ref().expect("it is to be restored").request();
            let session = self.computation.as_ref().map(|c| &*c.session);
            let opening = Opening::of(&request, session, &self.options.settings, false);
            // The rest follows when the volume is known again.
            return opening.map_or(Ok(()), |opening| self.open(gpu, opening));
        }
        let notes = self.notes.take().expect("there are some");
        notes.apply(&mut self.model).map_err(|what| {
            // It is not overwritten.
            let path = self.options.session_file.take().unwrap_or_default();
            AppError::SessionFile { path, what }
        })?;
        self.model.notes_saved();
        Ok(self.restore_branch()?)
    }

    /// Whether the session file says which lumen there is, and nothing else does.
    pub(super) fn is_lumen_to_restore(&self) -> bool {
        self.is_lumen_open() && self.notes.as_ref().is_some_and(|notes| notes.lumen.is_some())
    }

    /// Takes the lumen of the session file, where frames wait for products.
    pub(super) fn restore_lumen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        if let Some(computation) = self.computation.as_ref().filter(|_| self.is_lumen_to_restore())
        {
            const KNOWN: [Product; 3] = [Product::Volume, Product::ValueRange, Product::Identity];
            computation.session.prepare(&KNOWN)?;
            self.show(gpu, &KNOWN)?;
            self.apply_notes(gpu)?;
        }
        Ok(())
    }

    /// Opens a session file of the volume that is open; what is wrong with it is a message.
    pub(super) fn open_session(&mut self, gpu: &mut Gpu, path: &Path) -> Result<(), AppError> {
        let of_other = |file: &SessionFile| {
            let identity = self.model.products.identity.as_deref();
            identity.is_some_and(|identity| *identity != file.input)
        };
        let read = SessionFile::read(path).and_then(|file| {
            match () {
                () if self.computation.is_none() => Err("open the volume of the session first"),
                () if of_other(&file) => Err("the session file is of another volume"),
                () => Ok(file),
            }
            .map_err(|what| AppError::SessionFile { path: path.to_owned(), what: what.into() })
        });
        match read {
            Ok(file) => {
                (self.notes, self.options.session_file) = (Some(file), Some(path.to_owned()));
                self.apply_notes(gpu)
            }
            Err(e) => {
                self.show_written(Err(e));
                Ok(())
            }
        }
    }

    /// Whether a request waits for an answer, because notes or a flight would be lost. Asked for again, it is
    /// carried out.
    pub fn holds_back(&mut self, request: &Request) -> bool {
        let leaves = matches!(
            request,
            Request::Quit
                | Request::Open(_)
                | Request::OpenSession(_)
                | Request::Series(_)
                | Request::Segment(_)
        );
        let loses_notes = self.model.has_unsaved_notes() && self.options.session_file.is_none();
        let loses_flight = self.is_saving() && !matches!(request, Request::OpenSession(_));
        let loses = leaves && (loses_notes || loses_flight);
        // Nobody answers a script.
        if !loses || self.detail == Detail::Settled || self.model.leaving.as_ref() == Some(request)
        {
            return false;
        }
        if loses_notes {
            tracing::info!("bookmarks are in no file yet");
        }
        if loses_flight {
            tracing::info!("a flight is being saved");
        }
        self.model.leaving = Some(request.clone());
        self.model.leaves_flight = loses_flight;
        true
    }

    /// Saves notes, with their pictures, to a file from now on; whether they are saved.
    pub(super) fn save_as(&mut self, path: PathBuf) -> bool {
        self.options.session_file = Some(path);
        for i in 0..self.model.bookmarks.len() {
            let bookmark = &self.model.bookmarks[i];
            if let (Some(png), None) = (bookmark.png.clone(), &bookmark.picture) {
                self.model.bookmarks[i].picture = self.write_picture(&png);
            }
        }
        let saved = self.save_session();
        let is_saved = saved.is_ok();
        let path = self.options.session_file.clone().unwrap_or_default();
        self.show_written(saved.map(|()| wrote(&path)));
        is_saved
    }

    /// Folder and stem of the pictures of bookmarks.
    pub(super) fn beside_session_file(&self) -> Option<(&Path, &str)> {
        let file = self.options.session_file.as_deref()?;
        Some((file.parent()?, file.file_stem()?.to_str()?))
    }

    /// Keeps the inside view as the picture of the bookmark made last, beside the session file.
    pub(super) fn picture_bookmark(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let Some(png) = self.inside_png(gpu)? else { return Ok(()) };
        let picture = self.write_picture(&png);
        if let Some(b) = self.model.bookmarks.last_mut() {
            (b.picture, b.png) = (picture, Some(Arc::new(png)));
        }
        Ok(())
    }

    /// Writes the picture of a bookmark beside the session file, if there is one; its name.
    pub(super) fn write_picture(&mut self, png: &[u8]) -> Option<String> {
        let (folder, stem) = self.beside_session_file()?;
        let name = export::free_name(folder, &format!("{stem}-bookmark"));
        let written = export::write(folder, &name, png);
        written.map_err(|e| self.show_written(Err(e))).ok().map(|_| name)
    }

    /// Whether notes wait to be saved.
    pub fn has_unsaved_notes(&self) -> bool {
        self.options.session_file.is_some() && self.model.has_unsaved_notes()
    }

    /// Saves notes that were changed.
    ///
    /// # Errors
    /// [`AppError::Format`]; then they are still to be saved.
    pub fn save_notes(&mut self) -> Result<(), AppError> {
        if self.model.has_unsaved_notes() { self.save_session() } else { Ok(()) }
    }

    /// Saves notes, how the window is set, and the place on the path. Where no volume came to be
    /// known, the file stays as it is.
    ///
    /// # Errors
    /// As [`Viewer::save_notes`].
    pub fn save_session(&mut self) -> Result<(), AppError> {
        if let (Some(path), Some(file)) = (&self.options.session_file, SessionFile::of(&self.model))
            && self.notes.is_none()
        {
            let lumen = SavedLumen::of(&self.options.settings.lumen);
            SessionFile { lumen, ..file }.write(path)?;
            self.model.notes_saved();
        }
        Ok(())
    }
}
