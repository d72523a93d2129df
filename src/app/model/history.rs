//! Undo and redo: the notes and the grey window as they were before each change. Pictures of
//! bookmarks are shared, so that a state takes some hundred bytes a note.

use super::super::action::Action;
use super::super::measure::Measurement;
use super::super::session_file::AddedNotes;
use super::{Bookmark, Model};

/// Most changes that can be taken back.
const MAX_CHANGES: usize = 200;

/// What can be taken back.
#[derive(Clone, Debug, PartialEq)]
struct Noted {
    bookmarks: Vec<Bookmark>,
    measurements: Vec<Measurement>,
    rectum_at_start: Option<bool>,
    window: [f64; 2],
}

/// Kind of a change. Of changes of one kind in frames that follow each other, as a drag makes
/// them, all are taken back at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    Bookmark,
    Measurement,
    Ends,
    /// A point of a measurement is dragged.
    Point(usize, usize),
    /// The name of a measurement is typed.
    Name(usize),
    /// The name or the segment of a finding is typed.
    Finding(usize),
    /// The grey window is dragged.
    Window,
}

impl Change {
    /// Returns the change that an action may make.
    fn of(action: &Action) -> Option<Self> {
        Some(match action {
            Action::Bookmark(_) | Action::RemoveBookmark(_) => Self::Bookmark,
            Action::Mark(_) | Action::MarkInSlice(_) | Action::RemoveMeasurement(_) => {
                Self::Measurement
            }
            Action::EditFinding(i, _) => Self::Finding(*i),
            Action::RectumAtStart(_) => Self::Ends,
            Action::MoveMark { measurement, point, .. } => Self::Point(*measurement, *point),
            Action::NameMeasurement(i, _) => Self::Name(*i),
            Action::Window(_) => Self::Window,
            _ => return None,
        })
    }

    fn is_gesture(self) -> bool {
        matches!(self, Self::Point(..) | Self::Name(_) | Self::Finding(_) | Self::Window)
    }

    /// Returns the name of the change in a message.
    fn name(self) -> &'static str {
        match self {
            Self::Bookmark => "finding",
            Self::Measurement => "measurement",
            Self::Ends => "ends of the path",
            Self::Point(..) => "point of a measurement",
            Self::Name(_) => "name of a measurement",
            Self::Finding(_) => "description of a finding",
            Self::Window => "grey window",
        }
    }
}

/// States before the changes that can be taken back, and after those that were.
#[derive(Clone, Default)]
pub(super) struct History {
    before: Vec<(Change, Noted)>,
    undone: Vec<(Change, Noted)>,
    /// The gesture that goes on.
    gesture: Option<Change>,
}

impl History {
    /// Remembers the state before a change.
    fn remember(&mut self, change: Change, noted: Noted) {
        self.undone.clear();
        if self.gesture == Some(change) {
            return;
        }
        if self.before.len() == MAX_CHANGES {
            self.before.remove(0);
        }
        self.before.push((change, noted));
        self.gesture = Some(change).filter(|change| change.is_gesture());
    }

    /// Whether a gesture goes on.
    pub(super) fn is_in_gesture(&self) -> bool {
        self.gesture.is_some()
    }

    /// Adds notes that came from elsewhere to all states: to undo a change does not take them away.
    pub(super) fn add(&mut self, added: &AddedNotes) {
        for (_, noted) in self.before.iter_mut().chain(&mut self.undone) {
            added.put_into(&mut noted.bookmarks, &mut noted.measurements);
        }
    }

    /// Ends a gesture that none of a frame's actions belongs to.
    pub(super) fn end_of_frame(&mut self, actions: &[Action]) {
        let goes_on = actions.iter().any(|a| Change::of(a) == self.gesture);
        self.gesture = self.gesture.filter(|_| goes_on);
    }
}

impl Model {
    fn noted(&self) -> Noted {
        Noted {
            bookmarks: self.bookmarks.clone(),
            measurements: self.measurements.clone(),
            rectum_at_start: self.rectum_at_start,
            window: self.window,
        }
    }

    /// Carries out an action, so that its change can be taken back.
    pub(super) fn act_with_history(&mut self, action: &Action) {
        match (action, Change::of(action)) {
            (Action::Undo, _) => self.move_in_history(true),
            (Action::Redo, _) => self.move_in_history(false),
            (_, None) => self.act(action),
            (_, Some(change)) => {
                let before = self.noted();
                self.act(action);
                if self.noted() != before {
                    self.history.remember(change, before);
                }
            }
        }
    }

    /// Takes the last change back, or makes the change again that was taken back last.
    fn move_in_history(&mut self, is_undo: bool) {
        let now = self.noted();
        let History { before, undone, .. } = &mut self.history;
        let (from, to, [verb, done]) = match is_undo {
            true => (before, undone, ["undo", "undone"]),
            false => (undone, before, ["redo", "redone"]),
        };
        let Some((change, noted)) = from.pop() else {
            self.message = Some(format!("nothing to {verb}"));
            return;
        };
        to.push((change, now));
        self.restore_noted(noted);
        self.message = Some(format!("{done}: {}", change.name()));
    }

    fn restore_noted(&mut self, noted: Noted) {
        self.history.gesture = None;
        let selected = self.selected.and_then(|i| self.bookmarks.get(i)).map(|b| b.id);
        self.selected = noted.bookmarks.iter().position(|b| Some(b.id) == selected);
        let Noted { bookmarks, measurements, rectum_at_start, window } = noted;
        (self.bookmarks, self.measurements, self.window) = (bookmarks, measurements, window);
        self.restore_ends(rectum_at_start);
        self.notes_changed();
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::action::Ruler;
    use super::*;

    fn marked() -> Model {
        let mut model = Model::new(20.0);
        let marks = [Action::Mark([0.0; 3]), Action::Mark([3.0, 4.0, 0.0])];
        model.step(0.0, &[Action::Measure(Some(Ruler::Length))]);
        model.step(0.0, &marks);
        model
    }

    #[test]
    fn a_deleted_measurement_comes_back_and_goes_again() {
        let mut model = marked();
        model.notes_saved();
        model.step(0.0, &[Action::RemoveMeasurement(0)]);
        model.step(0.0, &[Action::Undo]);
        assert_eq!(model.measurements[0].label(), "5.0 mm");
        assert!(model.has_unsaved_notes(), "the file may have the state in between");
        model.step(0.0, &[Action::Redo]);
        assert!(model.measurements.is_empty());
        model.step(0.0, &[Action::Undo, Action::Undo, Action::Undo]);
        assert!(model.measurements.is_empty(), "it was made");
        assert_eq!(model.message.as_deref(), Some("nothing to undo"));
    }

    #[test]
    fn a_drag_is_taken_back_at_once_and_two_drags_one_by_one() {
        let mut model = marked();
        let drag = |x| Action::MoveMark { measurement: 0, point: 1, to: [x, 0.0, 0.0] };
        let value = |model: &Model| model.measurements[0].value();
        for x in [6.0, 7.0, 8.0] {
            model.step(0.1, &[drag(x)]);
        }
        model.step(0.1, &[]);
        for x in [9.0, 10.0] {
            model.step(0.1, &[drag(x)]);
        }
        model.step(0.1, &[Action::Undo]);
        assert_eq!(value(&model), 8.0);
        model.step(0.1, &[Action::Undo]);
        assert_eq!(value(&model), 5.0);
        // A new change leaves nothing to redo.
        model.step(0.1, &[drag(2.0)]);
        model.step(0.1, &[Action::Redo]);
        assert_eq!(value(&model), 2.0);
    }

    #[test]
    fn the_grey_window_is_taken_back_and_stays_within_what_a_panel_shows() {
        let mut model = Model::new(20.0);
        model.step(0.0, &[Action::Window([40.0, 400.0])]);
        model.step(0.0, &[]);
        model.step(0.0, &[Action::Window([1e300, -5.0])]);
        assert_eq!(model.window, [1e7, 1e-3], "300 digits push the panel off the window");
        model.step(0.0, &[Action::Undo]);
        assert_eq!(model.window, [40.0, 400.0]);
    }
}
