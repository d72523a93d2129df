"""Accuracy of an output against the truth, the same for every program. Lengths in mm, angles in degrees.

Each function takes (case, output) and returns a flat dict; outputs are arrays as formats.py and job.py leave them."""

from functools import lru_cache

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

SAMPLES = 100_000
SEED = 7


@lru_cache(maxsize=1)
def _true_distance(case):
    """In double precision, over the box around the organ; outside the volume is outside the organ."""
    mask, spacing = case.volume("mask")
    box, truth = ndimage.find_objects(mask, 1)[0], np.zeros(mask.shape)
    inner = ndimage.distance_transform_edt(np.pad(mask[box], 1), sampling=spacing[::-1])
    truth[box] = inner[1:-1, 1:-1, 1:-1]
    return truth


def distance(case, field):
    inside = case.volume("mask")[0] > 0
    error = np.abs(field[inside] - _true_distance(case)[inside])
    return {"max_mm": float(error.max()), "wrong": float((error > 1e-3).mean())}


@lru_cache(maxsize=1)
def _true_eigenvalues(case, sigma_mm):
    """Ascending, of every inside voxel, and which voxels those are."""
    inside = case.volume("mask")[0] > 0
    array, spacing = case.volume("ct")
    steps, hessian = np.array(spacing[::-1]), np.empty((int(inside.sum()), 3, 3))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        order = np.bincount([i, j], minlength=3)
        part = ndimage.gaussian_filter(array.astype(float), sigma_mm / steps, order=order, truncate=6.0)
        hessian[:, i, j] = hessian[:, j, i] = part[inside] / (steps[i] * steps[j])
    return inside, np.linalg.eigvalsh(hessian)


def eigenvalues(case, found):
    """Against the largest true eigenvalue there is. Nothing for a response of one component."""
    from stages import SIGMA_MM
    if found.ndim == 3:
        return {}
    inside, truth = _true_eigenvalues(case, SIGMA_MM)
    error = (np.sort(found[inside], axis=1) - truth) / np.abs(truth).max()
    return {"rms": float(np.sqrt((error ** 2).mean())), "max": float(np.abs(error).max())}


def ridge(case, response):
    mask, spacing = case.volume("mask")
    inside = np.argwhere(mask > 0)
    off, _ = cKDTree(case.phantom().axis).query(inside[:, ::-1] * np.array(spacing), workers=-1)
    values = response[mask > 0]
    strong = values >= np.quantile(values, 0.98)
    return {"strong_mm": float(off[strong].mean()), "all_mm": float(off.mean())}


def overlap(case, grown):
    found = {"voxels": int((grown > 0).sum())}
    if case.phantom():
        mask = case.volume("mask")[0] > 0
        found["dice"] = float(2 * (mask & (grown > 0)).sum() / (mask.sum() + found["voxels"]))
    return found


def _unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30)


def _degrees(a, b):
    """Between directions of unknown sign: the whole set is turned round where most of it is."""
    angle = np.degrees(np.arccos(np.clip((_unit(a) * _unit(b)).sum(1), -1, 1)))
    return 180 - angle if np.median(angle) > 90 else angle


def _angles(angle):
    return {"angle_mean": float(angle.mean()), "angle_p99": float(np.percentile(angle, 99)),
            "angle_max": float(angle.max())}


def _topology(vertices, faces):
    """Whether every edge has two faces, run through once each way; faces without area."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth, back = (np.sort(edges[:, i] * (faces.max() + 1) + edges[:, 1 - i]) for i in (0, 1))
    closed = len(np.unique(forth)) == len(forth) and np.array_equal(forth, back)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return {"faces": len(faces), "degenerate": int((area < 1e-12).sum()), "closed": "yes" if closed else "no"}


def _wall(case, vertices):
    off = case.phantom().distance(vertices)
    return {"wall_rms_mm": float(np.sqrt((off ** 2).mean())), "wall_max_mm": float(np.abs(off).max())}


def _some(used):
    pick = np.random.default_rng(SEED).choice(len(used), min(len(used), SAMPLES), replace=False)
    return used[pick]


def wall(case, mesh):
    """Vertices against the formula."""
    vertices, faces, _ = mesh
    found = _topology(vertices, faces)
    return {**found, **_wall(case, vertices[_some(np.unique(faces))])} if case.phantom() else found


def normals(case, mesh):
    """Vertices and their normals against the formula, each where the vertex is."""
    vertices, faces, given = mesh
    used = _some(np.unique(faces))
    angle = _degrees(given[used], case.phantom().normal(vertices[used]))
    return {**_angles(angle), **_wall(case, vertices[used])}


def weighted_normals(vertices, faces):
    """Face normals summed at the vertices by the angle there."""
    corners = [vertices[faces[:, k]] for k in range(3)]
    face, sums = _unit(np.cross(corners[1] - corners[0], corners[2] - corners[0])), np.zeros_like(vertices)
    for k in range(3):
        ahead, back = (_unit(corners[(k + d) % 3] - corners[k]) for d in (1, 2))
        weight = np.arccos(np.clip((ahead * back).sum(1), -1, 1))
        for axis in range(3):
            sums[:, axis] += np.bincount(faces[:, k], face[:, axis] * weight, len(vertices))
    return _unit(sums)


def _spread(vertices, faces, seed):
    """Points spread evenly over a mesh: faces, and barycentric coordinates in them."""
    random = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    face = np.searchsorted(area / area[-1], random.random(SAMPLES)).clip(0, len(faces) - 1)
    u, v = np.sqrt(random.random((SAMPLES, 1))), random.random((SAMPLES, 1))
    return face, np.hstack([1 - u, u * (1 - v), u * v])


def _at(values, faces, face, share):
    """What the corners' values are in between."""
    return (values[faces[face]] * share[..., None]).sum(1)


def _nearest(points, vertices, faces):
    """-> distance to the mesh, face, and barycentric coordinates there."""
    import igl
    squared, face, at = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), np.ascontiguousarray(vertices), np.ascontiguousarray(faces))[:3]
    corners = [vertices[faces[face, k]] for k in range(3)]
    whole = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    parts = [np.cross(corners[(k + 1) % 3] - at, corners[(k + 2) % 3] - at) for k in range(3)]
    share = np.stack([(p * whole).sum(1) for p in parts], 1) / np.maximum((whole ** 2).sum(1), 1e-30)[:, None]
    return np.sqrt(np.maximum(squared, 0)), face, share.clip(0, 1)


def simplified(case, mesh):
    """Against the input and its normals, which are the formula's."""
    vertices, faces, given = mesh
    vertices, source = np.asarray(vertices, float), case.mesh()
    given = weighted_normals(vertices, faces) if given is None else given
    spread, own = _spread(*source[:2], SEED), _spread(vertices, faces, SEED + 1)
    points, truth = (_at(values, source[1], *spread) for values in (source[0], source[2]))
    there, face, share = _nearest(points, vertices, faces)
    back, _, _ = _nearest(np.concatenate([_at(vertices, faces, *own), vertices[np.unique(faces)]]), *source[:2])
    shaded = _at(given, faces, face, share)
    both = 0.5 * ((there ** 2).mean() + (back ** 2).mean())
    return {**_topology(vertices, faces), **_angles(_degrees(shaded, truth)),
            "rms_mm": float(np.sqrt(both)), "max_mm": float(max(there.max(), back.max()))}


def line(case, points):
    """A path against the axis (what goes beyond the axis' ends left out) and against the wall."""
    from files import resample
    spacing = np.array(case.about()["spacing"])
    fine = resample(points, 0.25 * spacing.min())
    found = _clearance(case, resample(points, max(1.0, spacing.max())), spacing)
    way = _unit(np.diff(resample(points, 1.0), axis=0))
    found["turn"] = float(np.degrees(np.arccos(np.clip((way[1:] * way[:-1]).sum(1), -1, 1))).mean())
    phantom = case.phantom()
    if phantom:
        axis = resample(phantom.axis, 0.02 * spacing.min())  # so fine that its nearest sample is its nearest point
        off, foot = cKDTree(axis).query(fine)
        inner = (foot > 0) & (foot < len(axis) - 1)
        gap, _ = cKDTree(fine).query(axis)
        found.update(mean_mm=float(off[inner].mean()), max_mm=float(off[inner].max()),
                     covered=float((gap <= np.maximum(-phantom.value(axis), 0)).mean()))
    return found


def _clearance(case, points, spacing, rays=24):
    """Distance to the wall at each point over the largest in the section across, found along rays."""
    truth = _true_distance(case)

    def look(p):
        return ndimage.map_coordinates(truth, (p / spacing).T[::-1], order=1, mode="nearest")
    way = _unit(np.gradient(points, axis=0))
    u = _unit(np.cross(way, np.where(np.abs(way[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]])))
    v, step = np.cross(way, u), 0.5 * spacing.min()
    here = look(points)
    best = here.copy()
    for turn in np.arange(rays) * (2 * np.pi / rays):
        ray, alive = np.cos(turn) * u + np.sin(turn) * v, np.arange(len(points))
        for k in range(1, int(2 * truth.max() / step) + 2):
            there = look(points[alive] + k * step * ray[alive])
            best[alive] = np.maximum(best[alive], there)
            alive = alive[there > 0.5 * step]
            if not len(alive):
                break
    ends = max(1, len(points) // 50)
    ratio = (here / np.maximum(best, 1e-9))[ends:-ends]
    return {"clear_mean": float(ratio.mean()), "clear_min": float(ratio.min())}
