//! The cases of a cohort one after another, or several at a time, each in a process of its own.

use std::collections::VecDeque;
use std::fs::File;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use serde_json::json;

use super::case::CaseLock;
use super::{Args, counted_cases};
use crate::cli::CliError;
use crate::cli::global::Global;
use crate::cohort::{Case, CaseStatus, Check, Dataset, InputFile, Recipe};
use crate::formats::{FormatError, read_plain};

/// Most of a case's messages that is read for the last one.
const MAX_MESSAGES: u64 = 1 << 20;
/// Exit code of a process that was asked to stop.
const STOPPED: i32 = 130;

/// End of a case in this run of the cohort.
#[derive(Clone, Debug, Serialize)]
struct CaseOutcome {
    /// Name of the case.
    case: String,
    /// `done`, `up to date` or `failed`.
    state: &'static str,
    /// Exit code of the case.
    exit_code: i32,
    /// Wall time, where it was run.
    #[serde(skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
    /// Code of a failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    /// Text of a failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

/// State that all workers share.
struct Engine<'a> {
    args: &'a Args,
    global: &'a Global,
    dataset: &'a Dataset,
    recipe: Recipe,
    /// Cases to come; those that another process has are waited for at the end.
    queue: Mutex<VecDeque<(&'a Case, bool)>>,
    outcomes: Mutex<Vec<CaseOutcome>>,
}

/// The mutexes here guard whole values.
fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Args {
    /// Runs every case that is not done, and says at the end how many failed.
    pub(super) fn participant(&self, global: &Global, dataset: &Dataset) -> Result<(), CliError> {
        let cases = self.cases()?;
        let engine = Engine {
            args: self,
            global,
            dataset,
            recipe: self.run.recipe(global)?,
            queue: Mutex::new(cases.iter().map(|c| (c, false)).collect()),
            outcomes: Mutex::default(),
        };
        if self.list {
            return engine.list(&cases);
        }
        dataset.describe(&self.bids_dir, self.case_names)?;
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.jobs).map(|_| scope.spawn(|| engine.work())).collect();
            let join = |w: std::thread::ScopedJoinHandle<'_, Result<(), CliError>>| {
                w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            workers.into_iter().map(join).collect::<Result<Vec<()>, _>>()
        })?;
        engine.conclude()
    }

    /// Inputs as an earlier status has them, if their hashes may be taken from there.
    pub(super) fn known<'a>(&self, inputs: Option<&'a [InputFile]>) -> Option<&'a [InputFile]> {
        inputs.filter(|_| self.resume == Check::Quick)
    }

    /// Whether a case is done. Files without a status that could say so are not read.
    fn is_done(&self, dataset: &Dataset, recipe: &Recipe, case: &Case) -> bool {
        let Some(status) = CaseStatus::read(&dataset.status(&case.name)) else { return false };
        if !status.is_success() || self.resume == Check::Off {
            return false;
        }
        let key = recipe.key(case, self.known(Some(&status.inputs)));
        key.is_ok_and(|(key, _)| status.is_done(&key, &dataset.folder, self.resume))
    }
}

impl Engine<'_> {
    fn list(&self, cases: &[Case]) -> Result<(), CliError> {
        let mut list = Vec::new();
        for case in cases {
            let is_done = self.args.is_done(self.dataset, &self.recipe, case);
            let word = if is_done { "done" } else { "to run" };
            self.global.say(format_args!("{}: {word}", case.name))?;
            list.push(json!({ "case": case.name, "participant": case.participant(),
                "session": case.session(), "done": is_done }));
        }
        self.global.answer(&json!({ "cases": list }))
    }

    /// Takes cases until there are none. An error of a case is an outcome; one of the cohort's own
    /// records ends this worker.
    fn work(&self) -> Result<(), CliError> {
        loop {
            // Not in the loop's condition, where the queue would stay locked.
            let next = locked(&self.queue).pop_front();
            let Some((case, has_waited)) = next else { return Ok(()) };
            let outcome = if self.args.is_done(self.dataset, &self.recipe, case) {
                self.outcome(case, "up to date")
            } else if !has_waited && CaseLock::is_held(self.dataset, &case.name)? {
                locked(&self.queue).push_back((case, true));
                continue;
            } else {
                self.run(case)?
            };
            self.tell(&outcome)?;
            locked(&self.outcomes).push(outcome);
        }
    }

    fn outcome(&self, case: &Case, state: &'static str) -> CaseOutcome {
        let status = CaseStatus::read(&self.dataset.status(&case.name)).unwrap_or_default();
        CaseOutcome {
            case: case.name.clone(),
            state,
            exit_code: status.exit_code,
            seconds: (state != "up to date").then_some(status.seconds),
            reason: status.reason,
            error: status.error,
        }
    }

    /// Runs a case in a process of its own and sees to it that its end is on record.
    fn run(&self, case: &Case) -> Result<CaseOutcome, CliError> {
        let messages = self.dataset.logs(&case.name).join("messages.txt");
        let ended = self.start(case, &messages)?;
        let outcome = self.conclude_case(case, ended, &messages);
        // Paths, which messages may hold, may name a patient.
        if case.source.is_none() || std::fs::metadata(&messages).is_ok_and(|m| m.len() == 0) {
            let _ = std::fs::remove_file(&messages);
        }
        outcome
    }

    fn conclude_case(
        &self,
        case: &Case,
        ended: ExitStatus,
        messages: &Path,
    ) -> Result<CaseOutcome, CliError> {
        let code = exit_code(ended);
        if code == 0 {
            return Ok(self.outcome(case, "done"));
        }
        if code == STOPPED {
            // Not a failure of the case, which has no status now and is run the next time.
            let reason = Some("cancelled".to_owned());
            return Ok(CaseOutcome { exit_code: code, reason, ..self.outcome(case, "failed") });
        }
        let path = self.dataset.status(&case.name);
        if CaseStatus::read(&path).is_none_or(|s| s.exit_code != code) {
            // It was ended before it could say why.
            let _lock = CaseLock::wait(self.dataset, &case.name)?;
            let reason = if ended.code().is_none() { "killed" } else { "ended" };
            let status = CaseStatus {
                exit_code: code,
                reason: Some(reason.to_owned()),
                error: self.args.told(case, &ended_by(ended, messages)),
                ..self.args.begun(&self.recipe, case)
            };
            status.write(&path)?;
        }
        Ok(self.outcome(case, "failed"))
    }

    /// Starts this program anew for one case, and waits for it. Its standard input stays open for
    /// as long as this process lives; it ends when that ends.
    fn start(&self, case: &Case, messages: &Path) -> Result<ExitStatus, CliError> {
        let system = |e: std::io::Error| CliError::System(format!("{}: {e}", case.name));
        let folder = self.dataset.logs(&case.name);
        std::fs::create_dir_all(&folder).map_err(|e| FormatError::io(&folder, e))?;
        let stderr = File::create(messages).map_err(|e| FormatError::io(messages, e))?;
        let program = std::env::current_exe().map_err(system)?;
        let mut child = Command::new(program)
            .args(self.arguments(case))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(stderr)
            .spawn()
            .map_err(system)?;
        // Waiting would close what it still holds.
        let open = child.stdin.take();
        let ended = child.wait().map_err(system)?;
        drop(open);
        Ok(ended)
    }

    /// The arguments of this process, and behind the command's name the case and its share of the
    /// threads. No global flag takes `bids` as its value, so the first one is the command.
    fn arguments(&self, case: &Case) -> Vec<std::ffi::OsString> {
        let mut all: Vec<_> = std::env::args_os().skip(1).collect();
        let command = all.iter().position(|a| a == "bids").map_or(0, |i| i + 1);
        let mut more = vec!["--only-case".to_owned(), case.name.clone()];
        if self.args.jobs > 1 && self.global.threads.is_none() {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let share = (cores / self.args.jobs as usize).max(1);
            more.extend(["--threads".to_owned(), share.to_string()]);
        }
        all.splice(command..command, more.into_iter().map(Into::into));
        all
    }

    fn tell(&self, outcome: &CaseOutcome) -> Result<(), CliError> {
        let CaseOutcome { case, state, exit_code, seconds, reason, error } = outcome;
        if *state != "failed" {
            let took = seconds.map(|s| format!(", {s:.1} s")).unwrap_or_default();
            return self.global.say(format_args!("{case}: {state}{took}"));
        }
        let why = error.as_ref().or(reason.as_ref()).map_or("", String::as_str);
        tracing::error!("{case}: failed ({exit_code}): {}", crate::formats::shown_lines(why));
        Ok(())
    }

    fn conclude(self) -> Result<(), CliError> {
        let mut outcomes = self.outcomes.into_inner().unwrap_or_else(PoisonError::into_inner);
        outcomes.sort_by(|a, b| a.case.cmp(&b.case));
        let count = |state| outcomes.iter().filter(|o| o.state == state).count();
        let [done, up_to_date, failed] = ["done", "up to date", "failed"].map(count);
        let total = outcomes.len();
        self.global.say(format_args!(
            "{}: {done} done, {up_to_date} up to date, {failed} failed",
            counted_cases(total)
        ))?;
        self.global.answer(&json!({
            "cases": outcomes, "done": done, "up_to_date": up_to_date, "failed": failed,
        }))?;
        let mut codes = outcomes.iter().filter(|o| o.state == "failed").map(|o| o.exit_code);
        let Some(first) = codes.next() else { return Ok(()) };
        let code = u8::try_from(first).ok().filter(|_| codes.all(|c| c == first)).unwrap_or(1);
        Err(CliError::CasesFailed { failed, total, code })
    }
}

/// Exit code as a shell gives it: 128 and the number of a signal.
fn exit_code(ended: ExitStatus) -> i32 {
    #[cfg(unix)]
    let signal = std::os::unix::process::ExitStatusExt::signal(&ended);
    #[cfg(not(unix))]
    let signal: Option<i32> = None;
    ended.code().or(signal.map(|s| 128 + s)).unwrap_or(1)
}

/// Why a process ended that left no status.
fn ended_by(ended: ExitStatus, messages: &Path) -> String {
    let bytes = read_plain(messages, MAX_MESSAGES).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let last = text.lines().rev().find_map(|l| l.strip_prefix("intima: "));
    match (last, ended.code()) {
        (Some(last), Some(_)) => last.to_owned(),
        _ => format!("its process ended with {ended}"),
    }
}
