"""What was measured, for people: tables, the short table of docs/comparison.md, the record."""

import json
import os
import platform
import re
import subprocess
from datetime import datetime, timezone
from pathlib import Path

from pages import replace_between

MARKS = ("<!-- truth: written by `cargo xtask judge walls --readme` -->", "<!-- /truth -->")
TITLES = {
    "phantoms": ("CT volumes with known walls",
                 "Signed distance of vertices from the wall, mm; minus is too narrow. `leak` is volume farther than 1 "
                 "mm outside; `missed` the share of the lumen deeper than 1 mm that is left out; `T` the lumen's "
                 "threshold, `core` the share of the true lumen that it takes. `hole`: share of a fold's area without "
                 "tissue; `thin`: with less than half the true thickness."),
    "labels": ("Label maps with known walls",
               "Distance of vertices from the wall, in voxels of 1 mm; means over the poses. `wrong side` counts voxel "
               "centres that the surface puts on the other side than the mask."),
    "scans": ("CTs without known walls",
              "Distance of the wall from the half-maximum of the grey profile across it, where the wall is thicker "
              "than its blur (grey.py)."),
    "lines": ("Published midlines and radii", "Distances between the published line and the program's, mm."),
    "coverage": ("What a flight shows of the wall",
                 "Share of the wall's area that intima reports as seen, share of boundary voxels that rays through the "
                 "mask reach, and the first less the second; one way and both ways."),
}
WALL = [("rms_mm", "rms"), ("mean_mm", "mean"), ("p95_mm", "p95"), ("p99_mm", "p99")]
ANGLE = ("normals_deg", "normals °")
MESH = [("tunnels", "tunnels"), ("components", "parts"), ("triangles", "triangles")]
LUMEN = [("threshold_hu", "T"), ("core_share", "core")]
THIN = ("0.6", "0.8", "1", "1.2")
COLUMNS = {
    "bronchi": [*WALL, *((f"bias_r{r}_mm", f"bias r {r}") for r in ("1.5", "2", "2.5", "3", "4", "5")), ANGLE,
                ("leak_mm3", "leak mm³"), ("missed_share", "missed"), *MESH, *LUMEN, ("reached", "tubes reached")],
    "carina": [*WALL, ("max_mm", "max"), ANGLE, ("ring", "rings kept"), ("leak_mm3", "leak mm³"), *MESH, *LUMEN],
    "colon": [("rms_mm", "flat rms"), ("mean_mm", "flat mean"), ANGLE, *((f"hole_{t}", f"hole {t}") for t in THIN),
              *((f"thin_{t}", f"thin {t}") for t in THIN),
              *((f"thick_{t}_mm", f"thick {t}") for t in (*THIN, "1.6", "2", "2.4")),
              *((f"polyp_{n}", f"polyp {n}") for n in (3, 4, 6)), *MESH, *LUMEN],
    "labels": [("rms_mm", "rms"), ("rms_least_mm", "least"), ("rms_most_mm", "most"), ("mean_mm", "mean"),
               ("p99_mm", "p99"), ("max_mm", "max"), ("wrong_side", "wrong side"), ("tunnels", "tunnels"),
               ("poses", "poses")],
    "scans": [("rms_mm", "rms"), ("p95_mm", "p95"), ("mean_mm", "mean"), ANGLE, ("places", "places"),
              ("judged", "judged"), *MESH],
    "lines": [("to_ours_mean_mm", "published to found, mean"), ("to_ours_p95_mm", "p95"),
              ("from_ours_mean_mm", "found to published, mean"), ("from_ours_p95_mm", "p95"), ("length_mm", "length"),
              ("published_mm", "published"), ("covered", "covered"), ("radius_mean_mm", "radius, mean off"),
              ("radius_rms_mm", "radius, rms off"), ("wall_mean_mm", "radius less distance to the mesh, mean"),
              ("wall_most_mm", "most")],
    "coverage": [*((f"{way}{key}", f"{way.replace('_', ' ')}{head}") for way in ("one_way", "both_ways")
                   for key, head in (("", ""), ("_rays", ", rays"), ("_off", ", off"))), ("boundary_voxels", "voxels")],
}


def _said(*command):
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def machine(intima):
    """What the figures depend on and a reader needs to know."""
    devices = json.loads(_said(str(intima), "devices", "--json") or "[]")
    return {"date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"), "cores": os.cpu_count(),
            "system": platform.system(), "vulkan": [d["name"] for d in devices], "python": platform.python_version(),
            "intima": _said(str(intima), "-V"),
            "commit": _said("git", "-C", str(Path(__file__).resolve().parent), "rev-parse", "--short", "HEAD")}


def number(value):
    """As short as it is plain."""
    if value is None:
        return ""
    if not isinstance(value, float):
        return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
    if value == int(value) and abs(value) >= 1 or value == 0:
        return f"{value:,.0f}"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.1f}" if abs(value) >= 100 else f"{value:.3f}"


def columns(row):
    """Which figures its table has."""
    return COLUMNS[row.get("phantom", row["part"])]


def line(row):
    """A row while it is measured."""
    found = row.get("error") or "  ".join(f"{head} {number(row[key])}" for key, head in columns(row)
                                          if row.get(key) is not None)
    return f"{row['case']:<36} {row['program']:<36} {found}"


def setting(results):
    """Date and machine in a sentence."""
    m = results["machine"]
    vulkan = ", ".join(m["vulkan"]) or "none"
    return (f"{m['date']}, {m['intima']} ({m['commit']}), {m['cores']} cores, Vulkan: {vulkan}. Sizes: "
            f"{results['sizes']}; first seed {results['seed']}; {results.get('seconds', 0) / 60:.0f} minutes.")


def _tables(rows):
    heads = []
    for row in rows:
        wanted = columns(row)
        if wanted != heads:
            heads = wanted
            names = ["input", "program", *(head for _, head in heads)]
            yield from ("", f"| {' | '.join(names)} |", "|---" * len(names) + "|")
        name = f"**{row['program']}**" if row["ours"] else row["program"]
        cells = [number(row.get(key)) for key, _ in heads]
        if "error" in row:
            cells = [row["error"].replace("|", "/")] + [""] * (len(heads) - 1)
        yield f"| {' | '.join([row['case'], name, *cells])} |"


def table(results):
    """Everything, part by part, as Markdown."""
    out = ["# Walls against the truth", "", setting(results)]
    for part, (title, note) in TITLES.items():
        rows = [r for r in results["rows"] if r["part"] == part]
        if rows:
            out += ["", f"## {title}", "", note, *_tables(rows)]
    return "\n".join(out) + "\n"


SHORT = [  # input, what its title holds, measure, key
    ("bronchi CT, noise 20 HU", "bronchi, 0.8 mm, 20 HU white", "off the wall, rms mm", "rms_mm"),
    ("the same", "bronchi, 0.8 mm, 20 HU white", "leak beyond 1 mm, mm³", "leak_mm3"),
    ("carina CT, noise 20 HU", "carina, 0.8 mm, 20 HU white", "off the wall, rms mm", "rms_mm"),
    ("the same", "carina, 0.8 mm, 20 HU white", "relief of rings kept", "ring"),
    ("colon CT, noise 20 HU", "colon, 0.8 mm, 20 HU white", "fold of 0.8 mm, share under half as thick", "thin_0.8"),
    ("the same", "colon, 0.8 mm, 20 HU white", "tunnels", "tunnels"),
    ("label map, tube of radius 2 voxels", "tube 2, 1:1:1", "off the wall, rms voxels", "rms_mm"),
    ("label map, ball, slices 5 times thicker", "ball, 1:1:5", "off the wall, rms mm", "rms_mm"),
    ("chest CT, airway", "chest CT", "off half-maximum, rms mm", "rms_mm"),
    ("colon CT", "colon CT", "off half-maximum, rms mm", "rms_mm"),
]


def short(results):
    """A line for each of a few figures: intima and every other program."""
    rows = results["rows"]
    first = next((r["program"] for r in rows if r["ours"]), "intima")
    peers = ("VTK Flying Edges", "VTK mask + windowed sinc", "VTK SurfaceNets", "VTK mask + constrained smoothing")
    heads = ["input", "measure", "intima", *peers]
    out = [setting(results), "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, case, measure, key in SHORT:
        of = [r for r in rows if r["case"].startswith(case) and r.get(key) is not None]
        mine = (f"{first}, --organ colon", first)  # of a colon phantom, what its user would do
        ours = [number(r[key]) for p in mine for r in of if r["program"] == p]
        cells = [next(iter(ours), "")]
        cells += [next((number(r[key]) for r in of if r["program"].startswith(p)), "") for p in peers]
        if cells[0]:
            out.append(f"| {' | '.join([name, measure, *cells])} |")
    return "\n".join(out) + "\n"


def record(folder, results):
    """Puts results and table below benches/results -> where."""
    m = results["machine"]
    device = (m["vulkan"] or ["cpu"])[0]
    device = "lavapipe" if "llvmpipe" in device else re.sub(r"[^a-z0-9]+", "-", device.lower()).strip("-")
    place = folder / f"{m['date'][:10]}-{device}" / "truth"
    place.mkdir(parents=True, exist_ok=True)
    rows = ",\n".join(json.dumps(row) for row in results["rows"])
    head = json.dumps({k: v for k, v in results.items() if k != "rows"})
    (place / "results.json").write_text(f"{head[:-1]}, \"rows\": [\n{rows}\n]}}\n")
    (place / "table.md").write_text(table(results))
    return place


def readme(path, results):
    """The short table between the marks of docs/comparison.md."""
    replace_between(path, MARKS, short(results))
