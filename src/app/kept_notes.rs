//! Notes that the window keeps for its user, whether or not they are in a file of the user's: one
//! session file a volume, named by the hash of the volume, in the user's folder of states. They are
//! offered when the volume is opened again, and list the cases that were opened last.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::session_file::{AddedNotes, SessionFile};

/// Cases that are listed.
const LISTED: usize = 8;
/// Files of cases without notes that are kept.
const MAX_WITHOUT_NOTES: usize = 50;

/// The folder of kept notes, if there is one.
#[derive(Default)]
pub(super) struct KeptNotes {
    folder: Option<PathBuf>,
}

/// Notes of the volume that is open, from before.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptOffer {
    /// Number of bookmarks and of measurements that the window does not show.
    pub counts: [usize; 2],
    /// Days since they were kept.
    pub days: u64,
}

/// A case that was opened before.
#[derive(Clone, Debug, PartialEq)]
pub struct RecentCase {
    /// Name of the file or folder.
    pub name: String,
    /// Kept file of the case, which opens it.
    pub file: PathBuf,
    /// Number of bookmarks and measurements.
    pub notes: usize,
    /// Days since it was open.
    pub days: u64,
}

impl KeptOffer {
    pub(super) fn of(notes: &AddedNotes, file: &Path) -> Option<Self> {
        let counts = [notes.bookmarks.len(), notes.measurements.len()];
        (notes.count() > 0).then(|| Self { counts, days: days_since(modified(file)) })
    }
}

impl KeptNotes {
    /// * `folder`: of the user's states; nothing is kept without one.
    pub fn new(folder: Option<PathBuf>) -> Self {
        Self { folder }
    }

    /// Folder of the locks by which windows wait for each other.
    pub fn locks(&self) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join("locks"))
    }

    /// The file of a volume, by its hash. Its folder is made.
    pub fn file(&self, hash: &str) -> Option<PathBuf> {
        let folder = self.folder.as_ref()?.join("cases");
        let made = std::fs::create_dir_all(&folder);
        made.inspect_err(|e| tracing::info!("notes are not kept: {e}")).ok()?;
        Some(folder.join(format!("{hash}.json")))
    }

    /// Gives a file another name, so that it is neither offered nor overwritten.
    pub fn set_aside(file: &Path) -> std::io::Result<()> {
        let aside = (1u32..).map(|i| file.with_extension(format!("{i}.aside")));
        let mut free = aside.filter(|path| !path.exists());
        std::fs::rename(file, free.next().expect("numbers do not end"))
    }

    /// Returns the cases that were opened last, the latest first. Of those without notes the oldest
    /// files are removed beyond a number.
    pub fn recent(&self) -> Vec<RecentCase> {
        let Some(folder) = &self.folder else { return Vec::new() };
        let Ok(entries) = std::fs::read_dir(folder.join("cases")) else { return Vec::new() };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let kept = paths.filter(|path| path.extension().is_some_and(|e| e == "json"));
        let mut kept: Vec<_> = kept.map(|path| (modified(&path), path)).collect();
        kept.sort_by(|a, b| b.cmp(a));
        let mut cases = Vec::new();
        let mut without_notes = 0;
        for (when, path) in kept {
            let Ok(file) = SessionFile::read(&path) else { continue };
            without_notes += usize::from(file.notes() == 0);
            if file.notes() == 0 && without_notes > MAX_WITHOUT_NOTES {
                // A leftover is tried again at the next start.
                let _ = std::fs::remove_file(&path);
            } else if let Some(name) = file.case.as_ref().and_then(|case| case.name())
                && cases.len() < LISTED
            {
                let (name, notes, days) = (name.to_owned(), file.notes(), days_since(when));
                cases.push(RecentCase { name, file: path, notes, days });
            }
        }
        cases
    }
}

fn modified(file: &Path) -> SystemTime {
    let times = std::fs::metadata(file).and_then(|m| m.modified());
    times.unwrap_or(SystemTime::UNIX_EPOCH)
}

/// Whole days; 0 of a moment to come, as clocks are set back.
fn days_since(when: SystemTime) -> u64 {
    SystemTime::now().duration_since(when).map_or(0, |d| d.as_secs() / 86_400)
}

/// How long ago it was, in words.
pub(super) fn ago(days: u64) -> String {
    match days {
        0 => "today".into(),
        1 => "yesterday".into(),
        days => format!("{days} days ago"),
    }
}
