"""Where intima draws walls, beside where they are.

Started by `cargo xtask judge walls`, which builds intima and installs what this needs. README.md says what is measured."""

import argparse
import json
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]

import coverage  # noqa: E402
import labels  # noqa: E402
import lines  # noqa: E402
import organs  # noqa: E402
import report  # noqa: E402
import scans  # noqa: E402
from program import programs  # noqa: E402

DATA = ROOT.parent / "shared" / "data"
PARTS = ("phantoms", "labels", "scans", "lines", "coverage")


def arguments():
    """The command line, as `cargo xtask judge walls` passes it on."""
    parser = argparse.ArgumentParser(prog="cargo xtask judge walls", description=__doc__)
    parser.add_argument("--intima", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--before", type=Path, metavar="PATH", help="a second build of intima, as rows of its own")
    parser.add_argument("--wall", default="", metavar="A,B", help="passed on to `intima surface`, a row each")
    parser.add_argument("--parts", default=",".join(PARTS), metavar="A,B", help=f"of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--cases", default="", metavar="A,B", help="only inputs whose title holds one of these")
    parser.add_argument("--ours", action="store_true", help="without other programs")
    parser.add_argument("--sizes", choices=("quick", "full"), default="full")
    parser.add_argument("--data", type=Path, metavar="DIR", help="real volumes (default: ../shared/data, where it is)")
    parser.add_argument("--out", type=Path, default=Path("out/walls"), metavar="DIR")
    parser.add_argument("--render", action="store_true", help="only write tables of DIR/results.json anew")
    parser.add_argument("--record", action="store_true", help="also put them into benches/results")
    parser.add_argument("--readme", action="store_true", help="also put the short table into docs/comparison.md")
    args = parser.parse_args()
    args.data = args.data or (DATA if DATA.is_dir() else None)
    args.parts, args.wall, args.cases = ([p for p in t.split(",") if p] for t in (args.parts, args.wall, args.cases))
    if set(args.parts) - set(PARTS):
        parser.error(f"no such part: {', '.join(sorted(set(args.parts) - set(PARTS)))}")
    if not args.render and not args.intima:
        parser.error("--intima is wanted")
    return args


def chosen(names, args):
    """Those that --cases asks for."""
    return [n for n in names if not args.cases or any(c in n for c in args.cases)]


def measure(args):
    """Row after row."""
    full, folder = args.sizes == "full", args.out / "files"
    folder.mkdir(parents=True, exist_ok=True)
    mine = programs(args.intima, args.wall, args.before)
    if "phantoms" in args.parts:
        if full and not args.ours and not args.cases:
            yield from organs.truths()
        for case in organs.FULL if full else organs.QUICK:
            if chosen([organs.title(case)], args):
                yield from organs.rows(case, mine, folder, not args.ours)
    if "labels" in args.parts:
        for case in labels.cases(full):
            if chosen([labels.title(case)], args):
                yield from labels.rows(case, mine, folder, not args.ours)
    if args.data and "scans" in args.parts:
        for name in chosen(list(scans.SCANS) if full else list(scans.SCANS)[:2], args):
            yield from scans.rows(name, args.data, mine, folder, not args.ours)
    if args.data and "lines" in args.parts:
        yield from lines.rows(args.data, mine, folder, chosen(lines.CASES, args), not args.ours)
    if args.data and "coverage" in args.parts:
        for name in chosen(list(coverage.CASES) if full else list(coverage.CASES)[:1], args):
            yield from coverage.rows(name, args.data, mine, folder)


def main():
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / "results.json"
    if not args.render:
        made = {"machine": report.machine(args.intima), "sizes": args.sizes, "seed": organs.SEED, "rows": []}
        start = time.monotonic()
        for row in measure(args):
            print(report.line(row), flush=True)
            made["rows"].append(row)
            made["seconds"] = time.monotonic() - start
            kept.write_text(json.dumps(made, indent=1))
    results = json.loads(kept.read_text())
    (args.out / "table.md").write_text(report.table(results))
    print(f"\n{args.out / 'table.md'}, {kept}")
    if args.record:
        print(report.record(ROOT / "benches" / "results", results))
    if args.readme:
        report.readme(ROOT / "docs/comparison.md", results)


if __name__ == "__main__":
    main()
