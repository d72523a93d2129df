"""Sheets of pictures, the page over them, and the page in docs/."""

import html

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from pages import replace_between

MARKS = ("<!-- pictures: written by `cargo xtask judge pictures --docs` -->", "<!-- /pictures -->")
NOTICE = "Research and education only. Not for diagnosis."
GAP, LINE = 6, 26
DOCS_WIDTH = 272  # pixels of a picture in docs/
QUALITY = 74


def grey(pixels):
    """Luminance (Rec. 709 of the stored values), 0 to 255."""
    return pixels[..., :3].astype(float) @ [0.2126, 0.7152, 0.0722]


def figures(pixels):
    """What a picture shows, in figures: mean, share that is nearly black, share that is nearly white, and relief: the
    root mean square of what a mean over 1/20 of the width takes away."""
    light = grey(pixels)
    return {"mean": light.mean(), "black": (light < 16).mean(), "white": (light > 245).mean(),
            "relief": float(np.sqrt(((light - _blurred(light, light.shape[1] // 20)) ** 2).mean()))}


def _blurred(light, width):
    """A box mean along both axes; edges repeat."""
    half = width // 2
    for axis in (0, 1):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (half + 1, half)
        total = np.cumsum(np.pad(light, pad, mode="edge"), axis)
        n, width = light.shape[axis], 2 * half + 1
        light = (total.take(range(width, width + n), axis) - total.take(range(n), axis)) / width
    return light


def sheet(columns, rows):
    """Rows of (caption, [pixels, or why there are none]) under the names of the columns."""
    height, width = next(p for _, cells in rows for p in cells if isinstance(p, np.ndarray)).shape[:2]
    font = ImageFont.load_default(size=18)
    page = Image.new("RGB", (len(columns) * (width + GAP) + GAP, LINE + len(rows) * (height + LINE + GAP)), "white")
    pen = ImageDraw.Draw(page)
    for i, name in enumerate(columns):
        pen.text((GAP + i * (width + GAP), 3), name, "black", _fitting(name, width))
    for j, (caption, cells) in enumerate(rows):
        top = LINE + j * (height + LINE + GAP)
        pen.text((GAP, top + 2), caption, "black", font)
        for i, cell in enumerate(cells):
            at = (GAP + i * (width + GAP), top + LINE)
            if isinstance(cell, np.ndarray):
                page.paste(Image.fromarray(cell[..., :3]), at)
            else:
                pen.text(at, cell, "black", font)
    return page


def _fitting(text, width):
    """The largest font up to 18 pixels in which the text is no wider than its column."""
    fonts = [ImageFont.load_default(size=s) for s in range(18, 7, -1)]
    return next((f for f in fonts if f.getlength(text) <= width), fonts[-1])


def save(page, path):
    """PNG or JPEG by the path's ending, with the notice in its metadata."""
    if path.suffix == ".png":
        info = PngInfo()
        info.add_text("Comment", NOTICE)
        page.save(path, pnginfo=info, optimize=True)
    else:
        page.save(path, quality=QUALITY, optimize=True, comment=NOTICE.encode())


def smaller(rows):
    """The same rows for docs/."""
    def less(p):
        if not isinstance(p, np.ndarray):
            return p
        height = round(p.shape[0] * DOCS_WIDTH / p.shape[1])
        return np.asarray(Image.fromarray(p[..., :3]).resize((DOCS_WIDTH, height), Image.Resampling.LANCZOS))
    return [(caption, [less(p) for p in cells]) for caption, cells in rows]


def table(found):
    """Figures of a case, Markdown."""
    columns = found["columns"]
    head = "| place | frame | " + " | ".join(f"{c}: mean, black, relief" for c in columns) + " |"
    lines = [head, "|---" * (2 + len(columns)) + "|"]
    for row in found["rows"]:
        cells = [f"{f['mean']:.0f}, {100 * f['black']:.1f} %, {f['relief']:.1f}" if f else "" for f in row["figures"]]
        lines.append(f"| {row['place']} | {row['frame']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _about(found):
    licence = found["licence"] or "none found: not for publication"
    return f"Source: {found['source']}.\nLicence: {licence}."


def index(results):
    """The Markdown page in out/."""
    parts = ["# intima beside VTK, from the same places\n", f"{results['machine']}\n"]
    for found in results["cases"]:
        parts += [f"## {found['title']}\n", _about(found) + "\n"]
        if "error" in found:
            parts.append(f"Failed: {found['error']}\n")
            continue
        parts += [f"![{found['title']}]({found['sheet']})\n", table(found) + "\n"]
    return "\n".join(parts)


def web(results):
    """The same as HTML, for a browser."""
    e = html.escape
    parts = ["<!doctype html><meta charset=utf-8><title>intima beside VTK</title>",
             f"<h1>intima beside VTK, from the same places</h1><p>{e(results['machine'])}<p>{NOTICE}"]
    for found in results["cases"]:
        about = e(_about(found)).replace("\n", "<br>")
        parts.append(f"<h2>{e(found['title'])}</h2><p>{about}")
        parts.append(f"<p>Failed: {e(found['error'])}" if "error" in found else f"<img src='{found['sheet']}'>")
    return "\n".join(parts)


def docs(path, folder, results, pages):
    """Puts sheets (`pages`: case -> JPEG page) into `folder` and their sections between the marks of `path`. Of a case
    whose licence does not allow it nothing is written."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.jpg"):
        old.unlink()
    parts = [f"{results['machine']}\n"]
    for found in results["cases"]:
        if found["name"] in pages:
            save(pages[found["name"]], folder / f"{found['name']}.jpg")
            parts += [f"## {found['title']}\n", _about(found) + "\n",
                      f"![{found['title']}: {', '.join(found['columns'])}]({folder.name}/{found['name']}.jpg)\n"]
    replace_between(path, MARKS, "\n".join(parts))
