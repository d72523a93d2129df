//! One case of a cohort, in a process of its own: what ends it ends no other, and its peak of memory
//! is its own.

use std::fs::{File, OpenOptions};
use std::io::Read as _;
use std::path::Path;
use std::time::Instant;

use super::Args;
use crate::cli::global::Global;
use crate::cli::{CliError, run};
use crate::cohort::{Case, CaseStatus, Dataset, OutputFile, Recipe, clear_outputs, place_outputs};
use crate::formats::{FormatError, atomic_file, shown};

/// Lock of a case, held until dropped or until its process ends, however that ends. A file opened
/// for writing, unlike the folder that a run locks: network file systems lock nothing else.
pub struct CaseLock(#[expect(dead_code, reason = "holds the lock")] File);

impl CaseLock {
    /// Waits until nobody else has the case. Where the file system has no locks, it is not waited.
    pub fn wait(dataset: &Dataset, case: &str) -> Result<Self, FormatError> {
        let (file, path) = open(dataset, case)?;
        if let Err(e) = file.lock() {
            tracing::warn!("{}: cannot be locked: {e}", shown(&path));
        }
        Ok(Self(file))
    }

    /// Whether somebody else has the case.
    pub fn is_held(dataset: &Dataset, case: &str) -> Result<bool, FormatError> {
        let (file, _) = open(dataset, case)?;
        Ok(matches!(file.try_lock(), Err(std::fs::TryLockError::WouldBlock)))
    }
}

fn open(dataset: &Dataset, case: &str) -> Result<(File, std::path::PathBuf), FormatError> {
    let folder = dataset.logs(case);
    std::fs::create_dir_all(&folder).map_err(|e| FormatError::io(&folder, e))?;
    let path = folder.join("lock");
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
    Ok((file.map_err(|e| FormatError::io(&path, e))?, path))
}

/// Ends this process, nothing partial left, when the one that started it has ended: its standard
/// input ends then. So a killed cohort leaves nobody who works on.
fn end_with_parent() {
    std::thread::spawn(|| {
        let mut byte = [0];
        while std::io::stdin().read(&mut byte).is_ok_and(|n| n > 0) {}
        atomic_file::discard_unfinished();
        crate::vk::exit_now(130);
    });
}

impl Args {
    /// Runs one case unless it is done, and writes how it ended.
    pub(super) fn run_case(
        &self,
        global: &Global,
        dataset: &Dataset,
        name: &str,
    ) -> Result<(), CliError> {
        end_with_parent();
        let cases = self.cases()?;
        let case = cases.iter().find(|c| c.name == name);
        let case = case.ok_or_else(|| CliError::Input(format!("{name}: is no longer there")))?;
        let recipe = self.run.recipe(global)?;
        let _lock = CaseLock::wait(dataset, name)?;
        let since = Instant::now();
        let mut status = self.begun(&recipe, case);
        let outcome = match self.work(global, dataset, case, &recipe, &mut status) {
            Ok(None) => return Ok(()),
            Ok(Some(outputs)) => {
                status.outputs = outputs;
                Ok(())
            }
            Err(e) => {
                status.exit_code = i32::from(e.exit_code());
                status.reason = Some(e.reason());
                status.error = self.told(case, &e.to_string());
                Err(e)
            }
        };
        status.seconds = since.elapsed().as_secs_f64();
        status.write(&dataset.status(name))?;
        outcome
    }

    /// A status with what is known before a case is run.
    pub(super) fn begun(&self, recipe: &Recipe, case: &Case) -> CaseStatus {
        let Recipe { build, settings, device } = recipe.clone();
        CaseStatus {
            case: case.name.clone(),
            source: case.source.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build,
            settings,
            device,
            ..CaseStatus::default()
        }
    }

    /// A message for the record: the name of the case in place of its path, and nothing where paths
    /// may name a patient.
    pub(super) fn told(&self, case: &Case, message: &str) -> Option<String> {
        case.source.as_ref()?;
        Some(message.replace(&shown(&case.input), &case.name))
    }

    /// Runs a case: its outputs, or `None` where they are there already.
    fn work(
        &self,
        global: &Global,
        dataset: &Dataset,
        case: &Case,
        recipe: &Recipe,
        status: &mut CaseStatus,
    ) -> Result<Option<Vec<OutputFile>>, CliError> {
        let old = CaseStatus::read(&dataset.status(&case.name));
        let known = old.as_ref().map(|s| s.inputs.as_slice());
        let (key, inputs) = recipe.key(case, self.known(known))?;
        if old.is_some_and(|s| s.is_done(&key, &dataset.folder, self.resume)) {
            return Ok(None);
        }
        (status.key, status.inputs) = (Some(key), inputs);
        // From here on the case is not done, whenever this process ends.
        remove(&dataset.status(&case.name))?;
        clear_outputs(dataset, case)?;
        let work = self.work_folder(dataset, case);
        let outcome = self.run_in(global, dataset, case, &work);
        let cleared = remove_folder(&work);
        let outputs = outcome?;
        cleared?;
        Ok(Some(outputs))
    }

    fn run_in(
        &self,
        global: &Global,
        dataset: &Dataset,
        case: &Case,
        work: &Path,
    ) -> Result<Vec<OutputFile>, CliError> {
        // What a killed process left behind.
        remove_folder(work)?;
        std::fs::create_dir_all(work).map_err(|e| FormatError::io(work, e))?;
        run::Args::new(self.run.session_args(&case.input, work)).run(global)?;
        Ok(place_outputs(dataset, case, work)?)
    }
}

fn remove(path: &Path) -> Result<(), FormatError> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(FormatError::io(path, e)),
        _ => Ok(()),
    }
}

fn remove_folder(path: &Path) -> Result<(), FormatError> {
    match std::fs::remove_dir_all(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(FormatError::io(path, e)),
        _ => Ok(()),
    }
}
