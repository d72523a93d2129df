//! Reader of the XML that VTK writes: tags with attributes, and text between them.

/// A piece of a document, borrowed from it.
#[derive(Debug, PartialEq)]
pub(super) enum Event<'a> {
    /// `<name attributes>`; `empty` where it ends in `/>`.
    Open { name: &'a str, attributes: &'a str, empty: bool },
    /// `</name>`
    Close(&'a str),
    /// Text between two tags, blanks removed at both ends; never empty.
    Text(&'a str),
}

/// Splits a document. Declarations and comments are passed over. Ends where a tag is not closed.
pub(super) fn events(mut rest: &str) -> impl Iterator<Item = Event<'_>> {
    std::iter::from_fn(move || {
        loop {
            let open = rest.find('<')?;
            let text = rest[..open].trim();
            if !text.is_empty() {
                rest = &rest[open..];
                return Some(Event::Text(text));
            }
            rest = &rest[open..];
            if let Some(comment) = rest.strip_prefix("<!--") {
                rest = &comment[comment.find("-->")? + 3..];
                continue;
            }
            let end = tag_end(rest)?;
            let tag = &rest[1..end];
            rest = &rest[end + 1..];
            if tag.starts_with(['?', '!']) {
                continue;
            }
            if let Some(name) = tag.strip_prefix('/') {
                return Some(Event::Close(name.trim()));
            }
            let (tag, empty) = tag.strip_suffix('/').map_or((tag, false), |t| (t, true));
            let (name, attributes) =
                tag.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((tag, ""));
            return Some(Event::Open { name, attributes, empty });
        }
    })
}

/// Returns the index of the `>` that ends the first tag; one inside quotes is text.
fn tag_end(text: &str) -> Option<usize> {
    let mut quote = None;
    text.bytes().position(|b| match (quote, b) {
        (None, b'>') => true,
        (None, b'"' | b'\'') => {
            quote = Some(b);
            false
        }
        (Some(q), b) if q == b => {
            quote = None;
            false
        }
        _ => false,
    })
}

/// The value of an attribute.
pub(super) fn attribute<'a>(attributes: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = attributes;
    loop {
        let (key, tail) = rest.split_once('=')?;
        let tail = tail.trim_start();
        let quote = tail.chars().next().filter(|c| "\"'".contains(*c))?;
        let (value, after) = tail[1..].split_once(quote)?;
        if key.trim() == name {
            return Some(value);
        }
        rest = after;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_attributes_and_text_are_told_apart() {
        let text = "<?xml version=\"1.0\"?>\n<!-- <a> -->\n<a b=\"1 > 0\" c = 'x'>\n t </a><d/><e";
        let all: Vec<Event> = events(text).collect();
        assert_eq!(
            all,
            [
                Event::Open { name: "a", attributes: "b=\"1 > 0\" c = 'x'", empty: false },
                Event::Text("t"),
                Event::Close("a"),
                Event::Open { name: "d", attributes: "", empty: true },
            ]
        );
        let Event::Open { attributes, .. } = all[0] else { panic!("a tag") };
        assert_eq!(attribute(attributes, "b"), Some("1 > 0"));
        assert_eq!(attribute(attributes, "c"), Some("x"));
        assert_eq!(attribute(attributes, "d"), None);
        assert_eq!(attribute("a=1", "a"), None);
    }
}
