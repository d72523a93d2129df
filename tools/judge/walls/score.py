"""A mesh against the formula of its phantom. Lengths in mm; signed distances are negative where the lumen is drawn too
narrow."""

import numpy as np
import vtk
from scipy import sparse

from files import normals_of
from volumes import grid
from vtk_data import to_poly
from vtk_walls import filled

LEAK_MM = 1.0  # farther outside the wall than this is a leak


def tunnels(mesh):
    """Sum of the genera: components less half the Euler number, of a closed mesh. Half a tunnel means that it has edges
    with more than two faces."""
    vertices, faces, _ = mesh
    if not len(faces):
        return {"components": 0, "tunnels": 0}
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges = np.unique(edges, axis=0)
    n = len(vertices)
    graph = sparse.coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), (n, n))
    used = np.unique(faces)
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    parts = len(np.unique(label[used]))
    return {"components": parts, "tunnels": float(parts - (len(used) - len(edges) + len(faces)) / 2)}


def spread(distance):
    """Of signed distances."""
    if not len(distance):
        return {}
    off = np.abs(distance)
    return {"rms_mm": float(np.sqrt((off ** 2).mean())), "mean_mm": float(distance.mean()),
            "p95_mm": float(np.percentile(off, 95)), "p99_mm": float(np.percentile(off, 99)),
            "max_mm": float(off.max())}


def wall(phantom, mesh, shape, spacing, origin):
    """Everything that is asked of a mesh of `phantom`; the volume it was made of gives the voxels in which leaks are
    counted. Vertices farther out than the phantom's `parts` say (half the wall) count as leaks, not in the rms."""
    used = np.unique(mesh[1])
    vertices = mesh[0][used]
    found = {"triangles": len(mesh[1]), **tunnels(mesh)}
    if not len(vertices):
        return found
    distance = phantom.distance(vertices)
    part, reach = phantom.parts(vertices)
    near = (distance < reach) & (part >= 0)
    scored = near & (part == 0) if phantom.name == "colon" else near
    found.update(spread(distance[scored]), scored=int(scored.sum()), beyond_mm=int((distance > LEAK_MM).sum()))
    found["normals_deg"] = _normals(phantom, vertices[scored], normals_of(mesh)[used][scored])
    inside, value = filled(mesh, shape, spacing, origin), phantom.value(grid(shape[::-1], spacing) + np.array(origin))
    cell = float(np.prod(spacing))
    found["leak_mm3"] = float((inside & (value > LEAK_MM)).sum() * cell)
    found["missed_share"] = float((~inside & (value < -LEAK_MM)).sum() / (value < -LEAK_MM).sum())
    for i, radius in enumerate(phantom.radii()):
        of = distance[near & (part == i)]
        found[f"bias_r{radius:g}_mm"] = float(of.mean()) if len(of) > 20 else None
    if phantom.name == "carina":
        found["ring"] = phantom.ring(vertices, distance)
    if phantom.name == "colon":
        found.update(_folds(phantom, mesh), **_polyps(phantom, mesh))
    return found


def _normals(phantom, vertices, normals, most=5000, h=0.1):
    """Mean angle between normals and the gradient of the distance, of lines without direction."""
    if not len(vertices):
        return None
    pick = np.random.default_rng(1).permutation(len(vertices))[:most]
    p = vertices[pick]
    slope = np.stack([phantom.distance(p + h * e) - phantom.distance(p - h * e) for e in np.eye(3)], 1)
    slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-30)
    return float(np.degrees(np.arccos(np.clip(np.abs((slope * normals[pick]).sum(1)), 0, 1))).mean())


class _Rays:
    """Where lines cross a mesh."""

    def __init__(self, mesh):
        self.poly, self.finder = to_poly(mesh), vtk.vtkStaticCellLocator()
        self.finder.SetDataSet(self.poly)
        self.finder.BuildLocator()

    def crossings(self, a, b):
        """Distances from `a` along a-b, ascending, each once."""
        points, cells = vtk.vtkPoints(), vtk.vtkIdList()
        points.SetDataTypeToDouble()
        self.finder.IntersectWithLine(a, b, 1e-9, points, cells)
        at = sorted(np.linalg.norm(np.array(points.GetPoint(i)) - a) for i in range(points.GetNumberOfPoints()))
        return [s for i, s in enumerate(at) if i == 0 or s - at[i - 1] > 1e-4]


def _folds(phantom, mesh, step=0.6, rim=1.0):
    """Along lines across each fold: the share without tissue, the share with less than half of the true thickness, and
    the mean thickness where there is some. A rim along the free edge and the root is left out."""
    rays, found = _Rays(mesh), {}
    for edge, normal, up, thick in phantom.folds:
        side, reach = np.cross(normal, up), thick / 2 + 2.0
        u, v = np.meshgrid(np.arange(rim, 20, step), np.arange(-17, 17, step))
        p = edge + u.ravel()[:, None] * up + v.ravel()[:, None] * side
        p = p[phantom._tube(p) < -rim - thick / 2]
        found_here = [rays.crossings(q - reach * normal, q + reach * normal) for q in p]
        there = np.array([c[-1] - c[0] for c in found_here if len(c) >= 2])
        found[f"hole_{thick:g}"] = 1 - len(there) / len(p)
        found[f"thin_{thick:g}"] = 1 - int((there >= thick / 2).sum()) / len(p)
        found[f"thick_{thick:g}_mm"] = float(there.mean()) if len(there) else 0.0
    return found


def _polyps(phantom, mesh, step=0.1):
    """Volume between the first crossing of lines from the lumen and the colon's wall, less the same of the wall around,
    over the true volume."""
    rays, found = _Rays(mesh), {}
    for (centre, r), across in zip(phantom.polyps, phantom.across):
        x, y = phantom.way, np.cross(phantom.y, phantom.way)
        n = np.arange(-1.7 * r, 1.7 * r + step / 2, step * max(1, r / 1.5))
        u, v = (a.ravel() for a in np.meshgrid(n, n))
        far = np.hypot(u, v)
        base = centre + u[:, None] * x + v[:, None] * y
        along = np.sqrt(phantom.radius ** 2 - v ** 2) - (base - phantom.middle) @ phantom.y  # from base to the wall
        start = base - 3 * r * phantom.y
        heights = []
        for s, a in zip(start, along):
            c = rays.crossings(s, s + (3 * r + a + 3) * phantom.y)
            heights.append(3 * r + a - c[0] if c else np.nan)
        heights = np.array(heights)
        top = np.sqrt(np.maximum(r * r - far ** 2, 0)) + along
        true = np.where(far < r, np.maximum(top, 0), 0)
        on, around = far < 1.3 * r, (far > 1.4 * r) & (far < 1.7 * r)
        found[f"polyp_{across}"] = float(np.nansum((heights - np.nanmean(heights[around]))[on]) / true[on].sum())
    return found
