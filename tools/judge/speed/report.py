"""What was measured, for people: a table, a plot, and the short table of docs/comparison.md."""

import json
import os
import platform
import subprocess
from datetime import datetime, timezone
from pathlib import Path
from xml.sax.saxutils import escape

from inputs import GRIDS, MESHES, REAL
from pages import replace_between
from stages import STAGES

MARKS = ("<!-- compare: written by `cargo xtask judge speed --readme` -->", "<!-- /compare -->")


def machine(intima):
    """What the figures depend on and a reader needs to know."""
    def said(*command):
        try:
            return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
        except OSError:
            return ""
    cpu = [line.split(":", 1)[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    system = [line.split("=", 1)[1].strip('"') for line in _lines("/etc/os-release") if line.startswith("PRETTY_NAME")]
    devices = json.loads(said(str(intima), "devices", "--json") or "[]")
    memory = [int(line.split()[1]) // 1000 for line in _lines("/proc/meminfo") if line.startswith("MemTotal")]
    commit = said("git", "-C", str(Path(__file__).resolve().parent), "rev-parse", "--short", "HEAD")
    return {"date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
            "cpu": (cpu or [platform.processor() or platform.machine()])[0], "cores": os.cpu_count(),
            "memory_mb": (memory or [None])[0], "os": (system or [platform.platform()])[0],
            "vulkan": [d["name"] for d in devices], "python": platform.python_version(),
            "intima": said(str(intima), "-V"), "commit": commit,
            "load_start": os.getloadavg()[0]}


def _lines(path):
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []


def number(value):
    """Three figures, or as it is."""
    if value is None:
        return ""
    if not isinstance(value, float):
        return f"{value:,}" if isinstance(value, int) else str(value)
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def line(row):
    """A row while it is measured."""
    shown = {k: v for k, v in row.items() if k not in ("stage", "case", "program", "ours", "stages_ms", "before_mb")}
    found = row.get("error") or "  ".join(f"{k} {number(v)}" for k, v in shown.items())
    return f"{row['case']:<15} {row['program']:<40} {found}"


def case_name(case):
    """`colon_256` as a reader says it."""
    kind, _, grid = case.partition("_")
    if case in MESHES or case in REAL:
        return case.replace("_", " ")
    return f"{kind} {'x'.join(map(str, GRIDS[grid][0]))}"


def groups(results):
    """-> (stage, case, rows, our first row's median or None) in the order measured."""
    found = {}
    for row in results["rows"]:
        found.setdefault((row["stage"], row["case"]), []).append(row)
    for (stage, case), rows in found.items():
        ours = [r["median_s"] for r in rows if r["ours"] and "median_s" in r]
        yield stage, case, rows, (ours or [None])[0]


def whole_s(row):
    """With the mesh that a peer needs before its call."""
    return row["median_s"] + row.get("mesh_s", 0.0)


def setting(results):
    """Date and machine in a sentence or two."""
    m = results["machine"]
    return (f"{m['date']}, {m['intima']} ({m['commit']}), {m['cpu']}, {m['cores']} cores, {m['os']}, Vulkan: "
            f"{', '.join(m['vulkan']) or 'none'}. Sizes: {results['sizes']}; rounds: {results['repeat']}; load when it "
            f"began {m['load_start']:.1f}, at the end {m.get('load_end', 0):.1f}.")


def table(results):
    """Everything, stage by stage, as Markdown."""
    out = ["# How intima compares", "", setting(results), "",
           "Seconds are medians over the rounds; `n` counts timed calls; `÷ intima` is a time over that of "
           "the first row of intima. Peaks are of the whole process: for "
           "peers that is Python and libraries too. Input in memory to output in memory, unless said.", ""]
    last = None
    for stage, case, rows, ours in groups(results):
        about = STAGES[stage]
        if stage != last:
            heads = ["input", "program", "version", "median s", "min s", "÷ intima", "n", "peak MB",
                     *(head for _, head, _ in about.columns)]
            out += ["", f"## {about.title}", "", f"{about.note} Not in intima's time: {about.left_out}.", "",
                    f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
            last = stage
        for row in sorted(rows, key=lambda r: (not r["ours"], r.get("median_s", 1e9))):
            name = f"**{row['program']}**" if row["ours"] else row["program"]
            cells = [case_name(case), name, row.get("version", "")]
            if "error" in row:
                cells += [row["error"].replace("|", "/")] + [""] * (len(heads) - 4)
            else:
                ratio = number(row["median_s"] / ours) if ours else None
                if ours and "mesh_s" in row:
                    ratio += f" ({number(whole_s(row) / ours)} with its mesh)"
                peak = row["peak_mb"] and round(row["peak_mb"])
                cells += [number(v) for v in (row["median_s"], row["min_s"], ratio, row["n"], peak)]
                cells += [number(row.get(key)) for key, _, _ in about.columns]
            out.append(f"| {' | '.join(cells)} |")
    return "\n".join(out) + "\n"


def plot(results):
    """Each peer's time over ours as a bar on a logarithmic scale, SVG."""
    bars = []
    for stage, case, rows, ours in groups(results):
        timed = [r for r in rows if not r["ours"] and "median_s" in r and "error" not in r]
        if ours and timed:
            bars.append((f"{STAGES[stage].title} - {case_name(case)}: {number(ours)} s", None))
            bars += [(r["program"], whole_s(r) / ours) for r in sorted(timed, key=whole_s)]
    ratios = [r for _, r in bars if r] or [1.0]
    low, high = min(0.1, *ratios) / 1.5, max(10.0, *ratios) * 3
    left, width, row_px, top = 300, 960, 17, 56

    def x(ratio):
        from math import log
        return left + (width - left - 20) * log(ratio / low) / log(high / low)
    m = results["machine"]
    few = escape(f"{m['date']}, {m['intima']}, {m['cpu']}, {m['cores']} cores, {results['sizes']} sizes")
    height = top + row_px * len(bars) + 16
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" '
           f'font-size="12"><rect width="{width}" height="{height}" fill="white"/>',
           '<text x="12" y="20" font-size="15">Time of other programs over that of intima (logarithmic)</text>',
           f'<text x="12" y="38" fill="#666">{few}</text>']
    tick = 10.0 ** -6
    while tick < high:
        if tick > low:
            out.append(f'<path d="M{x(tick):.1f} {top - 4}V{height - 10}" stroke="{"#000" if tick == 1 else "#ddd"}"/>'
                       f'<text x="{x(tick):.1f}" y="{top - 7}" text-anchor="middle" fill="#666">{tick:g}x</text>')
        tick = round(tick * 10, 6)
    for i, (name, ratio) in enumerate(bars):
        y = top + row_px * i + 12
        if ratio is None:
            out.append(f'<text x="12" y="{y}" font-weight="bold">{escape(name)}</text>')
            continue
        a, b = sorted((x(1), x(ratio)))
        colour = "#2f6fb0" if ratio >= 1 else "#d08020"
        out.append(f'<text x="{left - 8}" y="{y}" text-anchor="end">{escape(name)}</text>'
                   f'<rect x="{a:.1f}" y="{y - 10}" width="{max(b - a, 1):.1f}" height="12" fill="{colour}"/>'
                   f'<text x="{b + 4:.1f}" y="{y}">{number(ratio)}x</text>')
    return "\n".join(out) + "\n</svg>\n"


def left_out(stage, row):
    """What of intima's work is not in its time, and how long that takes where the command says it."""
    about = STAGES[stage]
    rest = [ms for name, ms in row.get("stages_ms", {}).items() if name not in about.span] if about.span else []
    return about.left_out + (f": {number(sum(rest) / 1e3)} s" if rest else "")


def short(results):
    """A line for each stage and input: ours, the fastest other program, the most accurate other."""
    heads = ["stage", "input", "measure", "intima", "not in intima's time", "fastest other", "most accurate other"]
    out = [setting(results) + " Seconds are from input in memory to output in memory, of the chain from start to exit.",
           "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for stage, case, rows, ours in groups(results):
        judged = [column for column in STAGES[stage].columns if column[2]]
        # Without a formula behind the input the first measure may not be had.
        key, head, better = next((c for c in judged if any(r.get(c[0]) is not None for r in rows)), judged[0])
        good = [r for r in rows if "median_s" in r and "error" not in r]
        others = [r for r in good if not r["ours"]]
        if ours is None or not others:
            continue
        scored = [r for r in others if r.get(key) is not None]

        def cell(row, named=True):
            name = f"{row['program']} {row['version']}: " if named else ""
            mesh = f" + {number(row['mesh_s'])} s for its mesh" if "mesh_s" in row else ""
            found = "none" if row.get(key) is None else number(row[key])
            return f"{name}{number(row['median_s'])} s{mesh}, {found}"
        fastest = min(others, key=whole_s)
        best = min(scored, key=lambda r: (r[key] if better == "less" else -r[key], whole_s(r)), default=None)
        last = "" if best is None else "the same" if best is fastest else cell(best)
        mine = next(r for r in good if r["ours"])
        cells = [STAGES[stage].title, case_name(case), head, cell(mine, False), left_out(stage, mine), cell(fastest),
                 last]
        out.append(f"| {' | '.join(cells)} |")
    return "\n".join(out) + "\n"


def write(out, results):
    """table.md and plot.svg beside results.json."""
    (out / "table.md").write_text(table(results))
    (out / "plot.svg").write_text(plot(results))


def readme(path, results):
    """The short table between the marks of docs/comparison.md."""
    replace_between(path, MARKS, short(results))
