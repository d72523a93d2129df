"""Rows of published midlines and radii, which others made with other programs: not the truth, but not ours either."""

import numpy as np
import SimpleITK as sitk
from scipy import ndimage, sparse
from scipy.spatial import cKDTree
from vtk import vtkImplicitPolyDataDistance
from vtk.util.numpy_support import vtk_to_numpy

from files import read_csv, write_ply
from program import Failed
from vtk_data import from_poly, read_vtp, to_poly, triangles

CASES = ("colon_label_3 midline", "aorto-iliac tree")
CM = 10.0
STEP_MM = 0.25  # at which lines are sampled


def _resampled(points, values, step=STEP_MM):
    """A polyline and what lies on it, at equal steps, mm."""
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, s[-1], max(2, int(s[-1] / step)))
    return np.stack([np.interp(at, s, c) for c in points.T], 1), np.interp(at, s, values)


def _ours(path):
    """Points and radii of all branches."""
    table = read_csv(path)
    points, radius = np.stack([table[k] for k in "xyz"], 1), table["radius"]
    of = [table["branch"] == b for b in np.unique(table["branch"])]
    parts = [_resampled(points[o], radius[o]) for o in of if o.sum() > 1]
    return np.concatenate([p for p, _ in parts]), np.concatenate([r for _, r in parts])


def _apart(published, ours):
    """Both ways; the ends of a path that goes on beyond the other count."""
    there, _ = cKDTree(ours).query(published)
    back, _ = cKDTree(published).query(ours)
    return {"to_ours_mean_mm": float(there.mean()), "to_ours_p95_mm": float(np.percentile(there, 95)),
            "from_ours_mean_mm": float(back.mean()), "from_ours_p95_mm": float(np.percentile(back, 95))}


def _midline(data):
    """Image of the colon and its published midline, LPS mm."""
    image = sitk.ReadImage(str(data / "colon_label_3.nii.gz"))
    table = read_csv(data / "colon_label_3_midline.csv")
    voxels = np.stack([table[k] for k in "ijk"], 1)
    published = np.array([image.TransformContinuousIndexToPhysicalPoint(v.tolist()) for v in voxels])
    return image, _resampled(published, np.zeros(len(published)))[0]


def _compared(ours, published):
    return {"length_mm": STEP_MM * len(ours), "published_mm": STEP_MM * len(published), **_apart(published, ours)}


def _colon(data, program, folder):
    _, published = _midline(data)
    out = folder / f"colon-3-{program.name.replace(' ', '-')}.csv"
    seconds = program.run("centerline", "--mask", data / "colon_label_3.nii.gz", "-o", out)
    return {"seconds": seconds, **_compared(_ours(out)[0], published)}


def _colon_peer(data):
    """Dijkstra through voxels, between the ends of the published line."""
    image, published = _midline(data)
    mask = sitk.GetArrayFromImage(image) > 0
    ends = [image.TransformPhysicalPointToIndex(published[k].tolist())[::-1] for k in (0, -1)]
    path = voxel_path(mask, image.GetSpacing(), *ends)
    points = np.array([image.TransformIndexToPhysicalPoint([int(n) for n in v[::-1]]) for v in path])
    ours, _ = _resampled(points, np.zeros(len(points)))
    return {"program": "SciPy distance + Dijkstra", **_compared(ours, published)}


def voxel_path(mask, spacing, start, end):
    """Voxels [n, 3] (z, y, x) of the cheapest 26-connected path."""
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    deep = ndimage.distance_transform_edt(np.pad(mask[box], 1), sampling=spacing[::-1])
    number = np.cumsum(deep.ravel() > 0).reshape(deep.shape) - 1
    first, second, cost = [], [], []
    steps = [d for d in np.ndindex(3, 3, 3) if d > (1, 1, 1)]
    for d in np.array(steps) - 1:
        a, b = (tuple(slice(max(s * k, 0), n + min(s * k, 0)) for k, n in zip(d, deep.shape)) for s in (-1, 1))
        both = (deep[a] > 0) & (deep[b] > 0)
        first.append(number[a][both])
        second.append(number[b][both])
        cost.append(np.linalg.norm(d * np.array(spacing[::-1])) * (deep[a][both] ** -3 + deep[b][both] ** -3))
    n = int((deep > 0).sum())
    graph = sparse.coo_matrix((np.concatenate(cost), (np.concatenate(first), np.concatenate(second))), (n, n)).tocsr()
    low = np.array([s.start - 1 for s in box])
    ids = [int(number[tuple(np.array(v) - low)]) for v in (start, end)]
    _, before = sparse.csgraph.dijkstra(graph, directed=False, indices=ids[0], return_predecessors=True)
    back = [ids[1]]
    while before[back[-1]] >= 0:
        back.append(before[back[-1]])
    return np.argwhere(deep > 0)[back[::-1]] + low


def _vessel_mesh(data):
    """In mm: vertices and faces, and the distance to it as a function."""
    vertices, faces, _ = from_poly(triangles(read_vtp(data / "aorto_iliac_surface.vtp")))
    mesh, surface = (vertices * CM, faces, None), vtkImplicitPolyDataDistance()
    surface.SetInput(to_poly(mesh))
    return mesh, lambda points: np.abs([surface.EvaluateFunction(p) for p in points])


def _vessel_lines(data):
    lines = read_vtp(data / "aorto_iliac_centerlines.vtp")
    radius = vtk_to_numpy(lines.GetPointData().GetArray("MaximumInscribedSphereRadius")).astype(float) * CM
    return vtk_to_numpy(lines.GetPoints().GetData()).astype(float) * CM, radius


def _off_wall(radius, exact):
    return {"wall_mean_mm": float((radius - exact).mean()), "wall_most_mm": float((radius - exact).max())}


def _vessel(data, program, folder):
    mesh, exact = _vessel_mesh(data)
    file, out = folder / "aorto-iliac.ply", folder / f"aorto-iliac-{program.name.replace(' ', '-')}.csv"
    write_ply(file, mesh)
    published, radius = _vessel_lines(data)
    seconds = program.run("centerline", file, "--tree", "-o", out)
    ours, our_radius = _ours(out)
    off, foot = cKDTree(ours).query(published)
    near = off < radius / 2
    more = our_radius[foot][near] - radius[near]
    return {"seconds": seconds, **_apart(published, ours), "covered": float(near.mean()),
            **_off_wall(our_radius[::8], exact(ours[::8])),
            "radius_mean_mm": float(more.mean()), "radius_rms_mm": float(np.sqrt((more ** 2).mean()))}


def _vessel_peer(data):
    _, exact = _vessel_mesh(data)
    published, radius = _vessel_lines(data)
    return {"program": "VMTK, as published", **_off_wall(radius, exact(published))}


def rows(data, programs, folder, cases, want_peers=True):
    """A row for each program."""
    for case, measure, peer, file in zip(CASES, (_colon, _vessel), (_colon_peer, _vessel_peer),
                                         ("colon_label_3.nii.gz", "aorto_iliac_surface.vtp")):
        if case not in cases or not (data / file).exists():
            continue
        builds = list({p.path: p for p in reversed(programs)}.values())[::-1]  # how walls are drawn moves no line
        for program in builds:
            row = {"part": "lines", "case": case, "program": program.name, "ours": True}
            try:
                row.update(measure(data, program, folder))
            except Failed as e:
                row["error"] = str(e)
            yield row
        if want_peers:
            yield {"part": "lines", "case": case, "ours": False, **peer(data)}
