//! `intima bids`: a cohort as a BIDS-App.

mod case;
mod engine;

use std::path::{Path, PathBuf};

use serde_json::json;

use super::CliError;
use super::centerline::PathArgs;
use super::frames::FrameArgs;
use super::global::Global;
use super::lumen_args::LumenArgs;
use super::mode::ModeArg;
use super::session_args::SessionArgs;
use super::surface_args::SurfaceArgs;
use crate::cohort::{
    Case, CaseNames, CaseState, Check, Dataset, Pattern, QualityTable, Recipe, Selection, build_id,
    find_cases, quality_page,
};
use crate::device::DeviceChoice;
use crate::formats::{atomic_file, shown};
use crate::session::Settings;

/// `intima bids BIDS_DIR OUT_DIR participant|group`
#[derive(Debug, clap::Args)]
#[command(version)]
pub struct Args {
    /// BIDS dataset, or a folder of DICOM folders and volumes; only read
    ///
    /// With dataset_description.json in it every sub-*/**/*_CT.nii[.gz] is a case, named by its
    /// entities. Without, every folder and every volume directly in it is one, named by the letters
    /// and digits of the folder or file. --pattern finds others.
    bids_dir: PathBuf,
    /// Folder for derivatives, records and the quality table; made if it is not there
    out_dir: PathBuf,
    /// participant runs every case that is not done yet; group makes quality.tsv and quality.html
    #[arg(value_enum)]
    level: Level,
    /// Take these participants alone, with or without sub-
    #[arg(long, alias = "participant_label", value_name = "LABEL", num_args = 1..)]
    participant_label: Vec<String>,
    /// Take these sessions alone, with or without ses-
    #[arg(long, alias = "session_label", value_name = "LABEL", num_args = 1..)]
    session_label: Vec<String>,
    /// Take these cases alone, by the names that --list shows
    #[arg(long, value_name = "NAME", num_args = 1..)]
    case: Vec<String>,
    /// Files and folders that are cases: a path below BIDS_DIR with * and ?, ** for folders
    #[arg(long, value_name = "PATTERN")]
    pattern: Option<Pattern>,
    /// Names of cases that have no BIDS name: hash where folders may have the names of patients
    #[arg(long, value_enum, default_value = "folder")]
    case_names: CaseNames,
    /// Does nothing: the dataset is never validated
    #[arg(long, alias = "skip_bids_validation")]
    skip_bids_validation: bool,
    /// Folder for files on the way (default: within OUT_DIR)
    #[arg(short, long, alias = "work_dir", value_name = "DIR")]
    work_dir: Option<PathBuf>,
    /// Check before a case counts as done: sizes of its files, or with verify all bytes; off runs
    /// every case again
    #[arg(long, value_enum, default_value = "quick", value_name = "CHECK")]
    resume: Check,
    /// Cases that run at a time, each with its share of the threads
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=256))]
    jobs: u32,
    /// List the cases and whether each is done; run nothing
    #[arg(long)]
    list: bool,
    /// The one case that this process runs: how a cohort starts itself for each case.
    #[arg(long, hide = true)]
    only_case: Option<String>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Level {
    Participant,
    Group,
}

/// A number of cases in words.
fn counted_cases(count: usize) -> String {
    format!("{count} case{}", if count == 1 { "" } else { "s" })
}

/// Flags of a run that are the same for all cases.
#[derive(Clone, Debug, clap::Args)]
struct RunArgs {
    #[command(flatten)]
    mode: ModeArg,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    path: PathArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl RunArgs {
    /// The flags of `run` for one input.
    fn session_args(&self, input: &Path, out: &Path) -> SessionArgs {
        let Self { mode, frames, path, surface, lumen } = self.clone();
        let (input, out) = (Some(input.to_owned()), out.to_owned());
        SessionArgs { input, out, mode, frames, path, surface, lumen }
    }

    /// Refuses flags that name one file, which cannot be that of every case.
    fn check(&self) -> Result<(), CliError> {
        let (f, l) = (&self.frames, &self.lumen);
        let given = [
            ("--mask", l.mask.is_some()),
            ("--core", l.core.is_some()),
            ("--explain", l.explain.is_some()),
            ("--video", f.video.is_some()),
            ("--path", f.path.is_some()),
            ("--write-path", f.write_path.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            Some((flag, _)) => {
                Err(CliError::Usage(format!("{flag}: one file cannot be that of every case")))
            }
            None => Ok(()),
        }
    }

    /// Everything beside the input that decides the outputs of a case.
    fn recipe(&self, global: &Global) -> Result<Recipe, CliError> {
        // The input's name is in no setting.
        let session = self.session_args(Path::new("input"), Path::new("out")).session(global)?;
        let all = session.settings().clone();
        let settings = Settings {
            threads: None,
            max_memory_mb: None,
            device: DeviceChoice::Auto,
            levels: all.levels,
            ..all
        };
        let settings = format!("{settings:?} {:?}", self.lumen.dicom.options());
        Ok(Recipe { build: build_id(), settings, device: global.device.to_string() })
    }
}

impl Args {
    /// Runs the cases, or makes the table.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        if global.repeat.is_some() {
            return Err(CliError::Usage("--repeat: times one run, not a cohort".into()));
        }
        self.run.check()?;
        let dataset = Dataset::open(&self.out_dir, &self.bids_dir)?;
        match (self.level, &self.only_case) {
            (Level::Group, _) => self.group(global, &dataset),
            (Level::Participant, Some(name)) => self.run_case(global, &dataset, name),
            (Level::Participant, None) => self.participant(global, &dataset),
        }
    }

    /// The cases that are wanted.
    fn cases(&self) -> Result<Vec<Case>, CliError> {
        let selection = Selection {
            pattern: self.pattern.clone(),
            participants: self.participant_label.clone(),
            sessions: self.session_label.clone(),
            cases: self.case.clone(),
            names: self.case_names,
        };
        Ok(find_cases(&self.bids_dir, &self.out_dir, &selection)?)
    }

    /// Folder in which a case is worked on.
    fn work_folder(&self, dataset: &Dataset, case: &Case) -> PathBuf {
        match &self.work_dir {
            // A name that nothing but this program gives, as the folder is emptied.
            Some(folder) => folder.join(format!("intima-{}", case.name)),
            None => dataset.logs(&case.name).join("work"),
        }
    }

    /// Makes `quality.tsv` and `quality.html` of the cases there are and of those that have records.
    fn group(&self, global: &Global, dataset: &Dataset) -> Result<(), CliError> {
        let mut names: Vec<String> = self.cases()?.into_iter().map(|c| c.name).collect();
        let lists = [&self.participant_label, &self.session_label, &self.case];
        if lists.iter().all(|list| list.is_empty()) {
            names.extend(dataset.recorded());
            names.sort();
            names.dedup();
        }
        dataset.describe(&self.bids_dir, self.case_names)?;
        let table = QualityTable::read(dataset, &names);
        let page = quality_page(dataset, &table);
        for (name, text) in [("quality.tsv", table.tsv()), ("quality.html", page)] {
            let path = dataset.folder.join(name);
            atomic_file::write_atomic(&path, |o| o.write_all(text.as_bytes()))?;
            global.say(format_args!("wrote {}", shown(&path)))?;
        }
        let count = |state| table.count(state);
        let [done, failed, missing] =
            [CaseState::Done, CaseState::Failed, CaseState::Missing].map(count);
        global.say(format_args!(
            "{}: {done} done, {failed} failed, {missing} missing",
            counted_cases(names.len())
        ))?;
        global.answer(&json!({ "done": done, "failed": failed, "missing": missing }))
    }
}
