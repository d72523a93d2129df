//! Files that the window exports: pictures, and a page of HTML with bookmarks, measurements and
//! figures. Nothing of a patient, no name of a file that was opened.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use base64::Engine as _;

use super::error::AppError;
use super::model::{Bookmark, Model};
use crate::formats::{FormatError, NOTICE, atomic_file};

/// Writes a file into a folder, which is made if it is not there; whole or not at all.
pub(super) fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf, AppError> {
    std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
    let path = folder.join(name);
    atomic_file::write_atomic(&path, |out| out.write_all(bytes))?;
    Ok(path)
}

/// A name `STEM-1.png`, `STEM-2.png`, … that no file of the folder has.
pub(super) fn free_name(folder: &Path, stem: &str) -> String {
    let names = (1u32..).map(|i| format!("{stem}-{i}.png"));
    let mut free = names.filter(|n| !folder.join(n).exists());
    free.next().expect("numbers do not end")
}

/// Text as it may stand in HTML.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
    }
    out
}

const STYLE: &str = "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;\
color:#222}table{border-collapse:collapse}td,th{padding:.25em .8em;border-bottom:1px solid #ddd;\
text-align:left}td.n{text-align:right}figure{margin:1.5em 0}img{max-width:100%}\
footer{margin-top:3em;border-top:1px solid #ddd;color:#666}";

/// The page.
///
/// * `folder`: that of the session file, where pictures of earlier sessions are.
pub(super) fn report_html(model: &Model, folder: Option<&Path>) -> String {
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <title>intima: report</title><style>{STYLE}</style></head><body>\n\
         <h1>Virtual endoscopy</h1>\n<h2>Figures</h2>\n<table>\n"
    );
    for (name, value) in figures(model) {
        let _ = writeln!(out, "<tr><td>{name}</td><td class=\"n\">{value}</td></tr>");
    }
    out.push_str("</table>\n");
    if !model.measurements.is_empty() {
        out.push_str("<h2>Measurements</h2>\n<table>\n");
        for (i, m) in model.measurements.iter().enumerate() {
            let name = match &m.name[..] {
                "" => (i + 1).to_string(),
                name => escaped(name),
            };
            let places: Vec<String> = m.points_mm.iter().map(|p| place(*p)).collect();
            let _ = writeln!(
                out,
                "<tr><td>{name}</td><td class=\"n\">{}</td><td>{}</td></tr>",
                m.text(),
                places.join(" &rarr; ")
            );
        }
        out.push_str("</table>\n");
    }
    if !model.bookmarks.is_empty() {
        out.push_str("<h2>Bookmarks</h2>\n");
    }
    for (i, b) in model.bookmarks.iter().enumerate() {
        let at = b.arc_mm.map_or("off the path".into(), |mm| format!("{mm:.0} mm along the path"));
        let text = escaped(&b.text);
        let _ = writeln!(out, "<figure><figcaption><b>{}. {text}</b><br>", i + 1);
        let _ = writeln!(out, "{at}; LPS {} mm</figcaption>", place(b.position_mm));
        if let Some(png) = picture(b, folder) {
            let data = base64::engine::general_purpose::STANDARD.encode(png);
            let _ = writeln!(out, "<img alt=\"{text}\" src=\"data:image/png;base64,{data}\">");
        }
        out.push_str("</figure>\n");
    }
    let version = env!("CARGO_PKG_VERSION");
    let _ = writeln!(out, "<footer>intima {version}. {NOTICE}</footer>\n</body></html>");
    out
}

fn place(p: [f64; 3]) -> String {
    format!("({:.1}, {:.1}, {:.1})", p[0], p[1], p[2])
}

/// The picture of a bookmark, from memory or from its file.
fn picture(b: &Bookmark, folder: Option<&Path>) -> Option<Vec<u8>> {
    const MAX_BYTES: u64 = 64 << 20;
    if let Some(png) = &b.png {
        return Some(png.to_vec());
    }
    let path = folder?.join(b.picture.as_ref()?);
    let is_small = std::fs::metadata(&path).is_ok_and(|m| m.len() <= MAX_BYTES);
    let png = is_small.then(|| std::fs::read(&path).ok()).flatten()?;
    png.starts_with(b"\x89PNG\r\n\x1a\n").then_some(png)
}

/// Names and values of what is known.
fn figures(model: &Model) -> Vec<(&'static str, String)> {
    let mut out = Vec::new();
    if let Some(lumen) = &model.products.lumen {
        let l = &lumen.lumen;
        let ml = l.inside_voxels() as f64 * l.grid.voxel_mm3() / 1000.0;
        out.push(("Volume of the lumen", format!("{ml:.1} ml")));
    }
    if let Some(path) = &model.path {
        out.push(("Length of the path", format!("{:.0} mm", path.length_mm())));
        let sections: Vec<f64> = path.sections.iter().flatten().map(|s| s.area_mm2).collect();
        if !sections.is_empty() {
            let least = sections.iter().copied().fold(f64::INFINITY, f64::min);
            let most = sections.iter().copied().fold(0.0, f64::max);
            let range = format!("{least:.0} to {most:.0} mm²");
            out.push(("Cross-section along the path", range));
        }
    }
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    if let Some(c) = &model.products.coverage {
        out.push(("Wall seen on a flight one way", percent(c.one_way_fraction)));
        out.push(("Wall seen both ways", percent(c.both_ways_fraction)));
        out.push(("Missed patches of 300 mm² and more", c.patches.len().to_string()));
    }
    if !model.seen.faces.is_empty() {
        out.push(("Wall shown in this session", percent(model.seen.fraction)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn a_page_escapes_texts_and_holds_its_pictures() {
        let mut model = Model::new(20.0);
        let png = b"\x89PNG\r\n\x1a\nrest".to_vec();
        let bookmark = |text: &str, png: Option<Vec<u8>>| Bookmark {
            text: text.into(),
            position_mm: [1.0, -2.0, 3.25],
            rotation: [0.0, 0.0, 0.0, 1.0],
            fov_deg: 90.0,
            arc_mm: Some(12.0),
            picture: Some("p-1.png".into()),
            png: png.map(Arc::new),
        };
        model.bookmarks =
            vec![bookmark("<script>\"x\"", Some(png.clone())), bookmark("from its file", None)];
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "p-1.png", &png).unwrap();
        let html = report_html(&model, Some(dir.path()));
        assert!(html.contains("&lt;script&gt;&quot;x&quot;") && !html.contains("<script>"));
        assert_eq!(html.matches("data:image/png;base64,iVBORw0KGgpyZXN0").count(), 2);
        assert!(html.contains("(1.0, -2.0, 3.2)") && html.contains(NOTICE));
        // A file that is no picture does not get in.
        std::fs::write(dir.path().join("p-1.png"), "secret").unwrap();
        assert_eq!(report_html(&model, Some(dir.path())).matches("base64,").count(), 1);
        assert_eq!(free_name(dir.path(), "p"), "p-2.png");
    }
}
