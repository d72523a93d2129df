//! Notes of the viewer and their files: read once the volume is known, saved and kept as they are made,
//! asked about before they are left.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::super::action::Request;
use super::super::error::AppError;
use super::super::export;
use super::super::kept_notes::{KeptNotes, KeptOffer};
use super::super::model::Bookmark;
use super::super::opening::{Opening, SavedEnds, SavedLumen};
use super::super::panes::Detail;
use super::super::saved_case::SavedCase;
use super::super::session_file::{AddedNotes, NotesFile, SessionFile};
use super::exports::wrote;
use super::open_case::OpenCase;
use crate::session::Product;
use crate::vk::Gpu;

/// Least time between two times that the place of the eye alone is kept.
const KEEP_PLACE: Duration = Duration::from_secs(2);

/// Longest time that a drag keeps its notes from being saved.
const GESTURE: Duration = Duration::from_millis(500);

/// Notes of the viewer as files.
#[derive(Default)]
pub(super) struct Files {
    /// The user's file.
    pub own: Option<NotesFile>,
    /// Notes of the session file, until the volume is known.
    pub waiting: Option<SessionFile>,
    /// Folder of the notes that are kept.
    pub store: KeptNotes,
    /// Kept file of the volume, once that is known.
    kept: Option<NotesFile>,
    /// What the kept file has, and when it was written.
    is_kept: Option<(KeptState, Instant)>,
    /// Kept notes that nobody has taken or left yet: they are kept beside newer ones.
    offered: AddedNotes,
}

/// What tells a state of the window from another one that is kept.
#[derive(Clone, PartialEq)]
struct KeptState {
    /// Number of changes of the notes.
    version: u64,
    /// Millimetres along the path, as bits.
    place: u64,
    lumen: Option<SavedLumen>,
    ends: SavedEnds,
}

impl Files {
    /// * `own`: the user's file.
    /// * `waiting`: what it holds.
    pub fn new(own: Option<NotesFile>, waiting: Option<SessionFile>, store: KeptNotes) -> Self {
        Self { own, waiting, store, ..Self::default() }
    }

    /// Forgets what is of one volume.
    pub fn close_volume(&mut self) {
        *self = Self { store: std::mem::take(&mut self.store), ..Self::default() };
    }
}

impl OpenCase {
    /// Sets the model as the session file says, once the volume is known, and looks for kept notes.
    ///
    /// # Errors
    /// [`AppError::SessionFile`] if it is of another volume.
    pub fn apply_notes(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let Some(identity) = self.model.products.identity.clone() else { return Ok(()) };
        let Some(notes) = &self.files.waiting else {
            self.look_for_kept_notes(&identity);
            return Ok(());
        };
        let waits = self.is_lumen_to_restore() || self.are_ends_to_restore();
        if waits && notes.input == *identity {
            let session = self.computation.as_ref().map(|c| &*c.session);
            let settings = &self.options.settings;
            let mut opening = match notes.lumen.as_ref().filter(|_| self.is_lumen_to_restore()) {
                Some(saved) => Opening::of_saved(saved, session, settings),
                None => Opening { source: None, settings: settings.clone(), is_same_volume: true },
            };
            notes.ends.put_into(&mut opening.settings.centerline);
            // The rest follows when the volume is known again.
            return self.open(gpu, opening);
        }
        let notes = self.files.waiting.take().expect("there are some");
        notes.apply(&mut self.model).map_err(|what| {
            // It is not overwritten.
            let path = self.files.own.take().map(|file| file.path).unwrap_or_default();
            AppError::SessionFile { path, what }
        })?;
        self.model.notes_saved();
        self.look_for_kept_notes(&identity);
        Ok(self.restore_branch()?)
    }

    /// Finds what was kept of this volume; notes that the window does not show are offered.
    fn look_for_kept_notes(&mut self, identity: &str) {
        let is_of = |kept: &NotesFile| kept.path.file_stem().is_some_and(|name| name == identity);
        if self.files.kept.as_ref().is_some_and(is_of) {
            return;
        }
        (self.files.is_kept, self.files.offered) = Default::default();
        let Some(path) = self.files.store.file(identity) else { return };
        let there = path.exists().then(|| SessionFile::read(&path));
        let known = there.and_then(|read| match read {
            Ok(file) if file.input == identity => Some(file),
            _ => {
                let aside = KeptNotes::set_aside(&path);
                tracing::error!("kept notes cannot be read; set aside: {aside:?}");
                None
            }
        });
        if let (Some(file), Some(own)) = (&known, SessionFile::of(&self.model)) {
            self.files.offered = own.lacks(file, None);
            self.model.kept_offer = KeptOffer::of(&self.files.offered, &path);
        }
        self.files.kept = Some(NotesFile::new(path, known));
    }

    /// Takes the kept notes that are offered, with their pictures.
    pub(super) fn take_kept_notes(&mut self) {
        let mut offered = std::mem::take(&mut self.files.offered);
        self.model.kept_offer = None;
        let folder = self.files.kept.as_ref().and_then(|kept| kept.path.parent());
        for b in &mut offered.bookmarks {
            b.png = export::picture(b, folder).map(|picture| Arc::new(picture.png));
        }
        let mut pictures: Vec<_> = offered.bookmarks.iter().map(|b| b.picture.clone()).collect();
        if self.files.own.is_some() {
            for (b, name) in offered.bookmarks.iter().zip(&mut pictures) {
                *name = b.png.clone().and_then(|png| self.write_picture(&png));
            }
        }
        for (b, name) in offered.bookmarks.iter_mut().zip(pictures) {
            b.picture = name;
        }
        self.model.add_notes(&offered);
    }

    /// Leaves the kept notes that are offered: their file is set aside, not removed.
    pub(super) fn leave_kept_notes(&mut self) {
        self.files.offered = AddedNotes::default();
        self.model.kept_offer = None;
        if let Some(kept) = &mut self.files.kept {
            let path = kept.path.clone();
            if let Err(e) = KeptNotes::set_aside(&path) {
                tracing::error!("kept notes are not set aside: {e}");
                return;
            }
            *kept = NotesFile::new(path, None);
            self.files.is_kept = None;
        }
    }

    /// Whether the session file says which lumen there is, and nothing else does.
    pub(super) fn is_lumen_to_restore(&self) -> bool {
        let waiting = self.files.waiting.as_ref();
        self.is_lumen_open() && waiting.is_some_and(|notes| notes.lumen.is_some())
    }

    /// Whether the session file says where the path ends, of the lumen that there is, and nothing else
    /// does.
    fn are_ends_to_restore(&self) -> bool {
        let (c, lumen) = (&self.options.settings.centerline, &self.options.settings.lumen);
        let is_of_lumen =
            |notes: &SessionFile| !notes.ends.is_none() && notes.lumen == SavedLumen::of(lumen);
        let is_open = c.from.is_none() && c.to.is_none();
        is_open && self.files.waiting.as_ref().is_some_and(is_of_lumen)
    }

    /// Takes the lumen of the session file, where frames wait for products.
    pub(super) fn restore_lumen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let waits = self.is_lumen_to_restore() || self.are_ends_to_restore();
        if let Some(computation) = self.computation.as_ref().filter(|_| waits) {
            const KNOWN: [Product; 3] = [Product::Volume, Product::ValueRange, Product::Identity];
            computation.session.prepare(&KNOWN)?;
            self.show(gpu, &KNOWN)?;
            self.apply_notes(gpu)?;
        }
        Ok(())
    }

    /// Opens a session file, with its volume unless that is open; what is wrong with it is a message.
    ///
    /// * `is_users`: notes are saved to it from now on.
    pub(super) fn open_session(
        &mut self,
        gpu: &mut Gpu,
        path: &Path,
        is_users: bool,
    ) -> Result<(), AppError> {
        let wrong = |what| AppError::SessionFile { path: path.to_owned(), what };
        let read = SessionFile::read(path).and_then(|file| {
            let identity = self.model.products.identity.as_deref();
            let is_open = identity.is_some_and(|identity| *identity == file.input);
            let source = match (&file.case, is_open) {
                (_, true) => None,
                (Some(case), false) => {
                    let folder = path.parent().unwrap_or(Path::new(""));
                    Some(case.source(folder).map_err(wrong)?)
                }
                (None, false) if self.computation.is_none() => {
                    return Err(wrong("open the volume of the session first".into()));
                }
                (None, false) => {
                    return Err(wrong("the session file is of another volume".into()));
                }
            };
            Ok((file, source))
        });
        let (file, source) = match read {
            Ok(read) => read,
            Err(e) => {
                self.show_written(Err(e));
                return Ok(());
            }
        };
        let own = is_users.then(|| NotesFile::new(path.to_owned(), Some(file.clone())));
        match source {
            Some(source) => {
                self.leave_volume();
                (self.files.own, self.files.waiting) = (own, Some(file));
                let opening = Opening::of_case(source, &self.options.settings);
                self.open(gpu, opening)
            }
            None if !is_users => {
                self.model.message = Some("this scan is open already".into());
                Ok(())
            }
            None => {
                // What is noted now is kept, and offered beside the notes of the file.
                self.leave_volume();
                let lumen = file.lumen.clone();
                (self.files.own, self.files.waiting) = (own, Some(file));
                let settings = &self.options.settings;
                match lumen.filter(|lumen| SavedLumen::of(&settings.lumen).as_ref() != Some(lumen))
                {
                    Some(lumen) if !self.is_lumen_open() => {
                        let session = self.computation.as_ref().map(|c| &*c.session);
                        let opening = Opening::of_saved(&lumen, session, settings);
                        self.open(gpu, opening)
                    }
                    _ => self.apply_notes(gpu),
                }
            }
        }
    }

    /// Keeps the notes of the volume, before another one is opened.
    pub(super) fn leave_volume(&mut self) {
        if let Err(e) = self.keep_notes(true) {
            tracing::error!("notes are not kept: {e}");
        }
        self.files.close_volume();
    }

    /// Whether a request waits for an answer, because notes are in no file of the user's or a flight
    /// would be lost. Asked for again, it waits on.
    pub fn holds_back(&mut self, request: &Request) -> bool {
        let leaves = request.leaves_volume();
        if leaves && self.files.own.is_some() && self.model.has_unsaved_notes() {
            let saved = self.save_session();
            saved.err().iter().for_each(|e| tracing::error!("bookmarks are not saved: {e}"));
        }
        let version = Some(self.model.notes_version());
        let is_answered = *request == Request::Quit && self.left_unsaved == version;
        let leaves_notes = leaves && self.model.has_unsaved_notes() && !is_answered;
        let loses_flight = request.ends_saving() && self.is_saving() && !is_answered;
        // Nobody answers a script.
        if !(leaves_notes || loses_flight) || self.detail == Detail::Settled {
            return false;
        }
        if leaves_notes {
            tracing::info!("bookmarks are in no file of the user's yet");
        }
        if loses_flight {
            tracing::info!("a flight is being saved");
        }
        self.model.are_notes_kept = self.is_kept();
        self.model.leaving = Some(request.clone());
        (self.model.leaves_notes, self.model.leaves_flight) = (leaves_notes, loses_flight);
        true
    }

    /// Saves notes, with their pictures, to a file from now on; whether they are saved.
    pub(super) fn save_as(&mut self, path: PathBuf) -> bool {
        let folder = self.beside_notes().map(|(folder, _)| folder.to_owned());
        let own = self.files.own.replace(NotesFile::replacing(path.clone()));
        let names: Vec<_> = self.model.bookmarks.iter().map(|b| b.picture.clone()).collect();
        for i in 0..names.len() {
            let picture = export::picture(&self.model.bookmarks[i], folder.as_deref());
            if let Some(picture) = picture {
                self.model.bookmarks[i].picture = self.write_picture(&picture.png);
            }
        }
        let saved = self.save_session();
        let is_saved = saved.is_ok();
        if !is_saved {
            // The file before goes on being the one.
            self.files.own = own;
            for (b, name) in self.model.bookmarks.iter_mut().zip(names) {
                b.picture = name;
            }
        }
        self.show_written(saved.map(|()| wrote(&path)));
        is_saved
    }

    /// Folder and stem of the pictures of bookmarks: of the user's file, or else of the kept one.
    pub(super) fn beside_notes(&self) -> Option<(&Path, &str)> {
        let file = &self.files.own.as_ref().or(self.files.kept.as_ref())?.path;
        Some((file.parent()?, file.file_stem()?.to_str()?))
    }

    /// Keeps the inside view as the picture of the bookmark made last, beside the notes.
    pub(super) fn picture_bookmark(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let has_picture = |b: &Bookmark| b.png.is_some() || b.picture.is_some();
        if self.model.bookmarks.last().is_none_or(has_picture) {
            return Ok(());
        }
        let Some(png) = self.inside_png(gpu)? else { return Ok(()) };
        let picture = self.write_picture(&png);
        if let Some(b) = self.model.bookmarks.last_mut() {
            (b.picture, b.png) = (picture, Some(Arc::new(png)));
        }
        Ok(())
    }

    /// Writes the picture of a bookmark beside the notes, if they have a file; its name.
    pub(super) fn write_picture(&mut self, png: &[u8]) -> Option<String> {
        let (folder, stem) = self.beside_notes()?;
        let name = export::free_name(folder, &format!("{stem}-bookmark"), "png");
        let written = export::write(folder, &name, png);
        written.map_err(|e| self.show_written(Err(e))).ok().map(|_| name)
    }

    /// Whether notes wait to be saved or kept.
    pub fn has_unsaved_notes(&self) -> bool {
        let is_unsaved = self.files.own.is_some() && self.model.has_unsaved_notes();
        let state = self.state_to_keep();
        let is_kept = self.files.is_kept.as_ref().is_some_and(|(kept, _)| *kept == state);
        is_unsaved || (self.files.kept.is_some() && !is_kept)
    }

    /// Saves and keeps notes that were changed.
    ///
    /// # Errors
    /// [`AppError::Format`]; then they are still to be saved.
    pub fn save_notes(&mut self) -> Result<(), AppError> {
        // Not in each frame of a drag.
        let written = self.files.is_kept.as_ref().map(|(_, when)| when.elapsed());
        if self.model.is_in_gesture() && written.is_some_and(|since| since < GESTURE) {
            return Ok(());
        }
        let kept = self.keep_notes(false);
        if self.model.has_unsaved_notes() {
            self.save_session()?;
        }
        self.model.notes_are = self.where_notes_are();
        kept
    }

    /// Says where the notes are, if there are some.
    fn where_notes_are(&self) -> &'static str {
        let count = self.model.bookmarks.len() + self.model.measurements.len();
        let is_saved = self.files.own.is_some() && !self.model.has_unsaved_notes();
        match (count, is_saved) {
            (0, _) => "",
            (_, true) => "notes saved",
            (_, false) if self.is_kept() => "notes kept",
            (_, false) => "notes not saved",
        }
    }

    /// Saves notes, how the window is set, and the place on the path, in the user's file. Where no volume
    /// came to be known, the file stays as it is.
    ///
    /// # Errors
    /// As [`OpenCase::save_notes`].
    pub fn save_session(&mut self) -> Result<(), AppError> {
        let folder = self.files.own.as_ref().and_then(|own| own.path.parent());
        let Some(file) = self.session_file(folder).filter(|_| self.files.own.is_some()) else {
            return Ok(());
        };
        let locks = self.files.store.locks();
        let own = self.files.own.as_mut().expect("it is there");
        let added = own.write(file, locks.as_deref())?;
        self.take_in(&added);
        self.model.notes_saved();
        Ok(())
    }

    /// Keeps notes that were changed, and the place of the eye once it rests.
    ///
    /// * `at_once`: the window or the volume is closed.
    ///
    /// # Errors
    /// As [`OpenCase::save_notes`], if there are notes. A place alone is no reason to bother anybody.
    pub fn keep_notes(&mut self, at_once: bool) -> Result<(), AppError> {
        let (state, now) = (self.state_to_keep(), Instant::now());
        let is_due = match &self.files.is_kept {
            Some((kept, _)) if *kept == state => false,
            Some((kept, when)) => {
                at_once || kept.version != state.version || now - *when > KEEP_PLACE
            }
            None => true,
        };
        let (Some(mut file), true) = (self.session_file(None), is_due) else { return Ok(()) };
        file.add(&self.files.offered);
        let locks = self.files.store.locks();
        let Some(kept) = &mut self.files.kept else { return Ok(()) };
        match kept.write(file, locks.as_deref()) {
            Ok(added) => {
                self.take_in(&added);
                self.files.is_kept = Some((self.state_to_keep(), now));
                Ok(())
            }
            Err(e) if self.model.has_unsaved_notes() => Err(e),
            Err(e) => {
                tracing::info!("the place is not kept: {e}");
                self.files.is_kept = Some((state, now));
                Ok(())
            }
        }
    }

    /// Takes in notes that another window has written.
    fn take_in(&mut self, added: &AddedNotes) {
        if added.count() > 0 {
            self.model.add_notes(added);
            let (n, s) = (added.count(), if added.count() == 1 { "" } else { "s" });
            self.model.message = Some(format!("{n} note{s} from another window taken in"));
        }
    }

    /// Whether the kept file has the notes as they are.
    fn is_kept(&self) -> bool {
        let kept = self.files.is_kept.as_ref();
        kept.is_some_and(|(kept, _)| kept.version == self.model.notes_version())
    }

    fn state_to_keep(&self) -> KeptState {
        // A place is kept once the eye rests.
        let before = self.files.is_kept.as_ref().filter(|_| self.model.is_moving());
        let here = self.model.place_on_path_mm().to_bits();
        KeptState {
            version: self.model.notes_version(),
            place: before.map_or(here, |(kept, _)| kept.place),
            lumen: SavedLumen::of(&self.options.settings.lumen),
            ends: SavedEnds::of(&self.options.settings.centerline),
        }
    }

    /// The state of the window as a file; `None` until the volume is known and its notes are applied.
    ///
    /// * `folder`: that of the file.
    fn session_file(&self, folder: Option<&Path>) -> Option<SessionFile> {
        let file = SessionFile::of(&self.model).filter(|_| self.files.waiting.is_none())?;
        let source = self.options.source.as_ref().filter(|_| self.computation.is_some());
        let lumen = SavedLumen::of(&self.options.settings.lumen);
        let case = source.and_then(|source| SavedCase::of(source, folder));
        let ends = SavedEnds::of(&self.options.settings.centerline);
        Some(SessionFile { lumen, ends, case, ..file })
    }
}
