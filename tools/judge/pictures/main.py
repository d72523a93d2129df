"""Pictures of intima beside VTK's, from the same places.

Started by `cargo xtask judge pictures`, which builds intima and installs what this needs. README.md says what is drawn."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
sys.path[:0] = [str(HERE), *(str(HERE.parent / part) for part in ("walls", "common"))]

import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

import places  # noqa: E402
import report  # noqa: E402
import sheets  # noqa: E402
import view  # noqa: E402
from cases import CASES  # noqa: E402
from files import read_csv, unzipped  # noqa: E402
from program import Failed, Program  # noqa: E402
from scans import read, series  # noqa: E402

DATA = ROOT.parent / "shared" / "data"
SIZE, FRAMES = (640, 480), 240


def arguments():
    """The command line, as `cargo xtask judge pictures` passes it on."""
    parser = argparse.ArgumentParser(prog="cargo xtask judge pictures", description=__doc__)
    parser.add_argument("--intima", type=Path, required=True, help=argparse.SUPPRESS)
    parser.add_argument("--before", type=Path, metavar="PATH", help="a second build of intima, as a column of its own")
    parser.add_argument("--cases", default="", metavar="A,B", help="only cases whose name holds A or B")
    parser.add_argument("--data", type=Path, default=DATA, metavar="DIR", help="volumes (default: ../shared/data)")
    parser.add_argument("--out", type=Path, default=Path("out/pictures"), metavar="DIR")
    parser.add_argument("--docs", action="store_true", help="also write docs/pictures.md and its sheets")
    args = parser.parse_args()
    wanted = [c for c in args.cases.split(",") if c]
    args.cases = [c for c in CASES if not wanted or any(w in c.name for w in wanted)]
    if not args.cases:
        parser.error(f"no such case; there are {', '.join(c.name for c in CASES)}")
    if args.docs and (wanted or args.before):
        parser.error("--docs takes all cases and no other build")
    if not any((args.data / c.file).exists() for c in args.cases):
        parser.error(f"{args.data} holds none of the volumes; --data says where they are")
    return args


def size_text():
    return f"{SIZE[0]}x{SIZE[1]}"


def flight(program, lumen, folder):
    """Flies -> (Flight, all frames)."""
    path = folder / "path.json"
    program.run("run", *lumen, "--tree", "--out", folder / "run", "--frames", FRAMES, "--size", size_text(),
                "--write-path", path)
    line = read_csv(folder / "run" / "centerline.csv")
    files = sorted((folder / "run" / "frames").glob("frame_*.png"))
    frames = [np.asarray(Image.open(f).convert("RGB")) for f in files]
    return places.Flight.of(json.loads(path.read_text()), line), frames


def before(program, lumen, flown, taken, folder):
    """What another build draws at the frames `taken`, or why it does not."""
    found = []
    for frame in taken:
        pose = {**flown.poses[frame], "seconds": 0.0}
        path, out = folder / f"pose-{frame}.json", folder / f"before-{frame}"
        path.write_text(json.dumps({"schema": "intima.path/1", "space": "LPS", "unit": "mm",
                                    "fov_y_deg": flown.fov_y_deg, "poses": [pose]}))
        try:
            program.run("record", *lumen, "--path", path, "--frames", 1, "--out", out, "--size", size_text())
            found.append(np.asarray(Image.open(next(out.rglob("frame_*.png"))).convert("RGB")))
        except Failed as e:
            found.append(str(e))
    return found


def translucent(program, lumen, flown, taken, folder):
    """What the frames `taken` show of the tissue behind the wall."""
    path, out = folder / "poses.json", folder / "translucent"
    poses = [{**flown.poses[frame], "seconds": float(i)} for i, frame in enumerate(taken)]
    path.write_text(json.dumps({"schema": "intima.path/1", "space": "LPS", "unit": "mm",
                                "fov_y_deg": flown.fov_y_deg, "poses": poses}))
    program.run("record", *lumen, "--path", path, "--out", out, "--size", size_text(), "--view", "translucent")
    return [np.asarray(Image.open(f).convert("RGB")) for f in sorted(out.rglob("frame_*.png"))]


def drawn(case, args):
    """-> (what is known of a case's sheet, its rows)."""
    folder = args.out / "files" / case.name
    folder.mkdir(parents=True, exist_ok=True)
    source = args.data / case.file
    if source.suffix == ".zip":
        source = series(unzipped(source, args.out / "files" / source.stem))
    lumen = case.lumen(source)
    flown, frames = flight(Program("intima", args.intima), lumen, folder)
    look = [(f["mean"], f["relief"]) for f in map(sheets.figures, frames)]
    chosen = places.chosen(case.kind, flown, look)
    taken = [frame for _, frame in chosen]
    columns, cells = ["intima"], [[frames[i] for i in taken]]
    walls = view.walls(case, view.near(read(source), flown.eye))
    for name, wall, at_eye in [(*next(iter(walls.items())), False), *((n, w, True) for n, w in walls.items())]:
        window = view.Window(wall, SIZE, flown.fov_y_deg, at_eye)
        columns.append(f"{name}, {'light at the eye' if at_eye else 'its headlight'}")
        cells.append([window.draw(flown.poses[i]) for i in taken])
    if case.ct:
        columns.append("intima, translucent")
        cells.append(translucent(Program("intima", args.intima), lumen, flown, taken, folder))
    if args.before:
        columns.append("intima before")
        cells.append(before(Program("before", args.before), lumen, flown, taken, folder))
    rows, known = [], []
    for k, (place, frame) in enumerate(chosen):
        pictures = [column[k] for column in cells]
        rows.append((f"{place}: frame {frame}, radius {flown.radius_mm[frame]:.1f} mm", pictures))
        known.append({"place": place, "frame": frame, "radius_mm": float(flown.radius_mm[frame]), "pose": flown.poses[frame],
                      "figures": [sheets.figures(p) if isinstance(p, np.ndarray) else None for p in pictures]})
    return {"columns": columns, "rows": known}, rows


def main():
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    machine = report.machine(args.intima)
    results = {"machine": f"{machine['date']}, {machine['intima']} ({machine['commit']}), Vulkan: "
                          f"{', '.join(machine['vulkan'])}; VTK {view.vtk.vtkVersion.GetVTKVersion()}", "cases": []}
    pages = {}
    for case in args.cases:
        about = {**asdict(case), "sheet": f"{case.name}.png"}
        if not (args.data / case.file).exists():
            print(f"{case.name}: {case.file} is not in {args.data}", flush=True)
            continue
        try:
            found, rows = drawn(case, args)
            sheets.save(sheets.sheet(found["columns"], rows), args.out / about["sheet"])
            if case.publishable():
                pages[case.name] = sheets.sheet(found["columns"], sheets.smaller(rows))
            about.update(found)
            print(f"{args.out / about['sheet']}: {len(rows)} places", flush=True)
        except Failed as e:
            about["error"] = str(e)
            print(f"{case.name}: {e}", flush=True)
        results["cases"].append(about)
    (args.out / "results.json").write_text(json.dumps(results, indent=1))
    (args.out / "index.md").write_text(sheets.index(results))
    (args.out / "index.html").write_text(sheets.web(results))
    print(f"{args.out / 'index.md'}, {args.out / 'index.html'}")
    if args.docs:
        sheets.docs(ROOT / "docs" / "pictures.md", ROOT / "docs" / "pictures", results, pages)
    if any("error" in c for c in results["cases"]):
        sys.exit(1)


if __name__ == "__main__":
    main()
