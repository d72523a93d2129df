//! Outcome of the computation as the model takes it in: done, stopped, a question, or a failure.

use std::sync::Arc;

use super::super::action::Colouring;
use super::Model;
use crate::formats::{FormatError, InputInfo};
use crate::lumen::IntensitySelection;
use crate::organ::Glance;
use crate::session::{Segmented, SessionError};

impl Model {
    /// Takes in how the computation ended, and what has to be chosen from because of that.
    pub fn finish(
        &mut self,
        outcome: Result<(), SessionError>,
        contents: Option<(InputInfo, bool)>,
    ) {
        (self.is_complete, self.contents) = (true, contents);
        match outcome {
            Ok(()) => {}
            Err(SessionError::Cancelled) => {
                self.is_stopped = true;
                self.message = Some("stopped; what is there stays".into());
            }
            Err(SessionError::LumenNotChosen { organ, .. }) => {
                self.question = Some("choose the organ or the values of the lumen");
                self.glance.get_or_insert_default();
                self.found = organ;
                self.put_found_first();
            }
            Err(SessionError::Format(FormatError::Series { .. })) if self.contents.is_some() => {
                self.question = Some("choose a series");
            }
            Err(SessionError::Format(FormatError::Segments { .. })) if self.contents.is_some() => {
                self.question = Some("choose a segment");
            }
            Err(e) => self.failure = Some(without_flags(&e.to_string())),
        }
    }

    /// Whether there is a wall, and values behind it.
    pub fn may_look_behind(&self) -> bool {
        let lumen = self.products.lumen.as_ref();
        let is_labels =
            |l: &Arc<Segmented>| matches!(l.options.selection, IntensitySelection::Labels(_));
        self.products.wall.is_some() && lumen.is_some_and(|l| !is_labels(l))
    }

    /// Takes in that nothing is to be seen behind the wall, and why.
    pub fn refuse_behind(&mut self, error: &SessionError) {
        self.message = Some(without_flags(&error.to_string()));
        self.colouring = Colouring::Tissue;
    }

    /// Takes in what the volume seems to show.
    pub fn set_glance(&mut self, seen: Glance) {
        self.glance = Some(seen);
        self.put_found_first();
    }

    /// Offers the organ that was found before those that may be there.
    fn put_found_first(&mut self) {
        if let (Some(glance), Some(found)) = (&mut self.glance, self.found) {
            glance.organs.retain(|organ| *organ != found);
            glance.organs.insert(0, found);
        }
    }

    /// Takes up a computation that was stopped.
    pub(in super::super) fn resume(&mut self) {
        (self.is_stopped, self.is_complete, self.message) = (false, false, None);
    }
}

/// A message without the parts that name flags of the command line, which a window has not.
fn without_flags(message: &str) -> String {
    let parts = message.split("; ").filter(|part| !part.contains("--"));
    let text = parts.collect::<Vec<_>>().join("; ");
    if text.is_empty() { message.to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_flag_of_the_command_line_is_named_in_the_window() {
        let burned = "a.dcm: the pixels may show who the patient is (BurnedInAnnotation); \
                      --allow-burned-in reads them";
        let said = without_flags(burned);
        assert!(said.ends_with("(BurnedInAnnotation)"), "{said}");
        assert_eq!(without_flags("no airway found: a; b"), "no airway found: a; b");
    }
}
