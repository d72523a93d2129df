"""Pages of docs/ with a part that a judge writes."""


def replace_between(path, marks, text):
    """Puts `text` between the two marks of a page."""
    page = path.read_text()
    before, first, rest = page.partition(marks[0])
    _, last, after = rest.partition(marks[1])
    if not first or not last:
        raise SystemExit(f"{path}: no place for the text between {marks[0]} and {marks[1]}")
    path.write_text(f"{before}{first}\n\n{text}\n{last}{after}")
