"""intima beside what one would use instead: times, memory and accuracy from one run.

Started by `cargo xtask judge speed`, which builds intima and installs the peers. Every call of a peer is in a process of
its own, and the programs of a case take turns, so that a machine that slows down slows all of them down. README.md
says how to read the result."""

import argparse
import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]

import report  # noqa: E402
import score  # noqa: E402
from files import read_line, read_nrrd, read_ply  # noqa: E402
from inputs import Case, make  # noqa: E402
from job import CALLS, load  # noqa: E402
from stages import STAGES  # noqa: E402

DATA = ROOT.parent / "shared" / "data"
TIMEOUT_S = 1200
GLACIAL_S = 10.0  # what takes longer has one round, or WHOLE_ROUNDS where processes are timed from start to exit
WHOLE_ROUNDS = 3
NOT_HERE = ("error: unrecognized subcommand", "error: unexpected argument")
READERS = {".nrrd": read_nrrd, ".ply": read_ply, ".csv": read_line}


class Failed(Exception):
    """Why a row has no time."""


def arguments():
    """The command line, as `cargo xtask judge speed` passes it on."""
    parser = argparse.ArgumentParser(prog="cargo xtask judge speed", description=__doc__)
    parser.add_argument("--intima", required=True, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--stages", default=",".join(STAGES), help=f"of {', '.join(STAGES)} (default: all)")
    parser.add_argument("--sizes", choices=("quick", "full"), default="full")
    parser.add_argument("--cases", default="", metavar="A,B", help="only inputs whose name holds A or B")
    parser.add_argument("--repeat", type=int, default=5, metavar="N", help="rounds (default 5)")
    parser.add_argument("--vmtk", metavar="PYTHON", help="an interpreter that can import vmtk")
    parser.add_argument("--without", default="", metavar="A,B", help="leave out rows whose program's name holds A or B")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of real volumes; with full sizes it is "
                        "../shared/data beside the repository where that is there")
    parser.add_argument("--out", type=Path, default=Path("out/speed"), metavar="DIR")
    parser.add_argument("--render", action="store_true", help="only write table and plot of DIR/results.json anew")
    parser.add_argument("--readme", action="store_true", help="also put the short table into docs/comparison.md")
    args = parser.parse_args()
    args.cases, args.without = ([part for part in text.split(",") if part] for text in (args.cases, args.without))
    unknown = set(args.stages.split(",")) - set(STAGES)
    if unknown or args.repeat < 1:
        parser.error(f"no such stage: {', '.join(sorted(unknown))}" if unknown else "--repeat is at least 1")
    if args.data is None and args.sizes == "full" and DATA.is_dir():
        args.data = DATA
    return args


def run(command, environment=None):
    """-> (what it printed last as JSON or {}, wall seconds)."""
    began = time.perf_counter()
    try:
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=TIMEOUT_S,
                              env=environment, check=False)
    except subprocess.TimeoutExpired as e:
        raise Failed(f"took more than {TIMEOUT_S} s") from e
    wall = time.perf_counter() - began
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        if any(line.startswith(NOT_HERE) for line in lines):
            raise Failed("not in this build")
        said = [line for line in lines if line.startswith("error:")] or lines[-1:] or [f"ended with {done.returncode}"]
        raise Failed(said[0][:200])
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else {}, wall


class Ours:
    """A command of intima on a case."""

    def __init__(self, args, stage, name, case):
        self.stage, self.out = stage, args.out / "outputs" / f"{case.name}-{name.replace(' ', '')}"
        make_command, lumen = stage.ours[name]
        self.cache, self.keeps = (args.out / "cache").resolve(), name.endswith("again")
        self.environment = {**os.environ, "XDG_CACHE_HOME": str(self.cache)}
        command, self.path = make_command(case, str(self.out))
        self.command, self.lumen = [args.intima, *command, "--json"], None
        if not stage.whole:
            self.command += ["--repeat", CALLS]
        if lumen:
            out = self.out.with_suffix(".lumen.nrrd")
            self.lumen = [args.intima, "segment", *lumen(case), "--binary", "-o", out, "--json", "--repeat", CALLS]

    def round(self, _first):
        if self.stage.whole and not self.keeps:  # a first run; the driver may keep what is its own
            shutil.rmtree(self.cache / "intima", ignore_errors=True)
        said, wall = run(self.command, self.environment)
        found = {"peak_mb": said.get("peak_memory_mb"), "also": {
            "stages_ms": {s["name"]: s["ms"] for s in said.get("stages", [])}}}
        if self.stage.whole:
            return {**found, "times": [wall], "min_s": wall, "calls": 1}
        lumen = run(self.lumen)[0] if self.lumen else {"median_s": 0.0, "min_s": 0.0}
        more = lumen["median_s"] + said.get("dense_s", 0.0)  # and what brings the result into the peers' form
        if self.lumen:
            found["also"]["lumen_s"] = lumen["median_s"]
        own, least = said["median_s"], said["min_s"]
        if self.stage.span:  # of the median run
            own = least = sum(found["also"]["stages_ms"][name] for name in self.stage.span) / 1e3
        return {**found, "times": [own + more], "min_s": least + more - lumen["median_s"] + lumen["min_s"],
                "calls": said["runs"]}

    def output(self):
        if self.path is None:
            return None
        found = READERS[Path(self.path).suffix](self.path)
        return found[0] if self.path.endswith(".nrrd") else found

    def version(self):
        return subprocess.check_output([str(self.command[0]), "-V"], text=True).split()[-1]


class Peer:
    """A peer on a case."""

    def __init__(self, args, stage, name, case):
        self.stage, (self.package, place, *more) = stage, stage.peers[name]
        self.python, self.environment, self.prepare = sys.executable, None, None
        self.out = args.out / "outputs" / f"{case.name}-{''.join(c for c in name if c.isalnum())}"
        self.saved = self.out.with_name(self.out.name + ".npz")
        if self.package == "vmtk":
            if not args.vmtk:
                raise Failed("not installed")
            self.python = args.vmtk
            self.environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        if stage.whole:
            self.command = [self.python, HERE / "peers/chain.py", case.folder, case.name, self.out, *more, "100",
                            "1280x720"]
        else:
            self.command = [self.python, HERE / "job.py", place, json.dumps(more), case.folder, case.name]
        if name in stage.prepares:
            _, place, *more = stage.prepares[name]
            self.prepare = [sys.executable, HERE / "job.py", place, json.dumps(more), case.folder, case.name,
                            case.small_wall()]

    def round(self, first):
        if self.stage.whole:
            said, wall = run(self.command, self.environment)
            return {"times": [wall], "min_s": wall, "calls": 1, "peak_mb": said["peak_mb"]}
        also = {"mesh_s": statistics.median(run(self.prepare)[0]["times"])} if self.prepare else {}
        said, _ = run([*self.command, self.saved if first else "-"], self.environment)
        return {**said, "times": [statistics.median(said["times"])], "min_s": min(said["times"]),
                "calls": len(said["times"]), "also": {**said["also"], **also}}

    def output(self):
        return read_line(self.out / "centerline.csv") if self.stage.whole else load(self.saved)

    def version(self):
        ask = f"from importlib.metadata import version; print(version({self.package!r}))"
        return subprocess.check_output([str(self.python), "-c", ask], text=True, env=self.environment).strip()


def measure(args, key, name):
    """The rows of one stage and case: every program in turn, `--repeat` rounds."""
    stage, case = STAGES[key], Case(args.out / "inputs", name)
    make(case, args.data)
    rows, turns = [], []
    for program in [*stage.ours, *stage.peers]:
        if any(part in program for part in args.without):
            continue
        row = {"stage": key, "case": name, "program": program, "ours": program in stage.ours}
        rows.append(row)
        try:
            runner = (Ours if row["ours"] else Peer)(args, stage, program, case)
            turns.append((row, runner, []))
        except (Failed, KeyError) as e:
            row["error"] = str(e) if isinstance(e, Failed) else "needs what this input lacks"
    for number in range(args.repeat):
        for row, runner, rounds in turns:
            slow = rounds[0]["times"][0] if rounds else 0
            most = args.repeat if slow <= GLACIAL_S else WHOLE_ROUNDS if stage.whole else 1
            if "error" in row or number >= most:
                continue
            try:
                rounds.append(runner.round(number == 0))
                if number == 0:
                    row["version"] = runner.version()
                    found = runner.output()
                    row.update({} if found is None else getattr(score, stage.score)(case, found))
            except Failed as e:
                row["error"] = str(e)
            except Exception as e:  # whatever a program leaves, it is one row and not the end
                row["error"] = f"its output could not be scored: {type(e).__name__}: {e}"
    for row, _, rounds in turns:
        row.update(summary(rounds) if rounds else {})
    for row in rows:
        print(report.line(row), flush=True)
    return rows


def summary(rounds):
    """One row of what several rounds found."""
    peaks = [r["peak_mb"] for r in rounds if r.get("peak_mb")]
    also = [r.get("also", {}) for r in rounds]
    more = {k: v if isinstance(v, dict) else statistics.median(a[k] for a in also) for k, v in also[-1].items()}
    return {"median_s": statistics.median(r["times"][0] for r in rounds), "min_s": min(r["min_s"] for r in rounds),
            "n": sum(r["calls"] for r in rounds), "rounds": len(rounds), "peak_mb": max(peaks, default=None), **more}


def main():
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / "results.json"
    if not args.render:
        (args.out / "outputs").mkdir(exist_ok=True)
        machine, rows = report.machine(args.intima), []
        for key in args.stages.split(","):
            stage = STAGES[key]
            print(f"\n== {stage.title}", flush=True)
            names = (stage.quick if args.sizes == "quick" else stage.full) + (stage.real if args.data else [])
            for name in names if not args.cases else [n for n in names if any(part in n for part in args.cases)]:
                rows += measure(args, key, name)
                machine["load_end"] = os.getloadavg()[0]
                made = {"machine": machine, "sizes": args.sizes, "repeat": args.repeat, "rows": rows}
                kept.write_text(json.dumps(made, indent=1))
    report.write(args.out, json.loads(kept.read_text()))
    if args.readme:
        report.readme(ROOT / "docs/comparison.md", json.loads(kept.read_text()))
    print("\n" + shlex.join(["ls", str(args.out)]) + ": table.md results.json plot.svg")


if __name__ == "__main__":
    main()
