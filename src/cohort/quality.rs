//! The table of all cases: one row each, whether done, failed or never run.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;

use super::derivatives::{CENTERLINE, REPORT, REPORT_PAGE, output};
use super::outliers::{MAX_SCORE, median, scores};
use super::{Case, CaseStatus, Dataset};
use crate::formats::read_plain;

/// Largest report and centerline that are read.
const MAX_BYTES: u64 = 256 << 20;

/// State of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaseState {
    /// Ended well, with its outputs.
    Done,
    /// Ended with an error.
    Failed,
    /// Not run, or not ended.
    Missing,
}

impl CaseState {
    /// The word in the table.
    pub fn word(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Missing => "missing",
        }
    }
}

/// A measure of a case.
pub(super) struct Measure {
    /// Name of the column, with its unit.
    pub name: &'static str,
    /// Heading on the page.
    pub title: &'static str,
    /// Meaning of the number.
    pub about: &'static str,
    /// Decimals on the page.
    pub decimals: usize,
    /// Reads it from a report.
    value: fn(&Value) -> Option<f64>,
}

fn at(report: &Value, pointer: &str) -> Option<f64> {
    report.pointer(pointer)?.as_f64()
}

/// Area of the wall that the flight sees in neither direction.
fn unseen_mm2(report: &Value) -> Option<f64> {
    let listed = report.pointer("/coverage/patches")?.as_array()?.iter();
    let listed: f64 = listed.filter_map(|p| p["area_mm2"].as_f64()).sum();
    Some(listed + at(report, "/coverage/smaller_patches_mm2")?)
}

fn warnings(report: &Value) -> Option<f64> {
    Some(report["warnings"].as_array()?.len() as f64)
}

/// Columns that are numbers, in order. `radius_*` are of the centerline's points and are put in
/// the report's value by [`QualityRow::of`].
pub(super) const MEASURES: [Measure; 17] = [
    measure(
        "confidence",
        "Confidence",
        "least margin by which the organ passed a gate, 0 to 1",
        2,
        |r| at(r, "/organ/confidence"),
    ),
    measure("volume_ml", "Volume, ml", "volume of the lumen", 1, |r| at(r, "/lumen/volume_ml")),
    measure("area_mm2", "Wall, mm²", "area of the wall", 0, |r| at(r, "/surface/area_mm2")),
    measure("length_mm", "Length, mm", "length of all lines", 1, |r| {
        at(r, "/centerline/length_mm")
    }),
    measure(
        "branches",
        "Branches",
        "path or trunk, and one to each further tip and loop",
        0,
        |r| at(r, "/centerline/branches"),
    ),
    measure("terminal_branches", "Tips", "branches of the tree that end", 0, |r| {
        at(r, "/centerline/tree/terminal_branches")
    }),
    measure("tunnels", "Tunnels", "loops of the wall that a tree does not follow", 0, |r| {
        at(r, "/surface/tunnels")
    }),
    measure(
        "radius_median_mm",
        "Radius, mm",
        "median distance to the wall along the path",
        2,
        |r| at(r, "/radius/median"),
    ),
    measure(
        "radius_min_mm",
        "Narrowest, mm",
        "least distance to the wall along the path",
        2,
        |r| at(r, "/radius/min"),
    ),
    measure("coverage_one_way", "Seen one way", "share of the wall that the flight sees", 3, |r| {
        at(r, "/coverage/one_way_fraction")
    }),
    measure("coverage_both_ways", "Seen both ways", "share seen by it or its reverse", 3, |r| {
        at(r, "/coverage/both_ways_fraction")
    }),
    measure(
        "unseen_mm2",
        "Not seen, mm²",
        "area of the wall seen in neither direction",
        0,
        unseen_mm2,
    ),
    measure(
        "wall_not_found",
        "Wall not found",
        "share of the wall where the scan shows none and a limit closed it",
        3,
        |r| at(r, "/wall/closed_by_limit_share"),
    ),
    measure(
        "touches_edge",
        "At the edge",
        "1 where the lumen reaches the edge of the volume",
        0,
        |r| Some(f64::from(u8::from(r.pointer("/lumen/touches_edge")?.as_bool()?))),
    ),
    measure("warnings", "Warnings", "how many", 0, warnings),
    measure("seconds", "Seconds", "of the case, reading and writing included", 1, |r| {
        at(r, "/seconds")
    }),
    measure("memory_mb", "Memory, MB", "largest resident size", 0, |r| at(r, "/peak_memory_mb")),
];

const fn measure(
    name: &'static str,
    title: &'static str,
    about: &'static str,
    decimals: usize,
    value: fn(&Value) -> Option<f64>,
) -> Measure {
    Measure { name, title, about, decimals, value }
}

/// A case in the table.
#[derive(Clone, Debug)]
pub struct QualityRow {
    /// Name of the case.
    pub case: String,
    /// Participant.
    pub participant: String,
    /// Session, if it has one.
    pub session: Option<String>,
    /// State.
    pub state: CaseState,
    /// Exit code, of a case that has ended.
    pub exit_code: Option<i32>,
    /// Code and text of a failure.
    pub failure: Option<(String, String)>,
    /// Organ that was found.
    pub organ: Option<String>,
    /// Device that computed.
    pub device: Option<String>,
    /// Gates and decisions, a sentence each.
    pub gates: Vec<String>,
    /// Warnings, a sentence each.
    pub warnings: Vec<String>,
    /// Measures, in the order of the columns.
    pub values: Vec<Option<f64>>,
    /// Modified z-score of each.
    pub scores: Vec<Option<f64>>,
    /// Report to look at, below the dataset.
    pub report: Option<String>,
    /// Frame half way along the flight, below the dataset.
    pub frame: Option<String>,
}

/// All cases.
#[derive(Clone, Debug)]
pub struct QualityTable {
    /// Rows in the order of the cases' names.
    pub rows: Vec<QualityRow>,
}

impl QualityRow {
    /// Whether a measure is an outlier.
    pub fn is_outlier(&self, measure: usize) -> bool {
        self.scores.get(measure).copied().flatten().is_some_and(|s| s.abs() > MAX_SCORE)
    }

    fn of(dataset: &Dataset, name: &str) -> Self {
        let case = Case { name: name.to_owned(), input: Default::default(), source: None };
        let status = CaseStatus::read(&dataset.status(name));
        let state = match &status {
            None => CaseState::Missing,
            Some(s) if s.is_success() => CaseState::Done,
            Some(_) => CaseState::Failed,
        };
        let file = |end: &str| dataset.folder.join(output(&case, end));
        let mut report = Value::Null;
        if state == CaseState::Done {
            let bytes = read_plain(&file(REPORT), MAX_BYTES).unwrap_or_default();
            report = serde_json::from_slice(&bytes).unwrap_or_default();
            if report.is_object() {
                report["radius"] = radius(&file(CENTERLINE));
                report["seconds"] = status.as_ref().map(|s| s.seconds).into();
            }
        }
        let text = |v: &Value| v.as_str().map(str::to_owned);
        let texts = |v: &Value| v.as_array().into_iter().flatten().filter_map(text).collect();
        let shown = [REPORT_PAGE, REPORT].into_iter().find(|end| file(end).is_file());
        let failure = status
            .as_ref()
            .filter(|s| !s.is_success())
            .map(|s| (s.reason.clone().unwrap_or_default(), s.error.clone().unwrap_or_default()));
        Self {
            participant: case.participant().to_owned(),
            session: case.session().map(str::to_owned),
            state,
            exit_code: status.as_ref().map(|s| s.exit_code),
            failure,
            organ: text(&report["organ"]["name"]),
            device: text(&report["device"]),
            gates: texts(&report["organ"]["reasons"]),
            warnings: texts(&report["warnings"]),
            values: MEASURES.iter().map(|m| (m.value)(&report)).collect(),
            scores: Vec::new(),
            report: shown.filter(|_| state == CaseState::Done).map(|end| output(&case, end)),
            frame: status.as_ref().and_then(middle_frame),
            case: case.name,
        }
    }
}

/// Frame half way along the flight.
fn middle_frame(status: &CaseStatus) -> Option<String> {
    let is_frame = |path: &&str| path.ends_with(".png");
    let frames: Vec<&str> =
        status.outputs.iter().map(|o| o.path.as_str()).filter(is_frame).collect();
    let middle = frames.get(frames.len() / 2)?;
    // A status names files of its own dataset; what leads out of it is not followed.
    let stays = !middle.starts_with('/') && !middle.split('/').any(|part| part == "..");
    stays.then(|| (*middle).to_owned())
}

/// Median and least radius of the points of a centerline in CSV; null where there is none.
fn radius(csv: &Path) -> Value {
    let bytes = read_plain(csv, MAX_BYTES).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines().filter(|l| !l.starts_with('#'));
    let column = lines.next().and_then(|h| h.split(',').position(|name| name == "radius"));
    let Some(column) = column else { return Value::Null };
    let radii: Vec<f64> =
        lines.filter_map(|l| l.split(',').nth(column)?.trim().parse().ok()).collect();
    let least = radii.iter().copied().reduce(f64::min);
    serde_json::json!({ "median": least.map(|_| median(&radii)), "min": least })
}

impl QualityTable {
    /// Reads what the cases have left.
    ///
    /// * `names`: the cases, in order.
    pub fn read(dataset: &Dataset, names: &[String]) -> Self {
        let mut rows: Vec<QualityRow> = names.iter().map(|n| QualityRow::of(dataset, n)).collect();
        for i in 0..MEASURES.len() {
            let column: Vec<Option<f64>> = rows.iter().map(|r| r.values[i]).collect();
            for (row, score) in rows.iter_mut().zip(scores(&column)) {
                row.scores.push(score);
            }
        }
        Self { rows }
    }

    /// Number of cases in a state.
    pub fn count(&self, state: CaseState) -> usize {
        self.rows.iter().filter(|r| r.state == state).count()
    }

    /// The table as BIDS writes one: tabs, `n/a` for what there is not.
    pub fn tsv(&self) -> String {
        let texts = ["participant_id", "session_id", "case", "state", "exit_code", "reason"];
        let more = ["organ", "device"];
        let measures = MEASURES.iter().map(|m| m.name);
        let last = ["outliers", "report"];
        let head: Vec<&str> = texts.into_iter().chain(more).chain(measures).chain(last).collect();
        let mut out = head.join("\t") + "\n";
        for row in &self.rows {
            let mut cells = vec![
                row.participant.clone(),
                text(row.session.as_deref()),
                row.case.clone(),
                row.state.word().to_owned(),
                row.exit_code.map_or_else(|| "n/a".to_owned(), |c| c.to_string()),
                text(row.failure.as_ref().map(|(reason, _)| reason.as_str())),
                text(row.organ.as_deref()),
                text(row.device.as_deref()),
            ];
            cells.extend(row.values.iter().map(|v| number(*v)));
            let outliers = (0..MEASURES.len()).filter(|i| row.is_outlier(*i));
            let names: Vec<&str> = outliers.map(|i| MEASURES[i].name).collect();
            cells.push(text(Some(&names.join(","))));
            cells.push(text(row.report.as_deref()));
            let _ = writeln!(out, "{}", cells.join("\t"));
        }
        out
    }
}

/// A cell of text: one line without tabs.
fn text(value: Option<&str>) -> String {
    let is_space = |c: char| c.is_control();
    let clean = value.map(|v| v.replace(is_space, " ")).unwrap_or_default();
    if clean.trim().is_empty() { "n/a".to_owned() } else { clean }
}

/// A number as short as it reads back within a millionth.
fn number(value: Option<f64>) -> String {
    let Some(v) = value.filter(|v| v.is_finite()) else { return "n/a".to_owned() };
    let fixed = format!("{v:.6}");
    let short = fixed.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_rows_of_equal_width_and_na_for_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let data = Dataset { folder: dir.path().to_owned() };
        std::fs::create_dir_all(data.logs("sub-2")).unwrap();
        let failed = CaseStatus {
            exit_code: 3,
            reason: Some("lumen/seed-outside".into()),
            error: Some("a\tb\nc".into()),
            ..CaseStatus::default()
        };
        failed.write(&data.status("sub-2")).unwrap();
        let table = QualityTable::read(&data, &["sub-1_ses-a".into(), "sub-2".into()]);
        let tsv = table.tsv();
        let rows: Vec<Vec<&str>> = tsv.lines().map(|l| l.split('\t').collect()).collect();
        assert_eq!(rows.len(), 3);
        assert!(rows.iter().all(|r| r.len() == rows[0].len()), "{tsv}");
        assert_eq!(rows[0][0], "participant_id");
        assert_eq!(rows[1][..6], ["sub-1", "ses-a", "sub-1_ses-a", "missing", "n/a", "n/a"]);
        assert_eq!(rows[2][..6], ["sub-2", "n/a", "sub-2", "failed", "3", "lumen/seed-outside"]);
        assert_eq!(table.count(CaseState::Missing), 1);
    }

    #[test]
    fn numbers_are_short_and_keep_six_decimals() {
        for (v, want) in [(1.5, "1.5"), (2.0, "2"), (-0.0, "0"), (1.0 / 3.0, "0.333333")] {
            assert_eq!(number(Some(v)), want);
        }
        assert_eq!([number(None), number(Some(f64::NAN))], ["n/a", "n/a"]);
    }

    #[test]
    fn a_picture_outside_the_dataset_is_not_followed() {
        let of = |path: &str| {
            let output = super::super::OutputFile { path: path.into(), ..Default::default() };
            middle_frame(&CaseStatus { outputs: vec![output], ..CaseStatus::default() })
        };
        assert!(of("sub-1/figures/sub-1_frames/frame_00001.png").is_some());
        assert_eq!([of("/etc/a.png"), of("a/../../b.png"), of("a.csv")], [None, None, None]);
    }
}
