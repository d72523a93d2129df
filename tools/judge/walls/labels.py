"""Rows of label maps: bodies in random poses, as masks, made into surfaces by intima and by VTK."""

import numpy as np

import shapes
import vtk_walls
from files import read_ply, write_nrrd
from program import Failed
from score import spread, tunnels
from volumes import grid

SEED = 977_001
SIDE_MM = 56.0
SPACINGS = {"1:1:1": (1.0, 1.0, 1.0), "1:1:2": (1.0, 1.0, 2.0), "1:1:5": (1.0, 1.0, 5.0)}
SHAPES = {
    "ball": lambda p: np.linalg.norm(p, axis=-1) - 20,
    "torus": lambda p: shapes.torus(p, 15, 6),
    "capsule": lambda p: shapes.capsule(p, [0, 0, -10], [0, 0, 10], 8),
    "tube 2": lambda p: shapes.capsule(p, [0, 0, -21], [0, 0, 21], 2),
    "tube 5": lambda p: shapes.capsule(p, [0, 0, -17], [0, 0, 17], 5),
    "plate": lambda p: shapes.box(p, [30, 30, 1.5]),
}


def cases(full):
    """(shape, ratio, poses)"""
    if full:
        return [(s, r, 8) for r in SPACINGS for s in SHAPES]
    return [(s, r, 1) for r in ("1:1:1", "1:1:5") for s in SHAPES]


def title(case):
    return f"{case[0]}, {case[1]}"


def pose(shape, ratio, index):
    """-> (seed, function of points in the volume)."""
    seed = SEED + 1000 * list(SHAPES).index(shape) + 100 * list(SPACINGS).index(ratio) + index
    random = np.random.default_rng(seed)
    q = random.standard_normal(4)
    turn = shapes.turn(q[:3], np.degrees(2 * np.arctan2(np.linalg.norm(q[:3]), q[3])))
    centre = SIDE_MM / 2 + random.uniform(-0.5, 0.5, 3) * SPACINGS[ratio]
    return seed, lambda p: SHAPES[shape]((p - centre) @ turn)


def _score(mesh, distance, mask, spacing):
    found = {**spread(distance(mesh[0][np.unique(mesh[1])])), **tunnels(mesh)}
    found["wrong_side"] = int((vtk_walls.filled(mesh, mask.shape, spacing, (0.0, 0.0, 0.0)) != mask).sum())
    return found


def _mean(poses):
    """Of several poses: means, and the worst maximum; violations are added up."""
    together = {k: float(np.mean([p[k] for p in poses])) for k in poses[0]}
    together["rms_least_mm"], together["rms_most_mm"] = (f(p["rms_mm"] for p in poses) for f in (min, max))
    together["max_mm"] = max(p["max_mm"] for p in poses)
    together["wrong_side"] = sum(p["wrong_side"] for p in poses)
    return together


def rows(case, programs, folder, want_peers=True):
    """A row for each program, over all poses."""
    shape, ratio, count = case
    spacing, found, seeds, errors = SPACINGS[ratio], {}, [], {}
    dims = tuple(int(SIDE_MM / h) + 1 for h in spacing)
    for index in range(count):
        seed, distance = pose(shape, ratio, index)
        seeds.append(seed)
        mask = distance(grid(dims, spacing)) < 0
        path = folder / f"label-{seed}.nrrd"
        write_nrrd(path, mask.astype(np.uint8), spacing)
        for program in programs:
            out = path.with_suffix(".ply")
            try:
                program.surface(out, "--mask", path, "--all-components", "--no-fill")
                found.setdefault(program.name, []).append(_score(read_ply(out), distance, mask, spacing))
            except Failed as e:
                errors[program.name] = str(e)
        for name, make in vtk_walls.OF_MASKS.items() if want_peers else ():
            mesh = make(mask, spacing, (0.0, 0.0, 0.0))
            found.setdefault(name, []).append(_score(mesh, distance, mask, spacing))
    ours = {p.name for p in programs}
    about = {"part": "labels", "case": title(case), "shape": shape, "ratio": ratio, "seeds": seeds}
    for name, poses in found.items():
        yield {**about, "program": name, "ours": name in ours, "poses": len(poses), **_mean(poses)}
    for name, error in errors.items():
        yield {**about, "program": name, "ours": True, "error": error}
