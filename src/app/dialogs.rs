//! Dialogs: files to open and to save, and what is lost by leaving.

use std::path::{Path, PathBuf};

use egui::{Align2, Ui, Vec2};
use egui_file_dialog::{DialogState, FileDialog, Filter};

use super::action::{Action, ActionQueue, Request};
use super::model::Model;

/// Kinds of files that can be opened.
pub(super) const FILES: &str = "NIfTI, NRRD, MetaImage, DICOM; or a session file";

/// Dialogs for choosing files.
pub(super) struct Dialogs {
    /// Dialog for a file or a folder to open.
    pub open: FileDialog,
    /// Whether it is opened beside the case that is open.
    pub is_beside: bool,
    /// Path that is typed, of a file or a folder to open.
    pub typed: String,
    /// Dialog for the file of the notes.
    pub save: FileDialog,
}

/// Name of the files that the dialog lists at first; it offers all others too.
const SCANS: &str = "Scans and sessions";

/// Whether a file's name may be that of a scan or a session. Most files of a DICOM series have no
/// extension, or their number as one.
fn may_be_opened(path: &Path) -> bool {
    const EXTENSIONS: [&str; 10] =
        ["nii", "gz", "nrrd", "nhdr", "mha", "mhd", "dcm", "dicom", "ima", "json"];
    let is_number = |e: &str| e.bytes().all(|b| b.is_ascii_digit());
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    extension.is_none_or(|e| is_number(&e) || EXTENSIONS.contains(&&e[..]))
}

impl Default for Dialogs {
    fn default() -> Self {
        let dialog = |title| {
            let size = [640.0, 420.0];
            FileDialog::new()
                .title(title)
                .default_size(size)
                .anchor(Align2::CENTER_CENTER, Vec2::ZERO)
        };
        let save = dialog("Save as").default_file_name("session.json");
        let open = dialog("Open").add_file_filter(SCANS, Filter::new(may_be_opened));
        let open = open.default_file_filter(SCANS);
        Self { open, is_beside: false, typed: String::new(), save }
    }
}

impl Dialogs {
    /// Whether one of them is shown.
    pub fn is_any_open(&self) -> bool {
        [&self.open, &self.save].iter().any(|d| *d.state() == DialogState::Open)
    }
}

/// Returns what opens a file or folder.
pub(super) fn open_request(path: PathBuf) -> Request {
    match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        true => Request::OpenSession(path),
        false => Request::Open(path),
    }
}

/// Files chosen in the dialogs.
pub(super) fn opened(ui: &Ui, dialogs: &mut Dialogs, commands: &mut ActionQueue) {
    dialogs.open.update(ui.ctx());
    dialogs.save.update(ui.ctx());
    if let Some(path) = dialogs.open.take_picked() {
        let opens = open_request(path);
        commands.ask(if dialogs.is_beside { Request::Beside(Box::new(opens)) } else { opens });
    }
    if let Some(path) = dialogs.save.take_picked() {
        commands.ask(Request::SaveAs(path));
    }
}

/// Said of notes that are in no file of the user's.
const NOTES_KEPT: &str = "Findings and measurements are in no file of yours yet. They are kept, and \
    offered when this scan is opened again.";

/// Asks what becomes of notes that no file has, and of a flight that is being saved.
pub(super) fn ask_to_save(
    ui: &Ui,
    model: &Model,
    dialogs: &mut Dialogs,
    commands: &mut ActionQueue,
) {
    if model.leaving.is_none() || *dialogs.save.state() == DialogState::Open {
        return;
    }
    let asked = egui::Modal::new(egui::Id::new("unsaved")).show(ui.ctx(), |ui| {
        let has_notes = model.leaves_notes;
        if has_notes {
            ui.label(match model.are_notes_kept {
                true => NOTES_KEPT,
                false => "Findings and measurements are not saved.",
            });
        }
        if model.leaves_flight {
            ui.label("A flight is being saved; it ends here.");
        }
        ui.horizontal(|ui| {
            if has_notes && ui.button("Save as").clicked() {
                dialogs.save.save_file();
            }
            let go = match (has_notes, model.are_notes_kept) {
                (true, true) => "Close",
                (true, false) => "Do not save",
                (false, _) => "End it",
            };
            if ui.button(go).clicked() {
                commands.ask(Request::Discard);
            }
            if ui.button("Back").clicked() {
                commands.act(Action::Stay);
            }
        });
    });
    // Escape, or a click beside it.
    if asked.should_close() {
        commands.act(Action::Stay);
    }
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::*;

    #[test]
    fn the_dialog_lists_scans_and_sessions_and_no_other_files() {
        for name in ["ct.nii.gz", "CT.NRRD", "head.mhd", "IM0001", "1.2.840.10008.5", "a.json"] {
            assert!(may_be_opened(Path::new(name)), "{name}");
        }
        for name in ["letter.docx", "film.mp4", "wall.ply", "report.html"] {
            assert!(!may_be_opened(Path::new(name)), "{name}");
        }
    }

    fn pressed(key: egui::Key) -> egui::Event {
        let (physical_key, modifiers) = (None, egui::Modifiers::NONE);
        egui::Event::Key { key, physical_key, pressed: true, repeat: false, modifiers }
    }

    #[test]
    fn escape_stays_with_what_is_open_where_a_flight_would_be_lost() {
        let mut model = Model::new(20.0);
        (model.leaving, model.leaves_flight) = (Some(Request::Quit), true);
        let (mut screen, mut dialogs) = (TestScreen::new(), Dialogs::default());
        let mut frame = |events, model: &Model| {
            let mut commands = ActionQueue::default();
            let lay_out = |ui: &mut Ui| ask_to_save(ui, model, &mut dialogs, &mut commands);
            let texts = screen.frame(events, lay_out);
            (texts.into_iter().map(|t| t.0).collect::<Vec<_>>(), commands)
        };
        frame(Vec::new(), &model);
        let (texts, commands) = frame(Vec::new(), &model);
        assert!(texts.iter().any(|t| t.starts_with("A flight is being saved")), "{texts:?}");
        assert!(!texts.iter().any(|t| t == "Save as"), "there are no notes: {texts:?}");
        assert!(commands.is_empty());
        let (_, commands) = frame(vec![pressed(egui::Key::Escape)], &model);
        assert_eq!(commands.actions, [Action::Stay]);
    }
}
