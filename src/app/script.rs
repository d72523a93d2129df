//! A script drives the window without one: the same panels, actions and pictures, on an image and
//! on a clock of its own, so that pictures depend on the input alone.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::action::{Command, Commands};
use super::error::AppError;
use super::panes::Detail;
use super::session_file::SessionFile;
use super::stage::{After, Files, Stage, Target};
use super::study::{Case, News, Study};
use crate::formats::{FormatError, read_plain, write_png};
use crate::lod::Tolerance;
use crate::vk::{BufferId, Format, Frame, Gpu, ImageId, ImageSpec};

/// Name and version of the format.
pub const SCRIPT_SCHEMA: &str = "intima.script/1";
/// Most frames of a script, and of one step.
const MAX_FRAMES: u32 = 1_000_000;

/// Longest time that a script waits for anything.
const MAX_WAIT: Duration = Duration::from_secs(3600);

/// What a script waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wait {
    /// The slices.
    Volume,
    /// The first picture of the wall.
    Wall,
    /// The eye can be moved by hand.
    Distance,
    /// The path is known.
    Flight,
    /// Levels of detail are there.
    Levels,
    /// Everything is computed.
    Complete,
    /// Nothing more comes: the reason is shown.
    Failure,
}

/// A step of a script.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ScriptStep {
    /// Waits; no time passes on the script's clock.
    Wait(Wait),
    /// Carries out a command in the next frame, which it draws.
    Do(Command),
    /// Draws so many frames.
    Frames(u32),
    /// Presses and releases a key, as egui names it (`Space`, `B`, `ArrowUp`).
    Key(String),
    /// Holds a key for so many frames.
    Hold(String, u32),
    /// Types a text.
    Type(String),
    /// Moves the pointer, points from the top left.
    Pointer([f32; 2]),
    /// Clicks where the pointer is.
    Click,
    /// Drags from where the pointer is to there.
    Drag([f32; 2]),
    /// Turns the wheel by notches.
    Wheel(f32),
    /// Writes the window as a picture of this name.
    Picture(String),
}

/// A script.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// Name and version of the format.
    pub schema: String,
    /// Columns and rows of the window.
    #[serde(default = "default_size")]
    pub size: [u32; 2],
    /// Frames a second of the script's clock.
    #[serde(default = "default_fps")]
    pub fps: f64,
    /// Pixels a point.
    #[serde(default = "default_scale")]
    pub scale: f32,
    /// Whether every frame is written, as `frame_00001.png`.
    #[serde(default)]
    pub every_frame: bool,
    /// In order.
    pub steps: Vec<ScriptStep>,
}

fn default_size() -> [u32; 2] {
    [1280, 720]
}

fn default_fps() -> f64 {
    30.0
}

fn default_scale() -> f32 {
    1.0
}

impl Script {
    /// Reads and checks a script.
    ///
    /// # Errors
    /// [`AppError::Script`] with the step that is wrong; [`AppError::Format`].
    pub fn read(path: &Path) -> Result<Self, AppError> {
        const MAX_BYTES: u64 = 16 << 20;
        Self::parse(&read_plain(path, MAX_BYTES + 1)?)
    }

    /// Checks the text of a script.
    ///
    /// # Errors
    /// [`AppError::Script`].
    pub fn parse(bytes: &[u8]) -> Result<Self, AppError> {
        let bad = |step, what: String| AppError::Script { step, what };
        let json: serde_json::Value = serde_json::from_slice(bytes)
            .map_err(|e| bad(0, format!("no JSON (line {}, column {})", e.line(), e.column())))?;
        let schema = json.get("schema").and_then(|s| s.as_str()).unwrap_or_default();
        if schema != SCRIPT_SCHEMA {
            let newer = schema.starts_with("intima.script/");
            let why = if newer { "made for a newer version of intima" } else { "no script" };
            return Err(bad(0, format!("{why}: its schema is not {SCRIPT_SCHEMA}")));
        }
        // One by one, so that the wrong step is named.
        let steps = json.get("steps").and_then(|s| s.as_array()).cloned().unwrap_or_default();
        for (i, step) in steps.iter().enumerate() {
            let parsed = serde_json::from_value::<ScriptStep>(step.clone());
            parsed.map_err(|_| bad(i + 1, "no step that there is".into()))?.check(i + 1)?;
        }
        let script: Self = serde_json::from_value(json)
            .map_err(|_| bad(0, "a field is unknown or wrong".into()))?;
        let sides = script.size.iter().all(|s| (64..=8192).contains(s));
        let rate = (0.1..=1000.0).contains(&script.fps) && (0.5..=8.0).contains(&script.scale);
        if !sides || !rate {
            return Err(bad(0, "size is 64 to 8192, fps 0.1 to 1000, scale 0.5 to 8".into()));
        }
        Ok(script)
    }
}

impl ScriptStep {
    fn check(&self, step: usize) -> Result<(), AppError> {
        let bad = |what: String| Err(AppError::Script { step, what });
        match self {
            Self::Key(name) | Self::Hold(name, _) if egui::Key::from_name(name).is_none() => {
                bad(format!("there is no key {name:?}"))
            }
            Self::Frames(n) | Self::Hold(_, n) if *n > MAX_FRAMES => {
                bad(format!("more than {MAX_FRAMES} frames"))
            }
            Self::Picture(name) if !is_plain_name(name) => {
                bad("a picture's name is letters, digits, - and _".into())
            }
            _ => Ok(()),
        }
    }
}

fn is_plain_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    !name.is_empty() && name.len() <= 100 && name.chars().all(plain)
}

/// What a script is played with.
pub struct Playing<'a> {
    /// Where pictures go; made if it is not there.
    pub folder: &'a Path,
    /// Notes to begin with, and where bookmarks are saved.
    pub session_file: Option<PathBuf>,
    /// Speed the session's flight is planned with, mm/s.
    pub planned_mm_s: f64,
    /// Samples a pixel.
    pub samples: u32,
    /// Of levels of detail.
    pub tolerance: Tolerance,
}

/// Plays a script; returns the pictures it wrote, in order.
///
/// # Errors
/// [`AppError`].
pub fn play(
    gpu: &mut Gpu,
    case: Case,
    script: &Script,
    with: &Playing<'_>,
) -> Result<Vec<PathBuf>, AppError> {
    std::fs::create_dir_all(with.folder).map_err(|e| FormatError::io(with.folder, e))?;
    let notes = with.session_file.as_deref().filter(|p| p.exists());
    let notes = notes.map(SessionFile::read).transpose()?;
    let mut player = Player::new(gpu, case, script, with)?;
    for (i, step) in script.steps.iter().enumerate() {
        player.step(gpu, i + 1, step, notes.as_ref())?;
        if player.has_quit {
            break;
        }
    }
    player.save()?;
    Ok(player.pictures)
}

struct Player<'a> {
    script: &'a Script,
    with: &'a Playing<'a>,
    stage: Stage,
    case: Case,
    study: Option<Study>,
    image: ImageId,
    back: BufferId,
    frame: u64,
    pointer: egui::Pos2,
    events: Vec<egui::Event>,
    modifiers: egui::Modifiers,
    pictures: Vec<PathBuf>,
    has_quit: bool,
    has_notes: bool,
}

impl<'a> Player<'a> {
    fn new(
        gpu: &mut Gpu,
        case: Case,
        script: &'a Script,
        with: &'a Playing<'a>,
    ) -> Result<Self, AppError> {
        let spec = ImageSpec { format: Format::Rgba8Stored, extent: script.size, samples: 1 };
        let image = gpu.image("window", spec)?;
        let pixels = u64::from(script.size[0]) * u64::from(script.size[1]);
        let back = gpu.readback_buffer("window", 4 * pixels)?;
        Ok(Self {
            script,
            with,
            stage: Stage::new(
                gpu,
                with.samples,
                with.planned_mm_s,
                with.tolerance,
                Files { session: with.session_file.clone(), export: with.folder.to_owned() },
                || {},
            )?,
            study: case.begin(|| {})?,
            case,
            image,
            back,
            frame: 0,
            pointer: egui::Pos2::ZERO,
            events: Vec::new(),
            modifiers: egui::Modifiers::NONE,
            pictures: Vec::new(),
            has_quit: false,
            has_notes: false,
        })
    }

    fn step(
        &mut self,
        gpu: &mut Gpu,
        number: usize,
        step: &ScriptStep,
        notes: Option<&SessionFile>,
    ) -> Result<(), AppError> {
        let key = |name: &str| egui::Key::from_name(name).expect("checked when it was read");
        let primary = egui::PointerButton::Primary;
        match step {
            ScriptStep::Wait(wait) => self.wait(gpu, number, *wait, notes)?,
            ScriptStep::Do(command) => self.command(gpu, command.clone())?,
            ScriptStep::Frames(n) => {
                (0..*n).try_for_each(|_| self.draw(gpu, Commands::default()))?
            }
            ScriptStep::Key(name) => {
                self.key(key(name), true);
                self.draw(gpu, Commands::default())?;
                self.key(key(name), false);
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Hold(name, n) => {
                self.key(key(name), true);
                (0..*n).try_for_each(|_| self.draw(gpu, Commands::default()))?;
                self.key(key(name), false);
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Type(text) => {
                self.events.push(egui::Event::Text(text.clone()));
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Pointer(to) => {
                self.move_to(*to);
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Click => {
                self.button(primary, true);
                self.draw(gpu, Commands::default())?;
                self.button(primary, false);
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Drag(to) => {
                const PARTS: u16 = 8;
                let from = self.pointer;
                self.button(primary, true);
                self.draw(gpu, Commands::default())?;
                for i in 1..=PARTS {
                    let at = from.lerp(egui::Pos2::from(*to), f32::from(i) / f32::from(PARTS));
                    self.move_to([at.x, at.y]);
                    self.draw(gpu, Commands::default())?;
                }
                self.button(primary, false);
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Wheel(notches) => {
                self.events.push(egui::Event::MouseWheel {
                    unit: egui::MouseWheelUnit::Line,
                    delta: egui::vec2(0.0, *notches),
                    phase: egui::TouchPhase::Move,
                    modifiers: self.modifiers,
                });
                self.draw(gpu, Commands::default())?;
            }
            ScriptStep::Picture(name) => {
                // What the last frame changed shows in the next.
                self.draw(gpu, Commands::default())?;
                self.write(gpu, &format!("{name}.png"))?;
            }
        }
        Ok(())
    }

    /// Takes products in until the one that is waited for has come.
    fn wait(
        &mut self,
        gpu: &mut Gpu,
        number: usize,
        wait: Wait,
        notes: Option<&SessionFile>,
    ) -> Result<(), AppError> {
        loop {
            let model = &self.stage.model;
            let p = &model.products;
            let there = match wait {
                Wait::Volume => p.volume.is_some(),
                Wait::Wall => p.wall.is_some(),
                Wait::Distance => p.fields.is_some(),
                Wait::Flight => model.path.is_some(),
                Wait::Levels => p.levels.is_some(),
                Wait::Complete => model.is_complete,
                Wait::Failure => model.failure.is_some(),
            };
            if there {
                return self.apply(notes);
            }
            let Some(news) = self.study.as_ref().and_then(|s| s.wait(MAX_WAIT)) else {
                let what = "what it waits for does not come".into();
                return Err(AppError::Script { step: number, what });
            };
            match news {
                News::Failed(e) if wait != Wait::Failure => return Err(e.into()),
                news => self.stage.learn(gpu, news)?,
            }
        }
    }

    /// Notes of an earlier session, once the volume is known.
    fn apply(&mut self, notes: Option<&SessionFile>) -> Result<(), AppError> {
        let Some(notes) = notes.filter(|_| !self.has_notes) else { return Ok(()) };
        if self.stage.model.identity.is_some() {
            self.has_notes = true;
            notes.apply(&mut self.stage.model).map_err(|what| {
                let path = self.with.session_file.clone().unwrap_or_default();
                AppError::SessionFile { path, what }
            })?;
        }
        Ok(())
    }

    fn key(&mut self, key: egui::Key, pressed: bool) {
        let modifiers = self.modifiers;
        self.events.push(egui::Event::Key {
            key,
            physical_key: None,
            pressed,
            repeat: false,
            modifiers,
        });
    }

    fn button(&mut self, button: egui::PointerButton, pressed: bool) {
        let (pos, modifiers) = (self.pointer, self.modifiers);
        self.events.push(egui::Event::PointerButton { pos, button, pressed, modifiers });
    }

    fn move_to(&mut self, to: [f32; 2]) {
        self.pointer = egui::Pos2::from(to);
        self.events.push(egui::Event::PointerMoved(self.pointer));
    }

    fn command(&mut self, gpu: &mut Gpu, command: Command) -> Result<(), AppError> {
        let mut commands = Commands::default();
        commands.push(command);
        self.draw(gpu, commands)
    }

    /// One frame of the script's clock.
    fn draw(&mut self, gpu: &mut Gpu, commands: Commands) -> Result<(), AppError> {
        let dt = 1.0 / self.script.fps;
        let [width, height] = self.script.size.map(|s| s as f32 / self.script.scale);
        let mut input = egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(
                egui::Pos2::ZERO,
                egui::vec2(width, height),
            )),
            time: Some(self.frame as f64 * dt),
            predicted_dt: dt as f32,
            events: std::mem::take(&mut self.events),
            focused: true,
            ..Default::default()
        };
        if let Some(viewport) = input.viewports.get_mut(&egui::ViewportId::ROOT) {
            viewport.native_pixels_per_point = Some(self.script.scale);
        }
        let clock = (dt, Detail::Settled);
        let (output, after) =
            self.stage.prepare(gpu, input, commands, self.study.as_ref(), clock)?;
        let target = Target { image: self.image, format: Format::Rgba8Stored };
        let back = (self.image, self.back);
        self.stage.draw(gpu, &target, output, |gpu, frame| {
            let frame = Frame { picture: Some(back), ..frame.clone() };
            gpu.make_room(frame.staged_bytes())?;
            gpu.submit_draws(&frame)
        })?;
        self.follow(gpu, &after)?;
        self.has_quit |= after.quit;
        self.frame += 1;
        self.save()?;
        if self.script.every_frame {
            self.write(gpu, &format!("frame_{:05}.png", self.frame))?;
        }
        Ok(())
    }

    /// Does what a frame asked for; it is there before the next frame.
    fn follow(&mut self, gpu: &mut Gpu, after: &After) -> Result<(), AppError> {
        if let Some(change) = after.change.clone() {
            self.case.change(change, self.stage.model.products.volume.clone());
            self.study = None;
            self.stage.begin_anew(gpu)?;
            self.study = self.case.begin(|| {})?;
        }
        let Some(study) = &mut self.study else { return Ok(()) };
        if after.cancel {
            study.cancel();
        }
        if let Some(route) = after.route {
            study.fly_along(route)?;
            let planned = |n: &News| match n {
                News::Flight(_, of) => *of == route,
                News::Said(_) => true,
                _ => false,
            };
            self.wait_for(gpu, planned)?;
        }
        if let (Some(study), Some(folder)) = (&mut self.study, after.export_flight.clone()) {
            study.export_flight(folder)?;
            self.wait_for(gpu, |n| matches!(n, News::Said(_)))?;
        }
        Ok(())
    }

    /// Takes news in until some have come.
    fn wait_for(&mut self, gpu: &mut Gpu, wanted: impl Fn(&News) -> bool) -> Result<(), AppError> {
        while let Some(news) = self.study.as_ref().and_then(|s| s.wait(MAX_WAIT)) {
            let is_last = wanted(&news);
            self.stage.learn(gpu, news)?;
            if is_last {
                break;
            }
        }
        Ok(())
    }

    /// Saves bookmarks that were made.
    fn save(&mut self) -> Result<(), AppError> {
        let Some(path) = &self.with.session_file else { return Ok(()) };
        if self.stage.model.has_unsaved_notes()
            && let Some(file) = SessionFile::of(&self.stage.model)
        {
            file.write(path)?;
            self.stage.model.notes_saved();
        }
        Ok(())
    }

    fn write(&mut self, gpu: &mut Gpu, name: &str) -> Result<(), AppError> {
        let [width, height] = self.script.size;
        let pixels = (width * height) as usize;
        let rgb: Vec<u8> = gpu.read(self.back)?[..4 * pixels]
            .chunks_exact(4)
            .flat_map(|p| [p[0], p[1], p[2]])
            .collect();
        let path = self.with.folder.join(name);
        write_png(&path, width, height, &rgb)?;
        self.pictures.push(path);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::{Action, Request};
    use super::*;

    fn script(steps: &str) -> Result<Script, AppError> {
        let text = format!(r#"{{"schema": "intima.script/1", "steps": [{steps}]}}"#);
        Script::parse(text.as_bytes())
    }

    #[test]
    fn a_script_is_read_and_a_wrong_step_is_named() {
        let steps = r#"{"wait": "flight"}, {"do": "toggle_play"}, {"do": {"seek": 12.5}},
            {"do": {"branch": 2}}, {"do": "quit"}, {"frames": 30}, {"key": "Space"}, {"hold": ["W", 10]},
            {"picture": "a-1"}"#;
        let read = script(steps).unwrap();
        assert_eq!((read.steps.len(), read.size, read.fps), (9, [1280, 720], 30.0));
        assert_eq!(read.steps[2], ScriptStep::Do(Action::Seek(12.5).into()));
        assert_eq!(read.steps[3], ScriptStep::Do(Request::Branch(2).into()));
        assert_eq!(read.steps[4], ScriptStep::Do(Request::Quit.into()));
        let said = |steps| script(steps).unwrap_err().to_string();
        assert_eq!(
            said(r#"{"frames": 1}, {"jump": 3}"#),
            "step 2 of the script: no step that there is"
        );
        assert_eq!(said(r#"{"key": "Nope"}"#), "step 1 of the script: there is no key \"Nope\"");
        assert!(said(r#"{"picture": "../x"}"#).ends_with("letters, digits, - and _"));
        assert!(said(r#"{"frames": 99000000}"#).contains("more than"));
        let newer = Script::parse(br#"{"schema": "intima.script/2", "steps": []}"#).unwrap_err();
        assert!(newer.to_string().contains("newer version"), "{newer}");
        assert!(Script::parse(b"{").unwrap_err().to_string().contains("no JSON (line 1"));
    }
}
