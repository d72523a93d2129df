//! A strict reader of the HTML that intima writes: it accepts less than HTML allows, and panics with
//! the place at anything else.

use std::collections::BTreeMap;

/// An element, with what is in it.
#[derive(Debug, Default)]
pub struct Element {
    /// Name, lower case save in SVG.
    pub name: String,
    /// Attributes, with characters instead of references.
    pub attributes: BTreeMap<String, String>,
    /// Elements in it, in their order.
    pub children: Vec<Element>,
    /// Text in it and in its children, in their order.
    pub text: String,
}

/// Elements that have no end tag.
const VOID: [&str; 3] = ["meta", "img", "br"];

/// Elements that the page may have. None loads or runs anything but an image, whose source is
/// checked.
const ALLOWED: [&str; 41] = [
    "article",
    "b",
    "body",
    "circle",
    "code",
    "data",
    "div",
    "figcaption",
    "figure",
    "footer",
    "h1",
    "h2",
    "h3",
    "head",
    "header",
    "html",
    "i",
    "img",
    "li",
    "line",
    "main",
    "meta",
    "p",
    "path",
    "rect",
    "section",
    "span",
    "style",
    "svg",
    "table",
    "tbody",
    "td",
    "text",
    "th",
    "thead",
    "time",
    "title",
    "tr",
    "ul",
    "g",
    "br",
];

impl Element {
    /// This element and all below it, parents first.
    pub fn all(&self) -> Vec<&Element> {
        let below = self.children.iter().flat_map(Element::all);
        std::iter::once(self).chain(below).collect()
    }

    /// An attribute, or nothing.
    pub fn get(&self, name: &str) -> &str {
        self.attributes.get(name).map_or("", String::as_str)
    }

    /// The element with an identifier.
    pub fn by_id(&self, id: &str) -> Option<&Element> {
        self.all().into_iter().find(|e| e.get("id") == id)
    }
}

struct Reader<'a> {
    all: &'a str,
    rest: &'a str,
}

/// Reads a page whole.
///
/// # Panics
/// Where it is not well-formed: a tag without its end, an attribute without quotes or twice, a
/// character that had to be escaped, an identifier twice; where it holds an element or attribute
/// that may load or run something, or a picture that is not within it.
pub fn read(page: &str) -> Element {
    let rest = page.strip_prefix("<!DOCTYPE html>").expect("a doctype first");
    let mut reader = Reader { all: page, rest: rest.trim_start() };
    let root = reader.element();
    assert_eq!((root.name.as_str(), reader.rest.trim()), ("html", ""), "one element, to the end");
    let mut ids: Vec<&str> =
        root.all().iter().map(|e| e.get("id")).filter(|i| !i.is_empty()).collect();
    let count = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), count, "an identifier twice");
    root
}

/// The page of a report without what differs between two runs on the same input: the date, and the
/// section of times.
///
/// # Panics
/// Where it lacks either.
pub fn lasting(page: &str) -> String {
    let part = |text: &str, from: &str, to: &str| {
        let (before, rest) = text.split_once(from).unwrap_or_else(|| panic!("no {from}"));
        let (_, after) = rest.split_once(to).unwrap_or_else(|| panic!("no {to}"));
        format!("{before}{after}")
    };
    part(&part(page, "<time", "</time>"), "<section id=\"run\"", "</section>")
}

impl<'a> Reader<'a> {
    fn fail(&self, why: &str) -> ! {
        let at = self.all.len() - self.rest.len();
        let near: String = self.rest.chars().take(60).collect();
        panic!("{why} at byte {at}: {near}")
    }

    fn take(&mut self, what: &str) {
        match self.rest.strip_prefix(what) {
            Some(rest) => self.rest = rest,
            None => self.fail(&format!("not {what:?}")),
        }
    }

    fn until(&mut self, end: char) -> &'a str {
        let Some(at) = self.rest.find(end) else { self.fail(&format!("no {end:?}")) };
        let (part, rest) = self.rest.split_at(at);
        self.rest = rest;
        part
    }

    fn name(&mut self) -> &'a str {
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-';
        let end = self.rest.find(|c| !is_part(c)).unwrap_or(self.rest.len());
        let (name, rest) = self.rest.split_at(end);
        if name.is_empty() {
            self.fail("no name");
        }
        self.rest = rest;
        name
    }

    fn element(&mut self) -> Element {
        self.take("<");
        let name = self.name();
        if !ALLOWED.contains(&name) {
            self.fail(&format!("the element {name}"));
        }
        let mut element = Element { name: name.to_owned(), ..Element::default() };
        while !self.rest.starts_with('>') {
            self.take(" ");
            let attribute = self.name();
            self.take("=\"");
            let value = self.until('"');
            self.take("\"");
            let value = self.unescaped(value);
            self.check(name, attribute, &value);
            if element.attributes.insert(attribute.to_owned(), value).is_some() {
                self.fail(&format!("{attribute} twice"));
            }
        }
        self.take(">");
        if name == "style" {
            element.text = self.until('<').to_owned();
            let loads = ["url(", "@import", "expression", "\\"];
            assert!(!loads.iter().any(|l| element.text.contains(l)), "a style that loads");
        } else if !VOID.contains(&name) {
            self.content(&mut element);
        }
        if !VOID.contains(&name) {
            self.take(&format!("</{name}>"));
        }
        element
    }

    fn content(&mut self, element: &mut Element) {
        loop {
            let text = self.until('<');
            element.text += &self.unescaped(text);
            if self.rest.starts_with("</") {
                return;
            }
            let child = self.element();
            element.text += &child.text;
            element.children.push(child);
        }
    }

    fn unescaped(&self, text: &str) -> String {
        if text.contains(['<', '>']) {
            self.fail("a bracket that had to be escaped, before here");
        }
        let is_control = |c: char| c.is_control() && c != '\n';
        if text.contains(is_control) {
            self.fail("a control character, before here");
        }
        let mut parts = text.split('&');
        let mut out = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let names = [("amp;", '&'), ("lt;", '<'), ("gt;", '>'), ("quot;", '"')];
            let found = names.iter().find_map(|(n, c)| Some((part.strip_prefix(n)?, *c)));
            let Some((rest, c)) = found else {
                self.fail("an & that had to be escaped, before here")
            };
            out.push(c);
            out += rest;
        }
        out
    }

    fn check(&self, element: &str, attribute: &str, value: &str) {
        let loads = ["href", "srcset", "action", "background", "poster", "srcdoc"];
        if attribute.starts_with("on") || loads.contains(&attribute) {
            self.fail(&format!("the attribute {attribute}"));
        }
        let picture = value.strip_prefix("data:image/png;base64,");
        let is_base64 = |c: char| c.is_ascii_alphanumeric() || "+/=".contains(c);
        if attribute == "src"
            && (element != "img"
                || !picture.is_some_and(|p| !p.is_empty() && p.chars().all(is_base64)))
        {
            self.fail("a source that is not within the page");
        }
        if attribute == "style" && value.contains("url") {
            self.fail("a style that loads");
        }
    }
}
