"""Rows of phantoms: CT volumes of organs with known walls, made into surfaces by intima and by VTK."""

import numpy as np

import phantoms
import score
import volumes
import vtk_walls
from files import read_ply, write_nrrd
from program import Failed

SEED = 20261124
NAMES = ("bronchi", "carina", "colon")
# Phantom, noise HU, correlated, slices averaged.
QUICK = [("bronchi", 0, False, 1), ("bronchi", 20, False, 1), ("bronchi", 40, True, 1), ("bronchi", 20, False, 3),
         ("carina", 20, False, 1), ("colon", 20, False, 1), ("colon", 40, True, 1)]
FULL = [(name, sigma, grain, 1) for name in NAMES for sigma, grain in
        ((0, False), (20, False), (20, True), (40, False), (40, True), (80, False), (80, True))]
FULL += [(name, 20, False, count) for name in NAMES for count in (2, 3, 6)]


def title(case):
    """As a reader says it."""
    name, sigma, grain, count = case
    thick = phantoms.make(name).spacing[2] * count
    return f"{name}, {thick:.1f} mm, {sigma} HU{' correlated' if grain else ' white' if sigma else ''}"


def _clean(name, folder):
    kept = folder / f"{name}-clean.npy"
    if not kept.exists():
        print(f"making {name}", flush=True)
        np.save(kept, volumes.clean(phantoms.make(name)))
    return np.load(kept)


def volume(case, folder):
    """-> (phantom, array int16, spacing, origin, path)."""
    name, sigma, grain, count = case
    phantom = phantoms.make(name)
    array, spacing, origin = volumes.slices(_clean(name, folder), phantom.spacing, count)
    if sigma:
        array = array + volumes.noise(array.shape, sigma, grain, SEED + sigma + grain)
    array = np.round(array).astype(np.int16)
    path = folder / f"{name}-{sigma}{'c' if grain else 'w'}-{count}.nrrd"
    if not path.exists():
        write_nrrd(path, array, spacing, origin)
    return phantom, array, spacing, origin, path


def rows(case, programs, folder, want_peers=True):
    """One row for each program and peer."""
    phantom, array, spacing, origin, path = volume(case, folder)
    place = (array.shape, spacing, origin)
    threshold, seed, core = volumes.core(phantom, array, spacing, origin)
    value = phantom.value(volumes.grid(array.shape[::-1], spacing) + np.array(origin))
    points = volumes.grid(array.shape[::-1], spacing)[core] + np.array(origin)
    about = {"part": "phantoms", "case": title(case), "phantom": case[0], "threshold_hu": threshold,
             "core_share": float((core & (value < 0)).sum() / (value < 0).sum())}
    if case[0] == "bronchi":
        about["reached"] = phantom.reached(points)
    lumen = ["--threshold", f":{threshold:g}", "--seed-mm", ",".join(f"{s:.4f}" for s in seed)]
    ways = [("", lumen)] + ([(", --organ colon", ["--organ", "colon"])] if case[0] == "colon" else [])
    for program in programs:
        for name, way in ways:
            row = {**about, "program": program.name + name, "ours": True}
            out = folder / f"{path.stem}-{(program.name + name).replace(',', '').replace(' ', '-')}.ply"
            try:
                row["seconds"] = program.surface(out, path, *way)
                row.update(score.wall(phantom, read_ply(out), *place))
            except Failed as e:
                row["error"] = str(e)
            yield row
    if not want_peers:
        return
    grey = array.astype(np.float32)
    voxel = tuple(int(v) for v in np.round((np.array(seed) - origin) / spacing)[::-1])
    contour = vtk_walls.contour_of_lumen(grey, spacing, origin, phantom.half, voxel)
    yield {**about, "program": f"VTK Flying Edges at {phantom.half:g}", "ours": False,
           **score.wall(phantom, contour, *place)}
    mask = vtk_walls.lumen(grey, phantom.half, voxel)
    for name, make in vtk_walls.OF_MASKS.items():
        if name != "VTK mask, halfway":
            yield {**about, "program": name, "ours": False, **score.wall(phantom, make(mask, spacing, origin), *place)}


def truths():
    """The formulas against themselves: a fine contour of the signed distance, scored like any mesh."""
    for name in NAMES:
        phantom, h = phantoms.make(name), 0.3
        dims = [int(n * s / h) + 1 for n, s in zip(phantom.dims, phantom.spacing)]
        value = np.concatenate([phantom.value(z)[None] for z in volumes.grid(dims, (h,) * 3)])
        mesh = vtk_walls.contour(value.astype(np.float32), (h,) * 3, (0, 0, 0), 0.0, 50.0)
        yield {"part": "phantoms", "case": f"{name}, the formula itself", "phantom": name,
               "program": "formula, 0.3 mm grid", "ours": False,
               **score.wall(phantom, mesh, phantom.dims[::-1], phantom.spacing, (0, 0, 0))}
