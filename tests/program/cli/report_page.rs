//! `report.html`: well-formed, loads nothing, says what `report.json` says.

use common::html::{self, Element};
use intima::formats::NOTICE;
use intima::report_page::{Finding, MeasuredValue, ReportPage, SliceView};
use intima::session::{
    OrganReport, PngPicture, Report, ReportPictures, Session, Settings, Source, VolumeSource,
};
use intima::volume::phantom::{Kind, Phantom};
use serde_json::Value;

use super::{can_draw, names, phantom, works};

/// Every number below a value, with the lengths of its lists.
fn numbers(value: &Value, out: &mut Vec<f64>) {
    match value {
        Value::Number(n) => out.extend(n.as_f64()),
        Value::Array(all) => {
            out.push(all.len() as f64);
            all.iter().for_each(|v| numbers(v, out));
        }
        Value::Object(all) => all.values().for_each(|v| numbers(v, out)),
        _ => {}
    }
}

/// Checks the numbers of a section of the page: each is one of that part of the report, and is shown
/// as it is, rounded. Returns how many there are.
fn agree(page: &Element, id: &str, part: &Value) -> usize {
    let section = page.by_id(id).unwrap_or_else(|| panic!("no section {id}"));
    let mut known = Vec::new();
    numbers(part, &mut known);
    let shown: Vec<&Element> = section.all().into_iter().filter(|e| e.name == "data").collect();
    for data in &shown {
        let value: f64 = data.get("value").parse().unwrap();
        assert!(known.contains(&value), "{id}: {value} is not in {part}");
        let text = data.text.replace('\u{202f}', "").replace('\u{2212}', "-");
        let digits = text.split_once('.').map_or(0, |(_, d)| d.len());
        let as_text = |v: f64| format!("{v:.digits$}");
        let is_zero = text.parse::<f64>() == Ok(0.0);
        assert!(
            text == as_text(value)
                || text == as_text(100.0 * value)
                || is_zero && value.abs() <= 0.5,
            "{id}: {value} is shown as {text}"
        );
    }
    shown.len()
}

#[test]
fn a_page_agrees_with_the_report_and_only_its_times_differ_between_runs() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Y, 48);
    let title = "<script>alert(\"1\")</script> & more\u{7}";
    let run = |out: &str, threads: &str, more: &[&str]| {
        let args = ["run", "ct.nrrd", "--threshold", ":-455", "--out", out, "--tree", "--frames"];
        let rest = ["5", "--size", "96x64", "--threads", threads];
        works(tmp.path(), &[&args[..], &rest, more].concat());
        std::fs::read_to_string(tmp.path().join(out).join("report.html")).unwrap_or_default()
    };
    let text = run("a", "1", &["--title", title]);
    let page = html::read(&text);
    let json = std::fs::read(tmp.path().join("a/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&json).unwrap();
    let parts = [
        ("summary", &report),
        ("profile", &report["profile"]),
        ("centerline", &report["centerline"]),
        ("coverage", &report["coverage"]),
        ("tree", &report["centerline"]["tree"]),
        ("input", &report["input"]),
        ("lumen", &report["lumen"]),
        ("wall", &report["wall"]),
        ("surface", &report["surface"]),
        ("run", &report),
    ];
    let counts = parts.map(|(id, part)| agree(&page, id, part));
    // The branches of a Y have no narrow place to show.
    let is_narrow = !report["profile"]["narrowest"].as_array().unwrap().is_empty();
    let has_numbers = |(i, n): (usize, &usize)| *n >= 2 || parts[i].0 == "profile" && !is_narrow;
    assert!(counts.iter().enumerate().all(has_numbers), "{counts:?}");
    let shown = |id: &str, value: &Value| {
        let all = page.by_id(id).unwrap().all();
        all.iter().any(|e| e.get("value").parse::<f64>().ok() == value.as_f64())
    };
    for key in ["one_way_fraction", "both_ways_fraction", "area_mm2"] {
        assert!(shown("coverage", &report["coverage"][key]), "{key}");
    }
    let of = &report["coverage"]["of"];
    assert_eq!((&of["route"], &of["cameras"]), (&"trunk".into(), &report["frames"]["count"]));
    assert!(shown("coverage", &of["cameras"]) && shown("coverage", &of["field_of_view_deg"]));
    assert!(shown("lumen", &report["lumen"]["volume_ml"]));
    assert!(shown("run", &report["peak_memory_mb"]));
    let stages = report["stages"].as_array().unwrap();
    for stage in stages {
        assert!(page.by_id("run").unwrap().text.contains(stage["name"].as_str().unwrap()));
    }
    assert!(stages.iter().any(|s| s["name"] == "pictures" && s["items"] == 5));
    // The title is text, and nothing of the input's name is there.
    let head = page.all().into_iter().find(|e| e.name == "h1").unwrap();
    assert_eq!(head.text, "<script>alert(\"1\")</script> & more ");
    assert!(page.text.contains(NOTICE) && !text.contains("ct.nrrd"));
    let policy = page.all().into_iter().find(|e| e.get("http-equiv") == "Content-Security-Policy");
    assert_eq!(
        policy.unwrap().get("content"),
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    );
    assert_eq!(page.all().iter().filter(|e| e.name == "img").count(), 5);
    // The same again, at another number of threads.
    assert!(html::lasting(&text) == html::lasting(&run("b", "2", &["--title", title])));
    assert_eq!(run("b", "2", &["--no-page"]), "", "an older page does not stay");
    assert!(names(&tmp.path().join("b")).contains(&"report.json".to_owned()));
}

/// A report without the parts that need a device that draws.
fn report_of(phantom: &Phantom, ready: impl FnOnce(&Session)) -> Report {
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(phantom.mask())));
    let session = Session::new(source, Settings::default()).unwrap();
    ready(&session);
    session.report(None).unwrap()
}

#[test]
fn a_page_leaves_out_what_the_report_does_not_have() {
    let sections = |page: &ReportPage<'_>| -> Vec<String> {
        let html = html::read(&page.html());
        html.all().iter().map(|e| e.get("id").to_owned()).filter(|id| !id.is_empty()).collect()
    };
    assert_eq!(sections(&ReportPage::default()), ["limits"], "nothing is known");
    let empty = Report::default();
    let page = ReportPage { report: Some(&empty), ..ReportPage::default() };
    assert_eq!(sections(&page), ["summary", "run", "limits"]);
    // A label map, without flight and frames.
    let tube = Phantom::new(Kind::Tube, 24, [1.0; 3]).unwrap();
    let report = report_of(&tube, |_| {});
    let page = ReportPage { report: Some(&report), ..ReportPage::default() };
    let got = sections(&page);
    let wanted = ["profile", "centerline", "input", "lumen", "wall", "surface", "run", "limits"];
    // Both ends of a tube are as good a start.
    assert_eq!(got, [&["warnings", "summary"], &wanted[..]].concat());
    assert!(html::read(&page.html()).by_id("lumen").unwrap().text.contains("every one but 0"));
    // With the profile along the path.
    let report = report_of(&tube, |session| drop(session.lumen_profile().unwrap()));
    let html = html::read(&ReportPage { report: Some(&report), ..ReportPage::default() }.html());
    assert_eq!(html.all().iter().filter(|e| e.get("class") == "chart").count(), 2);
    assert!(html.by_id("profile").unwrap().text.contains("None"), "a tube has no narrow place");
}

#[test]
fn texts_of_users_and_of_drivers_are_escaped_wherever_they_stand() {
    let hostile = "</style><script>x</script>\"'&\u{0}\u{fffe}";
    let picture = PngPicture { size: [1, 1], png: intima::formats::encode_png(1, 1, &[1, 2, 3]) };
    let organ = OrganReport {
        name: "colon",
        threshold: -800.0,
        seeds_mm: Vec::new(),
        segments: Vec::new(),
        confidence: 0.5,
        reasons: vec![hostile.into()],
    };
    let report = Report {
        warnings: vec![hostile.into()],
        device: hostile.into(),
        organ: Some(organ),
        ..Report::default()
    };
    let finding = Finding {
        text: hostile.into(),
        segment: Some(hostile.into()),
        wall_mm: Some([0.0; 3]),
        arc_mm: Some(123.4),
        start: Some("rectum"),
        view: Some(picture.clone()),
        slices: vec![SliceView { name: "axial", picture }],
        ..Finding::default()
    };
    let size = MeasuredValue {
        name: hostile.into(),
        text: "6.4 mm".into(),
        points_mm: vec![[1.0, 0.0, 0.0], [0.0, 6.0, 0.0]],
        is_length: true,
        finding: Some(1),
    };
    let page = ReportPage {
        report: Some(&report),
        pictures: Some(&ReportPictures::default()),
        title: Some(hostile),
        findings: &[finding],
        measurements: &[size],
        shown_fraction: Some(0.25),
        category: Some("C2: one or two polyps of 6 to 9 mm"),
    };
    let html = html::read(&page.html());
    let clean = hostile.replace(['\u{0}', '\u{fffe}'], " ");
    assert_eq!(html.text.matches(&clean).count(), 8, "title, heading, and six more");
    let findings = &html.by_id("findings").unwrap().text;
    for part in
        ["C-RADS C2", "Size 6.4 mm (measurement 1).", "123 mm along the path from the rectum."]
    {
        assert!(findings.contains(part), "{part:?} in {findings}");
    }
    assert_eq!(html.all().iter().filter(|e| e.name == "img").count(), 2);
    assert!(html.by_id("coverage").unwrap().text.contains("25.0"));
}

#[test]
#[should_panic(expected = "the element script")]
fn the_reader_of_pages_refuses_a_script() {
    html::read("<!DOCTYPE html><html><body><script>x</script></body></html>");
}

#[test]
#[should_panic(expected = "had to be escaped")]
fn the_reader_of_pages_refuses_a_bare_ampersand() {
    html::read("<!DOCTYPE html><html><body>a & b</body></html>");
}

#[test]
#[should_panic(expected = "not \"</p>\"")]
fn the_reader_of_pages_refuses_a_tag_without_its_end() {
    html::read("<!DOCTYPE html><html><body><p>a</body></html>");
}

#[test]
#[should_panic(expected = "not within the page")]
fn the_reader_of_pages_refuses_a_picture_from_elsewhere() {
    html::read("<!DOCTYPE html><html><body><img src=\"http://x/y.png\"></body></html>");
}
