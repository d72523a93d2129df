//! Commands of the panels, keys and scripts, and the panes they name: actions change the view,
//! requests ask for work.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::finding::FindingEdit;
use crate::organ::Organ;

/// Bounds of the vertical field of view, degrees.
pub const FOV_DEG: std::ops::RangeInclusive<f32> = 60.0..=140.0;
/// Bounds of the cruising speed, mm/s.
pub const SPEED_MM_S: std::ops::RangeInclusive<f64> = 1.0..=300.0;

/// A part of the window that shows the organ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pane {
    /// The wall as the eye sees it.
    Inside,
    /// The whole organ from outside.
    Overview,
    /// A slice across the body, seen from the feet.
    #[default]
    Axial,
    /// A slice seen from the front.
    Coronal,
    /// A slice seen from the left.
    Sagittal,
    /// A slice across the path, through the eye.
    Across,
}

impl Pane {
    /// All panes.
    pub const ALL: [Self; 6] =
        [Self::Inside, Self::Overview, Self::Axial, Self::Coronal, Self::Sagittal, Self::Across];

    /// The slices.
    pub const SLICES: [Self; 4] = [Self::Axial, Self::Coronal, Self::Sagittal, Self::Across];

    /// Returns the name of the pane.
    pub fn title(self) -> &'static str {
        match self {
            Self::Inside => "Inside",
            Self::Overview => "Overview",
            Self::Axial => "Axial",
            Self::Coronal => "Coronal",
            Self::Sagittal => "Sagittal",
            Self::Across => "Across the path",
        }
    }
}

/// Arrangement of the panes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PaneLayout {
    /// The inside view with the overview in its corner beside one large slice, the other slices small.
    #[default]
    Reading,
    /// One large slice, the others small.
    Slices,
    /// All panes.
    All,
}

impl PaneLayout {
    /// All arrangements with their names.
    pub const ALL: [(Self, &'static str); 3] =
        [(Self::Reading, "reading"), (Self::Slices, "slices"), (Self::All, "all panes")];
}

/// Look of the wall in the inside pane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WallView {
    /// Through a lens.
    #[default]
    Eye,
    /// Everything about the eye: the faces of a cube, unfolded.
    Cube,
    /// Everything about the eye: an equirectangular map.
    Panorama,
}

/// Quantity that colours the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Colouring {
    /// Nothing: it looks like tissue.
    #[default]
    Tissue,
    /// Wall that the inside view has not shown yet.
    Missed,
    /// Distance from the centerline.
    Radius,
    /// Evidence in the scan: places without a wall, and places where a thin sheet is all it shows.
    Evidence,
    /// Tissue behind the wall, by its CT numbers.
    Behind,
}

/// Quantity that is measured by clicking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ruler {
    /// Two points.
    Length,
    /// Three points; the second is the vertex.
    Angle,
}

/// Part of the volume that slices show, about the crosshair.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SliceExtent {
    /// All of it.
    Volume,
    /// Length of the lumen; all of the volume until there is a lumen.
    #[default]
    Lumen,
    /// Millimetres across the shorter side of a pane.
    Mm(f64),
}

/// What a thick slice shows of the values along its normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SlabMode {
    /// Their mean.
    Mean,
    /// The largest: vessels and bones.
    Max,
    /// The least: airways and gas.
    Min,
}

impl SlabMode {
    /// All of them with their names.
    pub const ALL: [(Self, &'static str); 3] =
        [(Self::Mean, "mean"), (Self::Max, "MIP"), (Self::Min, "MinIP")];
}

/// Bounds of the thickness of a slice, mm.
pub const SLAB_MM: std::ops::RangeInclusive<f64> = 1.0..=50.0;

/// Bounds of the millimetres across a slice.
pub const EXTENT_MM: std::ops::RangeInclusive<f64> = 4.0..=2000.0;

/// Kind of output to the export folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Export {
    /// The inside pane as a picture.
    View,
    /// The window as it is seen, with marks, scales and texts.
    Window,
    /// The flight as pictures and, where there is ffmpeg, as a video.
    Flight,
    /// Bookmarks, measurements and figures as a page of HTML.
    Report,
    /// Findings with all their fields, as a table.
    Findings,
}

/// Grey values of a lumen, and where it begins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LumenChoice {
    /// Least and largest value inside.
    pub range: [f64; 2],
    /// A place inside, LPS mm; the largest component that is not the air around the patient
    /// where there is none.
    #[serde(default)]
    pub seed_mm: Option<[f64; 3]>,
}

/// A change of what is shown or noted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Starts or stops the flight.
    TogglePlay,
    /// Turns the direction of the flight.
    Reverse,
    /// Sets the cruising speed, mm/s.
    Speed(f64),
    /// Moves along the path, mm; negative towards its start.
    Travel(f64),
    /// Moves the eye to a place on the path, mm from its start.
    Seek(f64),
    /// Flies along the path to a place on it, mm from its start.
    FlyTo(f64),
    /// Moves the eye off the path: to its right, up and forward, mm. The wall is never passed.
    Fly([f64; 3]),
    /// Turns the eye: right, up, and about its axis clockwise, radians.
    Turn([f32; 3]),
    /// Sets the vertical field of view, degrees.
    FieldOfView(f32),
    /// Returns the eye to the path, level.
    BackToPath,
    /// Flies along the path to the place on it that is nearest to a place, LPS mm.
    GoNear([f64; 3]),
    /// Sets the projection of the inside pane.
    View(WallView),
    /// Sets the quantity that colours the wall.
    Colour(Colouring),
    /// Sets the opacity of the overview's wall: 0 none, 1 as glass, 2 solid.
    Opacity(f32),
    /// Raises the local contrast of the inside view, or leaves it.
    LocalContrast(bool),
    /// Begins to measure, or stops.
    Measure(Option<Ruler>),
    /// Adds a point to what is being measured, LPS mm.
    Mark([f64; 3]),
    /// Adds a point of a slice to the measurement in progress, LPS mm.
    MarkInSlice([f64; 3]),
    /// Names a measurement.
    NameMeasurement(usize, String),
    /// Moves a point of a measurement.
    MoveMark {
        /// Number of the measurement, from 0.
        measurement: usize,
        /// Number of its point, from 0.
        point: usize,
        /// Place of the point, LPS mm.
        to: [f64; 3],
    },
    /// Forgets a measurement.
    RemoveMeasurement(usize),
    /// Turns the overview: about its vertical axis, and towards the viewer, radians.
    Orbit([f32; 2]),
    /// Sets how near the overview shows the organ, and the way of its camera from the organ's
    /// middle, to the right and up, mm.
    Frame {
        /// Enlargement; all of the organ where it is 1 or less.
        zoom: f32,
        /// Shift of the camera to the right and up, mm.
        pan_mm: [f32; 2],
    },
    /// Moves the crosshair of the slices, LPS mm.
    Crosshair([f64; 3]),
    /// Shows a place in the slices, LPS mm, near enough to judge the wall there.
    ShowInSlices([f64; 3]),
    /// Sets how much of the volume the slices show.
    Extent(SliceExtent),
    /// Flies to the place on the path nearest to another place, LPS mm, and looks at that.
    LookAt([f64; 3]),
    /// Sets the window of the slices' grey values: centre and width.
    Window([f64; 2]),
    /// Shows thick slices, or thin ones.
    Slab(Option<SlabMode>),
    /// Sets the thickness of thick slices, mm.
    SlabThickness(f64),
    /// Runs through the slices of the large pane to and fro, or stops.
    Cine(bool),
    /// Fills the window with a pane, or shows all.
    Maximise(Option<Pane>),
    /// Arranges the panes.
    Layout(PaneLayout),
    /// Shows a slice large.
    LargeSlice(Pane),
    /// Shows or hides the panel on the right.
    TogglePanel,
    /// Says whether the path begins at a colon's rectum, or at its caecum.
    RectumAtStart(bool),
    /// Notes the place, with a text.
    Bookmark(String),
    /// Forgets a note.
    RemoveBookmark(usize),
    /// Moves the eye to a noted place.
    GoToBookmark(usize),
    /// Selects a finding, by its index in the list. Lengths measured near the finding belong to it.
    SelectFinding(Option<usize>),
    /// Shows a noted place in the plane of its largest diameter, large, with the window of lungs if the
    /// volume is a CT, and with the ruler ready.
    MeasureInSlice(usize),
    /// Measures the largest diameter of a finding on the wall, as the program finds it.
    MeasureFinding(usize),
    /// Changes a field of a finding.
    EditFinding(usize, FindingEdit),
    /// Moves the eye to the noted place after the selected one.
    NextFinding,
    /// Moves the eye to the noted place before the selected one.
    PreviousFinding,
    /// Moves the eye to the missed patch of the wall after this place of the path that was not shown
    /// since.
    NextMissed,
    /// Moves the eye to the one before.
    PreviousMissed,
    /// Moves the eye to a missed patch, by its rank in area.
    GoToMissed(usize),
    /// Hides the outline of the missed patch.
    HideMissed,
    /// Takes the last change of the notes or of the grey window back.
    Undo,
    /// Makes a change again that was taken back.
    Redo,
    /// Shows or hides the keys.
    ToggleHelp,
    /// Stays with what is open, where notes of it are not saved.
    Stay,
}

/// Work that is asked for: of the session, of a file, of the window itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// Flies on along a branch of the centerline, by its number.
    Branch(usize),
    /// Flies through the tree to the place of it that is nearest to a place, LPS mm, and looks at the
    /// place.
    FlyThrough([f64; 3]),
    /// Writes to the export folder.
    Export(Export),
    /// Opens a file or a DICOM folder instead of what is shown.
    Open(PathBuf),
    /// Opens a session file, with its volume unless that is open.
    OpenSession(PathBuf),
    /// Opens a case that was opened before, by its kept file.
    OpenKept(PathBuf),
    /// Takes the notes of this volume that were kept before.
    TakeKept,
    /// Leaves them.
    LeaveKept,
    /// Takes another lumen of the same volume.
    Lumen(LumenChoice),
    /// Finds an organ in the same volume.
    Organ(Organ),
    /// Finds a colon with its tagged fluid in the same volume.
    TaggedColon,
    /// Flies through the same lumen from this place, LPS mm.
    StartAt([f64; 3]),
    /// Flies through the same lumen to this place, LPS mm.
    EndAt([f64; 3]),
    /// Opens one of several DICOM series of the opened folder, by its index.
    Series(usize),
    /// Opens one of several segments of the opened file, by its name.
    Segment(String),
    /// Stops what is computed or saved.
    Cancel,
    /// Computes on what was stopped.
    Resume,
    /// Saves the notes to this file from now on.
    SaveAs(PathBuf),
    /// Does what waits for an answer, and leaves the notes unsaved.
    Discard,
    /// Opens a case beside this one; the request is one that opens.
    Beside(Box<Request>),
    /// Closes this case, if there is another one beside it.
    CloseCase,
    /// Gives keys and panels to the first or second case, from 0.
    Activate(usize),
    /// Flies the eye of the other case to the same share of its path, from the rectum if both are colons
    /// whose ends are known.
    FindInOther,
    /// Has the eyes of both cases move together along their paths, or each for itself.
    Link(bool),
    /// Closes the window.
    Quit,
}

impl Request {
    /// Whether it leaves the volume that is open, and the notes of it.
    pub fn leaves_volume(&self) -> bool {
        matches!(
            self,
            Self::Quit
                | Self::Open(_)
                | Self::OpenSession(_)
                | Self::OpenKept(_)
                | Self::Series(_)
                | Self::Segment(_)
                | Self::CloseCase
        )
    }

    /// Whether it stops a flight that is being saved. Another lumen of the same volume does: all tasks of
    /// the present lumen end.
    pub fn ends_saving(&self) -> bool {
        let changes_lumen = matches!(
            self,
            Self::Lumen(_) | Self::Organ(_) | Self::TaggedColon | Self::StartAt(_) | Self::EndAt(_)
        );
        changes_lumen || self.leaves_volume()
    }
}

/// An action or a request, as scripts write them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Command {
    /// Changes what is shown or noted.
    Action(Action),
    /// Asks for work.
    Request(Request),
}

/// Commands of one frame, in their order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActionQueue {
    /// Changes of what is shown or noted.
    pub actions: Vec<Action>,
    /// Work that is asked for.
    pub requests: Vec<Request>,
}

impl From<Command> for ActionQueue {
    fn from(command: Command) -> Self {
        match command {
            Command::Action(action) => Self { actions: vec![action], ..Self::default() },
            Command::Request(request) => Self { requests: vec![request], ..Self::default() },
        }
    }
}

impl ActionQueue {
    /// Adds an action.
    pub fn act(&mut self, action: Action) {
        self.actions.push(action);
    }

    /// Adds a request.
    pub fn ask(&mut self, request: Request) {
        self.requests.push(request);
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty() && self.requests.is_empty()
    }
}
