//! Notes on a volume as a file: bookmarks and how the window was set. Geometry only; nothing of a
//! patient.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::error::AppError;
use super::measure::Measurement;
use super::model::{Bookmark, Model, SavedView};
use super::opening::{SavedEnds, SavedLumen};
use super::saved_case::SavedCase;
use crate::formats::{FormatError, atomic_file, read_plain};

/// Name and version of the format.
pub const SESSION_SCHEMA: &str = "intima.session/1";
/// Largest file that is read.
const MAX_BYTES: u64 = 16 << 20;
/// Most bookmarks of a file.
const MAX_BOOKMARKS: usize = 100_000;

/// A session file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionFile {
    /// Name and version of the format.
    pub schema: String,
    /// Coordinate system of all positions.
    pub space: String,
    /// BLAKE3 of the volume's stored samples.
    pub input: String,
    /// Noted places.
    pub bookmarks: Vec<Bookmark>,
    /// Centre and width of the slices' grey values.
    pub window: [f64; 2],
    /// Cruising speed, mm/s.
    pub speed_mm_s: f64,
    /// Vertical field of view, degrees.
    pub fov_deg: f32,
    /// Millimetres along the path.
    pub arc_mm: f64,
    /// Whether the path begins at a colon's rectum, where someone has said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rectum_at_start: Option<bool>,
    /// Lengths and angles.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measurements: Vec<Measurement>,
    /// Way in which the organ was shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<SavedView>,
    /// Choice of the lumen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lumen: Option<SavedLumen>,
    /// Ends of the path that someone has set.
    #[serde(default, skip_serializing_if = "SavedEnds::is_none")]
    pub ends: SavedEnds,
    /// Files of the case.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub case: Option<SavedCase>,
}

impl SessionFile {
    /// The state of a window, without its files and the choice of its lumen; `None` before the volume
    /// is known.
    pub fn of(model: &Model) -> Option<Self> {
        Some(Self {
            schema: SESSION_SCHEMA.into(),
            space: "LPS".into(),
            input: model.products.identity.as_deref()?.clone(),
            bookmarks: model.bookmarks.clone(),
            window: model.window,
            speed_mm_s: model.speed_mm_s,
            fov_deg: model.fov_deg,
            arc_mm: model.place_on_path_mm(),
            rectum_at_start: model.rectum_at_start,
            measurements: model.measurements.clone(),
            view: Some(model.saved_view()),
            lumen: None,
            ends: SavedEnds::default(),
            case: None,
        })
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`AppError::SessionFile`] with what is wrong: no JSON, another or a newer format, numbers
    /// that are none. [`AppError::Format`] if it cannot be read.
    pub fn read(path: &Path) -> Result<Self, AppError> {
        let bad = |what: String| AppError::SessionFile { path: path.to_owned(), what };
        let bytes = read_plain(path, MAX_BYTES + 1)?;
        if bytes.len() as u64 > MAX_BYTES {
            return Err(bad(format!("larger than {MAX_BYTES} bytes")));
        }
        let json: serde_json::Value = serde_json::from_slice(&bytes).map_err(|e| {
            bad(format!("no session file (line {}, column {})", e.line(), e.column()))
        })?;
        match json.get("schema").and_then(|s| s.as_str()) {
            Some(SESSION_SCHEMA) => {}
            Some(s) if s.starts_with("intima.session/") => {
                return Err(bad("made by a newer version of intima".into()));
            }
            _ => return Err(bad(format!("no session file: its schema is not {SESSION_SCHEMA}"))),
        }
        let file: Self =
            serde_json::from_value(json).map_err(|_| bad("a field is missing or wrong".into()))?;
        file.check().map_err(bad)?;
        Ok(file.with_ids())
    }

    fn check(&self) -> Result<(), String> {
        if self.space != "LPS" {
            return Err("its coordinates are not LPS".into());
        }
        if self.bookmarks.len().max(self.measurements.len()) > MAX_BOOKMARKS {
            return Err(format!("more than {MAX_BOOKMARKS} bookmarks or measurements"));
        }
        for (i, b) in self.bookmarks.iter().enumerate() {
            let rotation = DQuat::from_array(b.rotation);
            let turned = rotation.is_finite() && (rotation.length() - 1.0).abs() < 1e-3;
            let arc = b.arc_mm.is_none_or(f64::is_finite);
            let wall = b.wall_mm.is_none_or(|p| DVec3::from(p).is_finite());
            let place = DVec3::from(b.position_mm).is_finite() && wall;
            if !place || !turned || !arc || !b.fov_deg.is_finite() {
                return Err(format!("bookmark {} is no place", i + 1));
            }
            if b.picture.as_deref().is_some_and(|name| !is_file_name(name)) {
                return Err(format!("the picture of bookmark {} is no name of a file", i + 1));
            }
        }
        if let Some(i) = self.measurements.iter().position(|m| !m.is_valid()) {
            return Err(format!("measurement {} lacks a place", i + 1));
        }
        if !self.lumen.as_ref().is_none_or(SavedLumen::is_choice) {
            return Err("its lumen is none".into());
        }
        if !self.view.as_ref().is_none_or(SavedView::is_valid) {
            return Err("its view is no place".into());
        }
        if !self.ends.is_finite() {
            return Err("an end of its path is no place".into());
        }
        let numbers = [self.window[0], self.window[1], self.speed_mm_s, self.arc_mm];
        match numbers.iter().all(|n| n.is_finite()) && self.fov_deg.is_finite() {
            true => Ok(()),
            false => Err("a number is not finite".into()),
        }
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// [`AppError::Format`]; then the file before is still there.
    pub fn write(&self, path: &Path) -> Result<(), AppError> {
        let json = serde_json::to_vec_pretty(self).map_err(std::io::Error::other);
        let json = json.map_err(|e| FormatError::io(path, e))?;
        Ok(atomic_file::write_atomic(path, |o| o.write_all(&json))?)
    }

    /// Number of notes.
    pub fn notes(&self) -> usize {
        self.bookmarks.len() + self.measurements.len()
    }

    /// Numbers the notes that have no number by their content, so that each window that reads the file
    /// finds the same numbers.
    fn with_ids(mut self) -> Self {
        let mut taken: BTreeSet<u64> = self.bookmarks.iter().map(|b| b.id).collect();
        taken.extend(self.measurements.iter().map(|m| m.id));
        let mut free = |says: u64| {
            let mut id = says.max(1);
            while !taken.insert(id) {
                id += 1;
            }
            id
        };
        for b in self.bookmarks.iter_mut().filter(|b| b.id == 0) {
            b.id = free(content_id(b, [0; 2]));
        }
        for m in self.measurements.iter_mut().filter(|m| m.id == 0) {
            m.id = free(content_id(m, [0; 2]));
        }
        self
    }

    /// Returns the notes of another file that this one lacks: those that are not in it, and were not
    /// removed from it; and those changed there and not here.
    ///
    /// * `origin`: the file that both come from.
    pub(super) fn lacks(&self, other: &Self, origin: Option<&Self>) -> AddedNotes {
        let origins = |get: fn(&Self) -> &[Bookmark]| origin.map_or(&[][..], get);
        let is_lacking = |theirs: &&Bookmark| {
            let own = self.bookmarks.iter().find(|b| b.id == theirs.id);
            let first = origins(|o| &o.bookmarks).iter().find(|b| b.id == theirs.id);
            lacks_note(own.map(Bookmark::plain), &theirs.plain(), first.map(Bookmark::plain))
        };
        let measured = origin.map_or(&[][..], |o| &o.measurements);
        let is_unknown = |theirs: &&Measurement| {
            let own = self.measurements.iter().find(|m| m.id == theirs.id);
            let first = measured.iter().find(|m| m.id == theirs.id);
            lacks_note(own, theirs, first)
        };
        AddedNotes {
            bookmarks: other.bookmarks.iter().filter(is_lacking).cloned().collect(),
            measurements: other.measurements.iter().filter(is_unknown).cloned().collect(),
        }
    }

    /// Takes notes in behind its own, or in the place of those with their numbers.
    pub(super) fn add(&mut self, added: &AddedNotes) {
        added.put_into(&mut self.bookmarks, &mut self.measurements);
    }

    /// Sets a window as the file says.
    ///
    /// # Errors
    /// What is wrong: it is of another volume.
    pub fn apply(&self, model: &mut Model) -> Result<(), String> {
        if model.products.identity.as_deref() != Some(&self.input) {
            return Err("the session file is of another volume".into());
        }
        use super::action::Action;
        model.forget_notes();
        model.add_notes(&AddedNotes {
            bookmarks: self.bookmarks.clone(),
            measurements: self.measurements.clone(),
        });
        model.restore_ends(self.rectum_at_start);
        model.step(
            0.0,
            &[
                Action::Window(self.window),
                Action::Speed(self.speed_mm_s),
                Action::FieldOfView(self.fov_deg),
            ],
        );
        model.start_at(self.arc_mm);
        self.view.iter().for_each(|view| model.restore_view(view));
        Ok(())
    }
}

/// Notes that came from elsewhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct AddedNotes {
    pub bookmarks: Vec<Bookmark>,
    pub measurements: Vec<Measurement>,
}

/// Whether a note of another file is to be taken in.
///
/// * `own`, `first`: the same note here, and in the file that both come from.
fn lacks_note<T: PartialEq>(own: Option<T>, theirs: &T, first: Option<T>) -> bool {
    match (own, first) {
        // New there.
        (None, None) => true,
        // Removed here.
        (None, Some(_)) => false,
        // Changed there alone.
        (Some(own), Some(first)) => own == first && first != *theirs,
        // Two changes of a note that no file had: it stays as it is here.
        (Some(_), None) => false,
    }
}

/// Number of 48 bits, computed from the content of a note and from two more numbers. JSON readers keep
/// whole numbers of so many bits.
pub(super) fn content_id(says: &impl Serialize, more: [u64; 2]) -> u64 {
    let text = serde_json::to_vec(says).unwrap_or_default();
    let mut hasher = blake3::Hasher::new();
    hasher.update(&text);
    for number in more {
        hasher.update(&number.to_le_bytes());
    }
    let mut bytes = [0; 8];
    bytes[..6].copy_from_slice(&hasher.finalize().as_bytes()[..6]);
    u64::from_le_bytes(bytes)
}

impl AddedNotes {
    /// Puts the notes behind others, or in the place of those with their numbers.
    pub fn put_into(&self, bookmarks: &mut Vec<Bookmark>, measurements: &mut Vec<Measurement>) {
        for added in &self.bookmarks {
            match bookmarks.iter_mut().find(|b| b.id == added.id) {
                Some(own) => {
                    let png = own.png.clone().or_else(|| added.png.clone());
                    *own = Bookmark { png, ..added.clone() };
                }
                None => bookmarks.push(added.clone()),
            }
        }
        for added in &self.measurements {
            match measurements.iter_mut().find(|m| m.id == added.id) {
                Some(own) => *own = added.clone(),
                None => measurements.push(added.clone()),
            }
        }
    }

    pub fn count(&self) -> usize {
        self.bookmarks.len() + self.measurements.len()
    }
}

/// A file that a window writes its notes into, and another window may too.
pub(super) struct NotesFile {
    pub path: PathBuf,
    /// Notes of the file when this window read or wrote the file last.
    known: Option<SessionFile>,
    /// Whether a file that is there is replaced whatever it holds, as its user said.
    replaces: bool,
}

impl NotesFile {
    /// A file that was read, or is not there yet.
    pub fn new(path: PathBuf, known: Option<SessionFile>) -> Self {
        Self { path, known, replaces: false }
    }

    /// A file that is replaced if it is there.
    pub fn replacing(path: PathBuf) -> Self {
        Self { path, known: None, replaces: true }
    }

    /// Writes notes, and with them those that another window has written since the file was read or
    /// written here. Returns these.
    ///
    /// * `locks`: folder of the locks by which windows wait for each other.
    ///
    /// # Errors
    /// [`AppError::Format`]; [`AppError::SessionFile`] if the file is no session file any more, or is of
    /// another volume by now. It is then as it was.
    pub fn write(
        &mut self,
        mut own: SessionFile,
        locks: Option<&Path>,
    ) -> Result<AddedNotes, AppError> {
        let _lock = locks.and_then(|folder| lock(folder, &self.path));
        let there = match self.path.exists() && !self.replaces {
            true => Some(SessionFile::read(&self.path)?),
            false => None,
        };
        if there.as_ref().is_some_and(|there| there.input != own.input) {
            let what = "it is of another volume by now and is not overwritten".into();
            return Err(AppError::SessionFile { path: self.path.clone(), what });
        }
        let added = there.map(|there| own.lacks(&there, self.known.as_ref())).unwrap_or_default();
        own.add(&added);
        own.write(&self.path)?;
        (self.known, self.replaces) = (Some(own), false);
        Ok(added)
    }
}

/// Waits for the lock of a file; it is let go with what is returned. Where the system or the file
/// system has no locks, nobody waits.
fn lock(folder: &Path, file: &Path) -> Option<std::fs::File> {
    std::fs::create_dir_all(folder).ok()?;
    let parent = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let whole = parent.canonicalize().ok()?.join(file.file_name()?);
    let name = blake3::hash(whole.as_os_str().as_encoded_bytes()).to_hex();
    let path = folder.join(&name[..32]);
    let lock = std::fs::File::options().create(true).append(true).open(path).ok()?;
    lock.lock().ok()?;
    Some(lock)
}

/// Whether a text names a file of the same folder, and nothing else.
fn is_file_name(name: &str) -> bool {
    let path = Path::new(name);
    path.file_name().is_some_and(|n| n == name) && name.ends_with(".png")
}

#[cfg(test)]
mod tests {
    use super::super::action::Ruler;
    use super::super::finding::{Confidence, LesionShape};
    use super::*;

    fn file() -> SessionFile {
        SessionFile {
            schema: SESSION_SCHEMA.into(),
            space: "LPS".into(),
            input: "ab".into(),
            bookmarks: vec![Bookmark {
                text: "fold".into(),
                position_mm: [1.5, -2.25, 1e-3],
                rotation: [0.0, 0.6, 0.0, 0.8],
                fov_deg: 90.0,
                arc_mm: Some(12.5),
                picture: Some("a-1.png".into()),
                png: None,
                id: 1,
                wall_mm: Some([1.0, 2.0, 3.0]),
                segment: Some("sigmoid".into()),
                shape: Some(LesionShape::Flat),
                confidence: Some(Confidence::High),
                in_flight: true,
            }],
            window: [40.0, 400.0],
            speed_mm_s: 20.0,
            fov_deg: 100.0,
            arc_mm: 3.0,
            rectum_at_start: Some(false),
            measurements: vec![Measurement {
                name: "polyp".into(),
                ruler: Ruler::Length,
                points_mm: vec![[1.0, 2.0, 3.0], [1.0, 2.0, 7.5]],
                in_slice: true,
                finding: Some(1),
                id: 2,
            }],
            view: Some(Model::new(20.0).saved_view()),
            lumen: Some(SavedLumen::Organ(crate::organ::Organ::Airway)),
            ends: SavedEnds::default(),
            case: None,
        }
    }

    fn refused(change: impl Fn(&mut serde_json::Value)) -> String {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.json");
        let mut json = serde_json::to_value(file()).unwrap();
        change(&mut json);
        std::fs::write(&path, json.to_string()).unwrap();
        SessionFile::read(&path).unwrap_err().to_string()
    }

    #[test]
    fn a_session_file_reads_back_to_the_same_numbers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.json");
        file().write(&path).unwrap();
        assert_eq!(SessionFile::read(&path).unwrap(), file());
    }

    #[test]
    fn a_session_file_of_a_newer_version_or_with_nonsense_is_refused_with_the_reason() {
        assert!(
            refused(|j| j["schema"] = "intima.session/2".into())
                .ends_with("newer version of intima")
        );
        assert!(refused(|j| j["schema"] = "x".into()).contains("schema is not intima.session/1"));
        assert!(refused(|j| j["space"] = "RAS".into()).ends_with("not LPS"));
        assert!(
            refused(|j| j["bookmarks"][0]["rotation"][3] = 9.0.into())
                .ends_with("bookmark 1 is no place")
        );
        for name in ["../a.png", "/a.png", "a.txt", ""] {
            let said = refused(|j| j["bookmarks"][0]["picture"] = name.into());
            assert!(said.ends_with("bookmark 1 is no name of a file"), "{said}");
        }
        assert!(
            refused(|j| j["measurements"][0]["ruler"] = "angle".into())
                .ends_with("measurement 1 lacks a place")
        );
        assert!(refused(|j| j["view"]["zoom"] = "near".into()).ends_with("missing or wrong"));
        let eye = serde_json::json!({"position_mm": [0, 0, 0], "rotation": [0, 0, 0, 9]});
        assert!(refused(|j| j["view"]["eye"] = eye.clone()).ends_with("its view is no place"));
        assert!(refused(|j| j["window"] = "wide".into()).ends_with("missing or wrong"));
    }

    fn named(names: &[&str]) -> SessionFile {
        let id = |text: &str| u64::from(text.as_bytes()[0]);
        let of = |text: &&str| Bookmark {
            text: (*text).into(),
            id: id(text),
            ..file().bookmarks.remove(0)
        };
        let bookmarks = names.iter().map(of).collect();
        SessionFile { bookmarks, measurements: Vec::new(), ..file() }
    }

    fn names_in(path: &Path) -> Vec<String> {
        SessionFile::read(path).unwrap().bookmarks.into_iter().map(|b| b.text).collect()
    }

    #[test]
    fn two_windows_on_one_file_keep_the_notes_of_both() {
        let dir = tempfile::tempdir().unwrap();
        let (path, locks) = (dir.path().join("s.json"), dir.path().join("locks"));
        named(&["a"]).write(&path).unwrap();
        let open = || NotesFile::new(path.clone(), Some(SessionFile::read(&path).unwrap()));
        let (mut first, mut second) = (open(), open());
        let write = |file: &mut NotesFile, names: &[&str]| -> Vec<String> {
            let added = file.write(named(names), Some(&locks)).unwrap();
            added.bookmarks.into_iter().map(|b| b.text).collect()
        };
        assert!(write(&mut first, &["a", "b"]).is_empty());
        assert_eq!(write(&mut second, &["a", "c"]), ["b"]);
        assert_eq!(names_in(&path), ["a", "c", "b"]);
        // The second window has taken "b" in by now; the first forgets "a".
        assert_eq!(write(&mut first, &["b"]), ["c"]);
        assert_eq!(names_in(&path), ["b", "c"]);
        assert!(write(&mut second, &["a", "c", "b"]).is_empty(), "what one keeps is not lost");
        assert_eq!(names_in(&path), ["a", "c", "b"]);
    }

    /// Both versions were kept as two findings.
    #[test]
    fn a_note_that_another_window_has_changed_is_changed_here_and_not_doubled() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.json");
        named(&["a", "b"]).write(&path).unwrap();
        let open = || NotesFile::new(path.clone(), Some(SessionFile::read(&path).unwrap()));
        let (mut first, mut second) = (open(), open());
        let mut renamed = named(&["a", "b"]);
        renamed.bookmarks[0].text = "polyp".into();
        first.write(renamed, None).unwrap();
        let added = second.write(named(&["a", "b", "c"]), None).unwrap();
        assert_eq!(added.bookmarks.len(), 1);
        assert_eq!(names_in(&path), ["polyp", "b", "c"]);
    }

    #[test]
    fn notes_of_an_older_file_get_the_same_numbers_in_each_window() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.json");
        let mut old = named(&["a", "a", "b"]);
        old.bookmarks.iter_mut().for_each(|b| b.id = 0);
        old.write(&path).unwrap();
        let ids = || -> Vec<u64> {
            SessionFile::read(&path).unwrap().bookmarks.iter().map(|b| b.id).collect()
        };
        let first = ids();
        assert_eq!(first, ids());
        let unique: BTreeSet<u64> = first.iter().copied().collect();
        assert!(unique.len() == 3 && !unique.contains(&0), "{first:?}");
    }

    #[test]
    fn a_file_that_became_another_one_is_not_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.json");
        let mut own = NotesFile::new(path.clone(), None);
        own.write(named(&["a"]), None).unwrap();
        let other = SessionFile { input: "cd".into(), ..named(&["x"]) };
        other.write(&path).unwrap();
        let why = own.write(named(&["a", "b"]), None).unwrap_err().to_string();
        assert!(why.ends_with("of another volume by now and is not overwritten"), "{why}");
        std::fs::write(&path, "{}").unwrap();
        assert!(own.write(named(&["a", "b"]), None).is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "{}");
        // Chosen anew by its user, it is.
        NotesFile::replacing(path.clone()).write(named(&["a"]), None).unwrap();
        assert_eq!(names_in(&path), ["a"]);
    }

    /// A width of 300 digits pushed the panel off the window.
    #[test]
    fn a_grey_window_that_no_panel_can_show_is_cut_when_the_file_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wild.json");
        let wild = SessionFile { window: [1e300, -5.0], ..file() };
        std::fs::write(&path, serde_json::to_vec(&wild).unwrap()).unwrap();
        let mut model = Model::new(20.0);
        model.products.identity = Some(std::sync::Arc::new(wild.input.clone()));
        SessionFile::read(&path).unwrap().apply(&mut model).unwrap();
        let [centre, width] = model.window;
        assert!(centre.abs() < 1e8 && (1e-6..1e8).contains(&width), "{:?}", model.window);
    }

    #[test]
    fn a_session_file_of_another_volume_changes_nothing() {
        let mut model = Model::new(20.0);
        model.products.identity = Some(std::sync::Arc::new("cd".into()));
        assert!(file().apply(&mut model).unwrap_err().contains("another volume"));
        assert!(model.bookmarks.is_empty());
        model.products.identity = Some(std::sync::Arc::new("ab".into()));
        file().apply(&mut model).unwrap();
        assert_eq!((model.bookmarks.len(), model.window, model.fov_deg), (1, [40.0, 400.0], 100.0));
    }
}
