"""Normal smoothing (vertices fixed) by a sparse matrix in float64.

Start: area-weighted face normals, unit, into the lumen, rounded to f32 (what a program holds). A step is
  n <- normalize((1 - 0.5) n + 0.5 W n),   and a vertex whose sum is shorter than 1e-6 keeps its normal
with W's rows summing to one; entries 1 (`uniform`) or 1 / max(|v_i - v_j|, 1e-3 h_min) (`inverse-distance`) over the
vertices that share an edge. Vertices never move.
"""

import numpy as np
from scipy.sparse import coo_matrix, diags
from skimage.measure import marching_cubes

import masks

STEPS = 30
LAMBDA = 0.5


def mesh(mask, spacing):
    """-> positions f32 [V, 3] (x, y, z mm; voxel (0, 0, 0)'s centre at the origin), faces u32 [F, 3] turned so that
    face normals point into the lumen."""
    v, f, n, _ = marching_cubes(
        np.pad(mask, 1).astype(np.float32), 0.5, spacing=spacing[::-1], method="lorensen"
    )
    v = (v - np.array(spacing[::-1]))[:, ::-1].astype(np.float32)
    f = f.astype(np.uint32)
    if enclosed(v, f) > 0:  # counter-clockwise from outside: turn
        f = f[:, ::-1].copy()
    return np.ascontiguousarray(v), f


def enclosed(v, f):
    a, b, c = (v[f[:, i]].astype(float) for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def start(v, f):
    p = v.astype(float)
    face = np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]])
    n = np.zeros_like(p)
    for corner in range(3):
        np.add.at(n, f[:, corner], face)
    return (n / np.linalg.norm(n, axis=1)[:, None]).astype(np.float32)


def weights(v, f, kind, h_min):
    i = f[:, [0, 1, 2, 1, 2, 0]].ravel().astype(int)
    j = f[:, [1, 2, 0, 0, 1, 2]].ravel().astype(int)
    link = coo_matrix((np.ones(len(i)), (i, j)), shape=(len(v), len(v))).tocsr()
    link.data[:] = 1.0
    if kind == "inverse-distance":
        e = link.tocoo()
        length = np.linalg.norm(v[e.row].astype(float) - v[e.col].astype(float), axis=1)
        link = coo_matrix((1 / np.maximum(length, 1e-3 * h_min), (e.row, e.col)), link.shape).tocsr()
    return diags(1 / np.asarray(link.sum(1)).ravel()) @ link


def fair(normals, w):
    n = normals.astype(float)
    for _ in range(STEPS):
        m = (1 - LAMBDA) * n + LAMBDA * (w @ n)
        length = np.linalg.norm(m, axis=1)[:, None]
        n = np.where(length < 1e-6, n, m / np.maximum(length, 1e-300))
    return n


def every():
    """name -> dict of file suffix to bytes, and a description"""
    d = (15, 14, 9)
    yield "torus", masks.torus(d, masks.ISO, (7.1, 6.6, 4.0), 4.4, 2.1), masks.ISO
    d = (12, 12, 9)
    s = masks.THICK
    yield "capsule_thick", masks.tube(d, s, masks.centre(d, s), (0.3, 0.2, 1), 2.9, 5.5), s


def fixture(mask, spacing):
    v, f = mesh(mask, spacing)
    n = start(v, f)
    faired = {k: fair(n, weights(v, f, k, min(spacing))) for k in ("uniform", "inverse-distance")}
    files = {
        "in.f32": np.concatenate([v, n]).astype("<f4").tobytes(),
        "faces.u32": f.astype("<u4").tobytes(),
        "out.f64": np.concatenate(list(faired.values())).astype("<f8").tobytes(),
    }
    about = {
        "vertices": len(v),
        "faces": len(f),
        "spacing_mm": list(spacing),
        "steps": STEPS,
        "lambda": LAMBDA,
        "euler": len(v) - len(f) // 2,
        "in.f32": ["position [V,3] mm", "start normal [V,3]"],
        "faces.u32": ["corner [F,3]"],
        "out.f64": ["normal after, uniform [V,3]", "normal after, inverse-distance [V,3]"],
    }
    return files, about
