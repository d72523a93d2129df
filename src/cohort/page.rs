//! `quality.html`: the table with pictures, sortable, outliers marked. One file that loads nothing;
//! its one script sorts rows and is allowed by its hash, so that no other can run. Rows could be
//! sorted without a script only by a page for each column.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::dataset::encoded;
use super::outliers::{MAX_SCORE, MIN_VALUES};
use super::quality::MEASURES;
use super::{CaseState, Dataset, QualityRow, QualityTable};
use crate::formats::{NOTICE, encode_png, read_png};

/// Columns of a thumbnail.
const THUMBNAIL_PX: u32 = 144;

/// Sorts rows by the column whose heading is pressed: numbers by value, texts by letters, cells
/// without a value last. Pressed again, the other way round.
const SCRIPT: &str = include_str!("page.js");
/// SHA-256 of [`SCRIPT`], in base64; a test holds the two together.
const SCRIPT_SHA256: &str = "5FY5cjtRbAE9qj9pSLAdSc3bgNvWVzjxqSXMdbG3iaI=";
const STYLE: &str = include_str!("page.css");

/// The page of a table.
pub fn quality_page(dataset: &Dataset, table: &QualityTable) -> String {
    let policy = format!(
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
         script-src 'sha256-{SCRIPT_SHA256}'"
    );
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy);
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "Quality of " (table.rows.len()) " cases" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Quality" }
                (summary(table))
                div.wide {
                    table #cases {
                        (head_row())
                        tbody { @for row in &table.rows { (body_row(dataset, row)) } }
                    }
                }
                (legend())
                footer { (NOTICE) " intima " (env!("CARGO_PKG_VERSION")) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

fn summary(table: &QualityTable) -> Markup {
    let of = |state| table.count(state);
    let (done, failed) = (of(CaseState::Done), of(CaseState::Failed));
    html! {
        p {
            (table.rows.len()) " cases: " (done) " done, " (failed) " failed, "
            (of(CaseState::Missing)) " missing."
            span.screen { " Press a heading to sort." }
        }
    }
}

fn head_row() -> Markup {
    html! {
        thead {
            tr {
                th { "Flight" }
                th { button type="button" { "Case" } }
                th { button type="button" { "State" } }
                th { button type="button" { "Organ" } }
                @for m in &MEASURES {
                    th title=(m.about) { button type="button" { (m.title) } }
                }
                th { "Notes" }
            }
        }
    }
}

fn body_row(dataset: &Dataset, row: &QualityRow) -> Markup {
    html! {
        tr.(row.state.word()) {
            td { (thumbnail(dataset, row)) }
            th scope="row" {
                @match &row.report {
                    Some(path) => a href=(encoded(path)) { (row.case) },
                    None => (row.case),
                }
            }
            td { (row.state.word()) }
            td { (row.organ.as_deref().unwrap_or("n/a")) }
            @for (i, m) in MEASURES.iter().enumerate() { (cell(row, i, m.decimals)) }
            td.notes { (notes(row)) }
        }
    }
}

fn cell(row: &QualityRow, measure: usize, decimals: usize) -> Markup {
    let Some(value) = row.values[measure] else { return html! { td.none { "n/a" } } };
    let text = format!("{value:.decimals$}");
    match row.scores[measure].filter(|_| row.is_outlier(measure)) {
        Some(score) => html! {
            td.number.outlier data-value=(value) title={ "score " (format!("{score:.1}")) } { (text) }
        },
        None => html! { td.number data-value=(value) { (text) } },
    }
}

fn notes(row: &QualityRow) -> Markup {
    html! {
        @if let Some((reason, error)) = &row.failure { p { strong { (reason) } " " (error) } }
        @for (title, texts) in [("warning", &row.warnings), ("gate", &row.gates)] {
            @if !texts.is_empty() {
                details {
                    summary { (texts.len()) " " (title) @if texts.len() != 1 { "s" } }
                    ul { @for text in texts { li { (text) } } }
                }
            }
        }
    }
}

fn legend() -> Markup {
    html! {
        h2 { "What is shown" }
        p {
            "Marked " span.outlier { "like this" } ": a value whose modified z-score, 0.6745 × "
            "(value − median) / median absolute deviation of its column, is above " (MAX_SCORE)
            " in magnitude (Iglewicz and Hoaglin 1993; where half of the values are equal, the mean "
            "deviation × 1.2533 takes the place of the median one / 0.6745). Columns of fewer than "
            (MIN_VALUES) " values have no marks. An outlier is a case to look at, not a fault."
        }
        dl { @for m in &MEASURES { dt { (m.title) } dd { (m.about) } } }
        p { "Flight: the frame half way. Case: link to the report of the case. Seconds and memory "
            "differ from run to run; everything else is the same on one device." }
    }
}

/// A small picture of a case within the page; nothing where there is no frame to be read.
fn thumbnail(dataset: &Dataset, row: &QualityRow) -> Markup {
    let frame = row.frame.as_ref().filter(|_| row.state == CaseState::Done);
    let picture = frame.and_then(|path| read_png(&dataset.folder.join(path)).ok());
    let Some((width, height, rgb)) = picture else { return html! {} };
    let (w, h, small) = reduced(width, height, &rgb);
    let data = STANDARD.encode(encode_png(w, h, &small));
    html! {
        img width=(w) height=(h) alt={ "Flight of " (row.case) ", half way" }
            src={ "data:image/png;base64," (data) };
    }
}

/// A picture made smaller by whole factors: means of blocks of pixels.
fn reduced(width: u32, height: u32, rgb: &[u8]) -> (u32, u32, Vec<u8>) {
    let factor = (width / THUMBNAIL_PX).max(1).min(height);
    let (w, h) = (width / factor, height / factor);
    let mut out = Vec::with_capacity(3 * (w * h) as usize);
    let half = factor * factor / 2;
    for y in 0..h {
        for x in 0..w {
            let mut sum = [half; 3];
            for (dy, dx) in (0..factor).flat_map(|dy| (0..factor).map(move |dx| (dy, dx))) {
                let at =
                    3 * ((y * factor + dy) as usize * width as usize + (x * factor + dx) as usize);
                (0..3).for_each(|c| sum[c] += u32::from(rgb[at + c]));
            }
            out.extend(sum.map(|s| (s / (factor * factor)) as u8));
        }
    }
    (w, h, out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cohort::CaseStatus;

    #[test]
    fn a_picture_made_smaller_holds_the_means_of_blocks() {
        let (w, h) = (2 * THUMBNAIL_PX + 1, 5);
        let rgb: Vec<u8> = (0..w * h).flat_map(|i| [(i % w % 2 * 100) as u8; 3]).collect();
        let (sw, sh, small) = reduced(w, h, &rgb);
        assert_eq!((sw, sh, small.len()), (THUMBNAIL_PX, 2, 3 * 2 * THUMBNAIL_PX as usize));
        assert!(small.iter().all(|v| *v == 50));
        assert_eq!(reduced(3, 2, &[7; 18]), (3, 2, vec![7; 18]));
    }

    #[test]
    fn texts_of_a_case_are_never_tags_of_the_page() {
        let dir = tempfile::tempdir().unwrap();
        let data = Dataset { folder: dir.path().to_owned() };
        std::fs::create_dir_all(data.logs("sub-1")).unwrap();
        let hostile = "</script><script>alert(1)</script><img src=x onerror=alert(1)>\"'";
        let failed =
            CaseStatus { exit_code: 3, error: Some(hostile.into()), ..CaseStatus::default() };
        failed.write(&data.status("sub-1")).unwrap();
        let page = quality_page(&data, &QualityTable::read(&data, &["sub-1".into()]));
        assert_eq!(page.matches("<script>").count(), 1);
        assert!(page.contains("&lt;img src=x") && !page.contains("<img src=x"));
        assert!(page.contains("default-src 'none'"));
    }

    /// SHA-256 (FIPS 180-4), for the test below alone.
    fn sha256(text: &str) -> [u8; 32] {
        let is_prime = |n: &u32| !(2..*n).any(|d| n.is_multiple_of(d));
        let fraction = |root: f64| (root.fract() * 4_294_967_296.0) as u32;
        let primes: Vec<u32> = (2..400).filter(is_prime).collect();
        let k: Vec<u32> = primes.iter().take(64).map(|p| fraction(f64::from(*p).cbrt())).collect();
        let mut hash: Vec<u32> =
            primes.iter().take(8).map(|p| fraction(f64::from(*p).sqrt())).collect();
        let mut bytes = text.as_bytes().to_vec();
        bytes.push(0x80);
        bytes.resize((bytes.len() + 8).next_multiple_of(64), 0);
        let end = bytes.len() - 8;
        bytes[end..].copy_from_slice(&(8 * text.len() as u64).to_be_bytes());
        for block in bytes.chunks_exact(64) {
            let mut w: Vec<u32> =
                block.chunks_exact(4).map(|b| u32::from_be_bytes(b.try_into().unwrap())).collect();
            for i in 16..64 {
                let (a, b) = (w[i - 15], w[i - 2]);
                let s0 = a.rotate_right(7) ^ a.rotate_right(18) ^ (a >> 3);
                let s1 = b.rotate_right(17) ^ b.rotate_right(19) ^ (b >> 10);
                w.push(w[i - 16].wrapping_add(s0).wrapping_add(w[i - 7]).wrapping_add(s1));
            }
            let mut v: [u32; 8] = hash.clone().try_into().unwrap();
            for i in 0..64 {
                let [a, b, c, d, e, f, g, h] = v;
                let s1 = e.rotate_right(6) ^ e.rotate_right(11) ^ e.rotate_right(25);
                let s0 = a.rotate_right(2) ^ a.rotate_right(13) ^ a.rotate_right(22);
                let choice = (e & f) ^ (!e & g);
                let t =
                    h.wrapping_add(s1).wrapping_add(choice).wrapping_add(k[i]).wrapping_add(w[i]);
                let majority = (a & b) ^ (a & c) ^ (b & c);
                v = [
                    t.wrapping_add(s0).wrapping_add(majority),
                    a,
                    b,
                    c,
                    d.wrapping_add(t),
                    e,
                    f,
                    g,
                ];
            }
            hash.iter_mut().zip(v).for_each(|(h, v)| *h = h.wrapping_add(v));
        }
        let out: Vec<u8> = hash.iter().flat_map(|h| h.to_be_bytes()).collect();
        out.try_into().unwrap()
    }

    #[test]
    fn the_policy_allows_the_script_of_the_page() {
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let hex: String = sha256("abc").iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, known);
        assert_eq!(STANDARD.encode(sha256(SCRIPT)), SCRIPT_SHA256);
    }
}
