"""Runs intima: its JSON output, wall and processor time, peak memory."""

import json
import os
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

AIR = ":-455"  # half-way between the phantoms' gas and wall


class Failed(Exception):
    """A command that failed, with its error message."""


@dataclass
class Run:
    """One finished command."""

    report: dict
    wall_s: float
    cpu_s: float
    peak_mb: float

    def stages(self):
        """Milliseconds of each stage."""
        return {s["name"]: s["ms"] for s in self.report["stages"]}

    def kernels(self, stage):
        """Milliseconds of each kernel of a stage."""
        return {k["kernel"]: k["ms"] for s in self.report["stages"] if s["name"] == stage for k in s.get("kernels", [])}


class Intima:
    """The program, and a folder for its inputs and outputs."""

    def __init__(self, program, out, rounds):
        self.program, self.out, self.rounds = program, out, rounds
        (out / "files").mkdir(parents=True, exist_ok=True)

    def file(self, name):
        """Path of a file in that folder."""
        return self.out / "files" / name

    def run(self, *command, cache=None):
        """Runs a command with `--json`. The peak is `ru_maxrss`, not the program's own figure.

        `cache` is a folder in place of the user's cache."""
        line = [str(self.program), *map(str, command), "--json"]
        environment = os.environ | ({"XDG_CACHE_HOME": str(Path(cache).resolve())} if cache else {})
        with tempfile.TemporaryFile() as report, tempfile.TemporaryFile() as errors:
            began = time.perf_counter()
            child = subprocess.Popen(line, stdout=report, stderr=errors, env=environment)
            _, status, used = os.wait4(child.pid, 0)
            wall = time.perf_counter() - began
            child.returncode = os.waitstatus_to_exitcode(status)
            report.seek(0)
            errors.seek(0)
            if child.returncode:
                lines = [s for s in errors.read().decode(errors="replace").splitlines() if s.strip()]
                raise Failed(f"{command[0]}: {(lines or [f'ended with {child.returncode}'])[0][:200]}")
            lines = [s for s in report.read().decode().splitlines() if s.startswith("{")]
        answer = json.loads(lines[-1]) if lines else {}
        return Run(answer, wall, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6)

    def phantom(self, size, kind="colon", noise=True):
        """-> (a CT-like volume, a point in its lumen as `X,Y,Z` mm), made once."""
        path = self.file(f"{kind}_{size}.nrrd")
        note = path.with_suffix(".json")
        if not note.exists():
            report = self.run("phantom", kind, "--size", size, "-o", path, *(["--noise"] if noise else [])).report
            note.write_text(json.dumps(report))
        start = json.loads(note.read_text())["start_mm"]
        return path, ",".join(f"{x:.4f}" for x in start)


def chain(intima, volume, chosen, extra=()):
    """Milliseconds of each stage of the chain on a volume, each command in a process of its own.

    `chosen` are the flags that choose the lumen. -> ({stage: ms}, lumen voxels)"""
    common = [volume, *chosen, *extra]
    segment = intima.run("segment", *common, "-o", intima.file("o.nrrd"), "--repeat", 3)
    distance = intima.run("distance", *common, "-o", intima.file("o.nrrd"), "--repeat", 3).stages()["distance"]
    line = intima.run("centerline", *common, "-o", intima.file("o.csv"), "--repeat", 3)
    surface = intima.run("surface", *common, "-o", intima.file("o.ply"), "--repeat", 3).stages()
    found, kernels = line.stages(), line.kernels("distance, ridge")
    edt = sum(ms for name, ms in kernels.items() if name.startswith("edt"))
    lumen = segment.report["lumen"]
    return {
        "segment": segment.stages()["segment"],
        "distance": distance,
        "ridge": found["distance, ridge"] - edt,
        "route": found["route"],
        "visibility": found["reach"] + found["visibility"] + found["unseen"],
        "surface": surface["surface"] + surface["topology"],
        "fair": surface["fair"],
    }, lumen["internal_voxels"] + lumen["boundary_voxels"]


def folder(path):
    """Creates a folder."""
    path = Path(path)
    path.mkdir(parents=True, exist_ok=True)
    return path
