//! A script drives the window without one: the same panels, actions and pictures, on an image and
//! on a clock of its own, so that pictures depend on the input alone.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::action::{ActionQueue, Command};
use super::canvas::Target;
use super::error::AppError;
use super::panes::Detail;
use super::viewer::{Viewer, ViewerOptions};
use crate::formats::{FormatError, read_plain, write_png};
use crate::session::Product;
use crate::vk::{BufferId, Format, Frame, Gpu, ImageId, ImageSpec};

/// Name and version of the format.
pub const SCRIPT_SCHEMA: &str = "intima.script/1";
/// Most frames of a script, and of one step.
const MAX_FRAMES: u32 = 1_000_000;

/// Condition that a script waits for.
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

/// Samples a pixel of the drawn panes, at most.
const MAX_SAMPLES: u32 = 4;

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

/// Plays a script; returns the pictures it wrote, in order. They and what is exported go to the
/// export folder, which is made if it is not there.
///
/// # Errors
/// [`AppError`].
pub fn play(
    gpu: &mut Gpu,
    options: ViewerOptions,
    script: &Script,
) -> Result<Vec<PathBuf>, AppError> {
    std::fs::create_dir_all(&options.export).map_err(|e| FormatError::io(&options.export, e))?;
    let mut player = Player::new(gpu, options, script)?;
    for (i, step) in script.steps.iter().enumerate() {
        player.step(gpu, i + 1, step)?;
        if player.has_quit {
            break;
        }
    }
    player.viewer.close()?;
    Ok(player.pictures)
}

struct Player<'a> {
    script: &'a Script,
    folder: PathBuf,
    viewer: Viewer,
    image: ImageId,
    back: BufferId,
    frame: u64,
    pointer: egui::Pos2,
    events: Vec<egui::Event>,
    modifiers: egui::Modifiers,
    pictures: Vec<PathBuf>,
    has_quit: bool,
}

impl<'a> Player<'a> {
    fn new(gpu: &mut Gpu, options: ViewerOptions, script: &'a Script) -> Result<Self, AppError> {
        let spec = ImageSpec { format: Format::Rgba8Stored, extent: script.size, samples: 1 };
        let image = gpu.image("window", spec)?;
        let pixels = u64::from(script.size[0]) * u64::from(script.size[1]);
        let back = gpu.readback_buffer("window", 4 * pixels)?;
        let samples = MAX_SAMPLES.min(gpu.info().max_samples);
        Ok(Self {
            script,
            folder: options.export.clone(),
            viewer: Viewer::new(gpu, options, (Detail::Settled, samples), || {})?,
            image,
            back,
            frame: 0,
            pointer: egui::Pos2::ZERO,
            events: Vec::new(),
            modifiers: egui::Modifiers::NONE,
            pictures: Vec::new(),
            has_quit: false,
        })
    }

    fn step(&mut self, gpu: &mut Gpu, number: usize, step: &ScriptStep) -> Result<(), AppError> {
        let key = |name: &str| egui::Key::from_name(name).expect("checked when it was read");
        let primary = egui::PointerButton::Primary;
        match step {
            ScriptStep::Wait(wait) => self.wait(gpu, number, *wait)?,
            ScriptStep::Do(command) => self.draw(gpu, command.clone().into())?,
            ScriptStep::Frames(n) => (0..*n).try_for_each(|_| self.frame(gpu))?,
            ScriptStep::Key(name) => {
                self.key(key(name), true);
                self.frame(gpu)?;
                self.key(key(name), false);
                self.frame(gpu)?;
            }
            ScriptStep::Hold(name, n) => {
                self.key(key(name), true);
                (0..*n).try_for_each(|_| self.frame(gpu))?;
                self.key(key(name), false);
                self.frame(gpu)?;
            }
            ScriptStep::Type(text) => {
                self.events.push(egui::Event::Text(text.clone()));
                self.frame(gpu)?;
            }
            ScriptStep::Pointer(to) => {
                self.move_to(*to);
                self.frame(gpu)?;
            }
            ScriptStep::Click => {
                self.button(primary, true);
                self.frame(gpu)?;
                self.button(primary, false);
                self.frame(gpu)?;
            }
            ScriptStep::Drag(to) => {
                const PARTS: u16 = 8;
                let from = self.pointer;
                self.button(primary, true);
                self.frame(gpu)?;
                for i in 1..=PARTS {
                    let at = from.lerp(egui::Pos2::from(*to), f32::from(i) / f32::from(PARTS));
                    self.move_to([at.x, at.y]);
                    self.frame(gpu)?;
                }
                self.button(primary, false);
                self.frame(gpu)?;
            }
            ScriptStep::Wheel(notches) => {
                self.events.push(egui::Event::MouseWheel {
                    unit: egui::MouseWheelUnit::Line,
                    delta: egui::vec2(0.0, *notches),
                    phase: egui::TouchPhase::Move,
                    modifiers: self.modifiers,
                });
                self.frame(gpu)?;
            }
            ScriptStep::Picture(name) => {
                // What the last frame changed shows in the next.
                self.frame(gpu)?;
                self.write(gpu, &format!("{name}.png"))?;
            }
        }
        Ok(())
    }

    /// Has products computed and takes in those up to the one that is waited for.
    fn wait(&mut self, gpu: &mut Gpu, number: usize, wait: Wait) -> Result<(), AppError> {
        let case = self.viewer.active();
        let model = &case.model;
        let comes = match wait {
            Wait::Failure if model.failure.is_some() || model.question.is_some() => true,
            Wait::Failure => case.wait_for_failure(gpu)?,
            Wait::Complete if model.is_complete => true,
            Wait::Complete => case.wait_for(gpu, Product::Coverage)?,
            Wait::Volume => case.wait_for(gpu, Product::ValueRange)?,
            Wait::Wall => case.wait_for(gpu, Product::PreparedWall)?,
            Wait::Distance => case.wait_for(gpu, Product::Fields)?,
            Wait::Flight => case.wait_for(gpu, Product::Flight)?,
            Wait::Levels => case.wait_for(gpu, Product::Levels)?,
        };
        if comes {
            return case.apply_notes(gpu);
        }
        let what = "what it waits for does not come".into();
        Err(AppError::Script { step: number, what })
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

    /// A frame without commands but those of keys and pointer.
    fn frame(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        self.draw(gpu, ActionQueue::default())
    }

    /// One frame of the script's clock.
    fn draw(&mut self, gpu: &mut Gpu, commands: ActionQueue) -> Result<(), AppError> {
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
        let target = Target { image: self.image, format: Format::Rgba8Stored };
        let back = (self.image, self.back);
        let end = self.viewer.frame(gpu, input, commands, dt, &target, |gpu, frame| {
            let frame = Frame { picture: Some(back), ..frame.clone() };
            gpu.make_room(frame.staged_bytes())?;
            gpu.submit_draws(&frame)
        })?;
        self.has_quit |= end.quit;
        self.frame += 1;
        self.viewer.save_notes()?;
        if self.script.every_frame {
            self.write(gpu, &format!("frame_{:05}.png", self.frame))?;
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
        let path = self.folder.join(name);
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
        assert_eq!(read.steps[2], ScriptStep::Do(Command::Action(Action::Seek(12.5))));
        assert_eq!(read.steps[3], ScriptStep::Do(Command::Request(Request::Branch(2))));
        assert_eq!(read.steps[4], ScriptStep::Do(Command::Request(Request::Quit)));
        let error = |steps| script(steps).unwrap_err().to_string();
        assert_eq!(
            error(r#"{"frames": 1}, {"jump": 3}"#),
            "step 2 of the script: no step that there is"
        );
        assert_eq!(error(r#"{"key": "Nope"}"#), "step 1 of the script: there is no key \"Nope\"");
        assert!(error(r#"{"picture": "../x"}"#).ends_with("letters, digits, - and _"));
        assert!(error(r#"{"frames": 99000000}"#).contains("more than"));
        let newer = Script::parse(br#"{"schema": "intima.script/2", "steps": []}"#).unwrap_err();
        assert!(newer.to_string().contains("newer version"), "{newer}");
        assert!(Script::parse(b"{").unwrap_err().to_string().contains("no JSON (line 1"));
    }
}
