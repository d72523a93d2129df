#!/usr/bin/env python3
"""Compares the outputs of two builds of intima byte by byte. See README.md.

    equality.py BEFORE AFTER --data DIR [--out DIR] [--only TEXT]

BEFORE and AFTER are two programs. Each runs every case of cases.py in a folder of its own; then every
file, standard output included, is compared. In JSON the fields that hold times, memory and rates are
left out. Exit code 1 where anything differs.
"""

import argparse
import hashlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time

from cases import CASES

HERE = pathlib.Path(__file__).resolve().parent

#: Fields of JSON that differ from run to run.
MEASURED = re.compile(
    r"(^ms|_ms|_s|_seconds|memory_mb|gb_per_s|m_per_s|of_copy)$|^(p50_ms|p99_ms|stages|version)$"
)


def without_times(value):
    """The value without fields that hold measured times, memory or rates."""
    if isinstance(value, dict):
        kept = {k: without_times(v) for k, v in value.items() if not MEASURED.search(k)}
        return {k: v for k, v in kept.items() if k != "flight_seconds" or v}
    if isinstance(value, list):
        return [without_times(v) for v in value]
    return value


def digest(path):
    """Hash of a file; of JSON, of its text without times."""
    data = path.read_bytes()
    if path.suffix == ".json" or path.name.endswith("stdout"):
        try:
            data = json.dumps(without_times(json.loads(data)), sort_keys=True).encode()
        except ValueError:
            pass
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def run(program, case, data, folder):
    """Runs a case; the outputs are in `folder`. Returns seconds and exit codes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    start = time.monotonic()
    codes = []
    for i, command in enumerate(case.commands):
        args = [a.replace("{data}", str(data)).replace("{here}", str(HERE)) for a in command.split()]
        if any("{dicom:" in a for a in args):
            args = [re.sub(r"\{dicom:(\w+)\}", lambda m: unzipped(data, m[1], folder), a) for a in args]
        out = subprocess.run(
            [program, *args], cwd=folder, capture_output=True, env={**os.environ, "NO_COLOR": "1", "XDG_CACHE_HOME": str(folder / "cache")}
        )
        codes.append(out.returncode)
        (folder / ("stdout" if len(case.commands) == 1 else f"{i}.stdout")).write_bytes(out.stdout)
        if out.returncode != 0:
            (folder / f"{i}.stderr").write_bytes(out.stderr)
    return time.monotonic() - start, codes


def unzipped(data, name, folder):
    """Folder of a zipped DICOM series, unpacked once beside the outputs."""
    target = folder.parent.parent / "dicom" / name
    if not target.is_dir():
        import zipfile

        zipfile.ZipFile(data / f"{name}.zip").extractall(target)
    return str(target)


def files(folder):
    """Outputs of a case by their path."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {str(p.relative_to(folder)): p for p in found if "cache" not in p.parts}


def main():
    """Runs and compares."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("--data", required=True, type=pathlib.Path)
    parser.add_argument("--out", default="out/equality", type=pathlib.Path)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    args = parser.parse_args()
    programs = [str(pathlib.Path(p).resolve()) for p in (args.before, args.after)]
    data, out = args.data.resolve(), args.out.resolve()
    differing = 0
    print(f"{'case':<34} {'files':>5} {'before s':>8} {'after s':>8}  result")
    for case in CASES:
        if args.only not in case.name:
            continue
        folders = [out / side / case.name for side in ("before", "after")]
        runs = [run(p, case, data, f) for p, f in zip(programs, folders)]
        before, after = (files(f) for f in folders)
        wrong = [n for n in sorted(before.keys() | after.keys())
                 if n not in before or n not in after or digest(before[n]) != digest(after[n])]
        if runs[0][1] != runs[1][1]:
            wrong.append(f"exit codes {runs[0][1]} and {runs[1][1]}")
        if any(runs[0][1]):
            wrong.append(f"exit codes {runs[0][1]}")
        differing += bool(wrong)
        said = "equal" if not wrong else "DIFFERENT: " + ", ".join(wrong[:4])
        print(f"{case.name:<34} {len(before):>5} {runs[0][0]:>8.1f} {runs[1][0]:>8.1f}  {said}", flush=True)
    print(f"{differing} of the cases differ" if differing else "all cases are equal")
    sys.exit(differing > 0)


if __name__ == "__main__":
    main()
