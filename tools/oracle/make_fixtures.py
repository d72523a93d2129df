#!/usr/bin/env python3
"""Writes every fixture under tests/fixtures, or with --check says which of them no longer hold.

--check compares decoded content, so that another zlib does not matter; floats to 1e-9 relative.
"""

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

import codec_files
import counts
import edt
import fair
import grow
import masks
import nrrd_file
import ridge
import route
import segmentation
import surface_files

ROOT = Path(__file__).resolve().parents[2] / "tests" / "fixtures"
LIMIT = 500_000


def text(value):
    """JSON with one row a line where rows are lists of numbers."""

    def flat(v):
        return not isinstance(v, (dict, list)) or (
            isinstance(v, list) and all(not isinstance(x, (dict, list)) for x in v)
        )

    def put(v, pad):
        if flat(v):
            return json.dumps(v, separators=(",", ":"))
        inner = pad + " "
        if isinstance(v, dict):
            items = [f"{json.dumps(k)}: {put(x, inner)}" for k, x in v.items()]
            left, right = "{", "}"
        else:
            items = [put(x, inner) for x in v]
            left, right = "[", "]"
        return left + "\n" + ",\n".join(inner + i for i in items) + "\n" + pad + right

    return (put(value, "") + "\n").encode("ascii")


def fixtures():
    """path below tests/fixtures -> bytes"""
    every = masks.every()
    out = {}
    for name, (mask, spacing) in every.items():
        out[f"mask/{name}.mask.nrrd"] = nrrd_file.dumps(mask.astype(np.uint8), spacing)
        out[f"mask/{name}.edt.nrrd"] = nrrd_file.dumps(edt.distance(mask, spacing), spacing)
        if len(set(spacing)) == 1:
            out[f"mask/{name}.edt2.nrrd"] = nrrd_file.dumps(edt.squared(mask), spacing)
    out["counts.json"] = text({n: counts.describe(*v) for n, v in every.items()})
    for name in ridge.MASKS:
        out[f"ridge/{name}.json"] = text(ridge.fixture(*every[name]))
    out["route.json"] = text({n: route.fixture(*every[n]) for n in route.MASKS})
    about = {}
    for name, mask, spacing in fair.every():
        files, about[name] = fair.fixture(mask, spacing)
        out |= {f"fair/{name}.{suffix}": data for suffix, data in files.items()}
    out["fair/about.json"] = text(about)
    grey, level, recipes = grow.fixture()
    out["grow/grey.nrrd"] = nrrd_file.dumps(grey, grow.SPACING)
    out["grow/level.nrrd"] = nrrd_file.dumps(level, grow.SPACING)
    out["grow/recipes.json"] = text(recipes)
    files, truth = segmentation.fixture()
    out |= {f"seg/{name}": data for name, data in files.items()}
    out["seg/truth.nrrd"] = nrrd_file.dumps(truth, segmentation.SPACING)
    files, truths = codec_files.fixture()
    out |= {f"codec/{name}": data for name, data in files.items()}
    out |= {f"codec/{name}": nrrd_file.dumps(data, (1, 1, 1)) for name, data in truths.items()}
    files, truth = surface_files.fixture()
    out |= {f"vtp/{name}": data for name, data in files.items()}
    out["vtp/cone.json"] = text(truth)
    return out


def close(a, b):
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(close(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(close, a, b))
    if isinstance(a, float) or isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-9)
    return a == b


def same(path, new, old):
    if path.endswith(".json"):
        return close(json.loads(new), json.loads(old))
    if path.startswith("seg/") and path != "seg/truth.nrrd":
        (a, names), (b, others) = segmentation.pixels(new), segmentation.pixels(old)
        return names == others and np.array_equal(a, b)
    if path.endswith(".vtp"):
        return surface_files.content(new) == surface_files.content(old)
    if path.endswith(".nrrd"):
        (a, s), (b, t) = nrrd_file.loads(new), nrrd_file.loads(old)
        return s == t and a.shape == b.shape and a.dtype == b.dtype and np.allclose(a, b, rtol=1e-12, atol=0)
    if path.endswith((".f32", ".f64")):
        code, tol = ("<f4", 1e-6) if path.endswith("32") else ("<f8", 1e-9)
        return len(new) == len(old) and np.allclose(np.frombuffer(new, code), np.frombuffer(old, code), atol=tol)
    return new == old


def main():
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--check", action="store_true", help="compare with the files there are; write nothing")
    check = p.parse_args().check
    made = fixtures()
    there = {str(f.relative_to(ROOT)) for f in ROOT.rglob("*") if f.is_file()}
    extra = there - made.keys()
    if check:
        wrong = [n for n, data in made.items() if n not in there or not same(n, data, (ROOT / n).read_bytes())]
        for name in sorted(wrong) + sorted(extra):
            print("not as made:", name, file=sys.stderr)
        return 1 if wrong or extra else 0
    for name, data in made.items():
        (ROOT / name).parent.mkdir(parents=True, exist_ok=True)
        (ROOT / name).write_bytes(data)
    for name in sorted(extra):
        print("nothing makes", name, file=sys.stderr)
    total = sum(map(len, made.values()))
    print(f"{len(made)} files, {total} bytes (limit {LIMIT})")
    return 0 if total <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
