"""Reads pages of reports with html5lib, strict, and compares their numbers with report.json."""

import json
import sys
from pathlib import Path

import html5lib

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
LOADING = {"script", "link", "iframe", "object", "embed", "base", "form", "video", "audio", "source"}
# Parts of the report that the sections of the page show; others may show any number of it.
PARTS = {
    "profile": ["profile"],
    "centerline": ["centerline"],
    "coverage": ["coverage"],
    "tree": ["centerline", "tree"],
    "organ": ["organ"],
    "lumen": ["lumen"],
    "wall": ["wall"],
    "surface": ["surface"],
}


def numbers(value):
    """All numbers below a value, with the lengths of its lists."""
    if isinstance(value, dict):
        for v in value.values():
            yield from numbers(v)
    elif isinstance(value, list):
        yield float(len(value))
        for v in value:
            yield from numbers(v)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield float(value)


def shown_as(text, value):
    """Whether a text is a value or its per cent, rounded as far as the text goes."""
    text = text.replace("\u202f", "").replace("\u2212", "-")
    step = 0.5 * 10.0 ** -len(text.partition(".")[2])
    return any(abs(float(text) - v) <= step * (1 + 1e-9) for v in (value, 100 * value))


def check(path):
    parser = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False)
    document = parser.parse(path.read_text(encoding="utf-8"))
    report = json.loads((path.parent / "report.json").read_text(encoding="utf-8"))
    policies = [m.get("content") for m in document.iter("meta") if m.get("http-equiv")]
    assert policies == [POLICY], policies
    for element in document.iter():
        name = str(element.tag).rpartition("}")[2]
        assert name not in LOADING, name
        for key, value in element.attrib.items():
            assert not str(key).startswith("on") and key not in ("href", "srcset"), key
            assert key != "src" or value.startswith("data:image/png;base64,"), value[:60]
    count = 0
    for section in document.iter("section"):
        part = report
        for key in PARTS.get(section.get("id"), []):
            part = part[key]
        known = set(numbers(part))
        for data in section.iter("data"):
            value = float(data.get("value"))
            assert value in known, f"{section.get('id')}: {value} is not in the report"
            assert shown_as(data.text, value), f"{value} is shown as {data.text}"
            count += 1
    images = sum(1 for _ in document.iter("img"))
    print(f"{path}: {count} numbers as in report.json, {images} pictures, no error of HTML")


def main():
    failed = False
    for name in sys.argv[1:]:
        try:
            check(Path(name))
        except Exception as e:  # any fault of a page, with its page
            print(f"{name}: {type(e).__name__}: {e}")
            failed = True
    sys.exit(failed)


if __name__ == "__main__":
    main()
