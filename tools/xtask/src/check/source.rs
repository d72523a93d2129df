//! Tells Rust code from comments and strings.

/// `text` with comments, strings and character literals blanked; bytes keep their places.
pub fn code_only(text: &str) -> String {
    blanked(text, |piece| piece.is_none())
}

/// `text` with all but its comments blanked; bytes keep their places.
pub fn comments_only(text: &str) -> String {
    blanked(text, |piece| piece.is_some_and(|p| p.starts_with("//") || p.starts_with("/*")))
}

/// Keeps what `keep` says of a comment, string or character, or of `None` for code; blanks the rest.
fn blanked(text: &str, keep: impl Fn(Option<&str>) -> bool) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    let mut in_word = false;
    while let Some(c) = rest.chars().next() {
        let skip = if in_word { 0 } else { prefixed(rest) };
        let skip = if skip > 0 { skip } else { plain(rest) };
        let taken = if skip > 0 { skip } else { c.len_utf8() };
        let (now, later) = rest.split_at(taken);
        if keep((skip > 0).then_some(now)) {
            out.push_str(now);
        } else {
            out.extend(now.bytes().map(|b| if b == b'\n' { '\n' } else { ' ' }));
        }
        in_word = skip == 0 && is_word(c);
        rest = later;
    }
    out
}

/// Whether a character can be part of a name.
pub fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Places where `name` stands as a whole word.
pub fn words<'a>(code: &'a str, name: &'a str) -> impl Iterator<Item = usize> + 'a {
    let free = move |at: usize| {
        let before = code[..at].chars().next_back();
        let after = code[at + name.len()..].chars().next();
        !before.is_some_and(is_word) && !after.is_some_and(is_word)
    };
    code.match_indices(name).map(|(at, _)| at).filter(move |&at| free(at))
}

/// Bytes of a comment, string or character that starts here without a prefix letter, else 0.
fn plain(s: &str) -> usize {
    if s.starts_with("//") {
        s.find('\n').unwrap_or(s.len())
    } else if s.starts_with("/*") {
        block_comment(s)
    } else if s.starts_with('"') {
        quoted(s, '"')
    } else if s.starts_with('\'') {
        character(s)
    } else {
        0
    }
}

/// The same for `r"…"`, `br#"…"#`, `b"…"`, `c"…"` and `b'…'`.
fn prefixed(s: &str) -> usize {
    let letters = s.len() - s.trim_start_matches(['b', 'c', 'r']).len();
    if letters == 0 || letters > 2 {
        return 0;
    }
    let (prefix, rest) = s.split_at(letters);
    let hashes = rest.len() - rest.trim_start_matches('#').len();
    if prefix.ends_with('r') && rest[hashes..].starts_with('"') {
        let close = format!("\"{}", "#".repeat(hashes));
        let body = &rest[hashes + 1..];
        let end = body.find(&close).map_or(body.len(), |at| at + close.len());
        letters + hashes + 1 + end
    } else if rest.starts_with('"') {
        letters + quoted(rest, '"')
    } else if prefix == "b" && rest.starts_with('\'') {
        letters + quoted(rest, '\'')
    } else {
        0
    }
}

fn quoted(s: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, c) in s.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            c if c == quote => return at + c.len_utf8(),
            _ => {}
        }
    }
    s.len()
}

/// A character literal is closed by a quote after one character or an escape; else it is a lifetime.
fn character(s: &str) -> usize {
    let mut chars = s.char_indices().skip(1);
    match (chars.next(), chars.next()) {
        (Some((_, '\\')), _) => quoted(s, '\''),
        (Some(_), Some((at, '\''))) => at + 1,
        _ => 0,
    }
}

fn block_comment(s: &str) -> usize {
    let (mut depth, mut at) = (0, 0);
    while at < s.len() {
        if s[at..].starts_with("/*") {
            depth += 1;
            at += 2;
        } else if s[at..].starts_with("*/") {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += s[at..].chars().next().map_or(1, char::len_utf8);
        }
    }
    s.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_strings_are_blanked_and_code_stays() {
        let cases = [
            ("a // x\nb", "a     \nb"),
            ("a /* x /* y */ z */ b", "a                   b"),
            ("f(\"x\\\"y\") + 1", "f(      ) + 1"),
            ("r#\"x \" y\"# b", "           b"),
            ("'x' '\\'' 'é' b", "              b"),
            ("fn f<'a>(x: &'a str)", "fn f<'a>(x: &'a str)"),
            ("bar\"x\"", "bar   "),
            ("rcb", "rcb"),
        ];
        for (text, code) in cases {
            let code = code.to_owned();
            let got = code_only(text);
            assert_eq!(got.trim_end(), code.trim_end(), "{text}");
            assert_eq!(got.lines().count(), text.lines().count(), "{text}");
            assert_eq!(got.len(), text.len(), "{text}");
        }
    }

    #[test]
    fn comments_stay_and_code_and_strings_are_blanked() {
        let text = "a(\"// x\"); // y\n/* z */ 'c' b";
        assert_eq!(comments_only(text), "           // y\n/* z */      ");
    }

    #[test]
    fn words_are_whole() {
        let code = "unsafe_code unsafe (unsafe) notunsafe";
        assert_eq!(words(code, "unsafe").collect::<Vec<_>>(), [12, 20]);
    }
}
