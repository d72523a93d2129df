"""Peers that give a centerline from the case's start to its end, as points [n, 3] in mm."""

import heapq
import os

import numpy as np

from files import resample

STEP_MM, SMOOTHING_STEPS = 0.5, 6  # of `smoothed`
END_MM = 40.0  # how far around the start vmtk_network looks for where the lumen goes on


def cropped(mask):
    """-> the voxels of the smallest box around what is not 0 and one voxel more, and its lowest index [z, y, x].
    The background around it is what the distance is measured to."""
    from scipy import ndimage
    box = [slice(max(s.start - 1, 0), s.stop + 1) for s in ndimage.find_objects(mask, 1)[0]]
    return np.ascontiguousarray(mask[tuple(box)]), np.array([s.start for s in box])


def penalty(mask, spacing, outside):
    """Distance by edt, then TEASAR's penalty with kimimaro's constants (10.1109/PCCGA.2000.883951), [z, y, x]."""
    import edt
    d = edt.edt(mask.view(bool), anisotropy=spacing[::-1], black_border=False, parallel=os.cpu_count() or 1)
    d *= -1 / (1.01 * d.max())
    d += 1
    np.square(d, out=d)
    np.square(d, out=d)
    d *= 1e5
    d += 1e-2
    np.putmask(d, mask == 0, outside)
    return d


def smoothed(points):
    """At equal steps and after a Gaussian along the path: voxel paths are steps of whole voxels."""
    from scipy.ndimage import gaussian_filter1d
    return gaussian_filter1d(resample(points, STEP_MM), SMOOTHING_STEPS, axis=0, mode="nearest")


def cheapest(mask, spacing, start, end, bidirectional=False):
    """The smoothed path of least penalty from voxel `start` to `end` (x, y, z), searched in the box around the mask.
    The penalty is passed as [x, y, z] in the order it lies in memory, so nothing is copied."""
    import dijkstra3d
    mask, low = cropped(mask)
    cost, low = penalty(mask, spacing, np.inf).T, low[::-1]
    ends = [tuple(int(i) for i in p - low) for p in (np.array(start), np.array(end))]
    path = dijkstra3d.dijkstra(cost, *ends, bidirectional=bidirectional, connectivity=26)
    return smoothed((np.asarray(path, float) + low) * spacing)


def dijkstra3d_path(case, bidirectional):
    (mask, spacing), start, end = case.volume("mask"), case.voxel("start"), case.voxel("end")
    return lambda: cheapest(mask, spacing, start, end, bidirectional)


def skimage_path(case):
    from skimage.graph import MCP_Geometric
    (mask, spacing), start, end = case.volume("mask"), case.voxel("start"), case.voxel("end")

    def call():
        box, low = cropped(mask)
        paths = MCP_Geometric(penalty(box, spacing, -1), sampling=spacing[::-1])
        first, last = (tuple(int(i) for i in np.array(p[::-1]) - low) for p in (start, end))
        paths.find_costs([first], [last])
        return smoothed((np.asarray(paths.traceback(last), float) + low)[:, ::-1] * spacing)
    return call


def _cells(poly):
    """-> points [n, 3] and the point numbers of each line."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
    lines, ids = [], vtk.vtkIdList()
    poly.GetLines().InitTraversal()
    while poly.GetLines().GetNextCell(ids):
        lines.append([ids.GetId(i) for i in range(ids.GetNumberOfIds())])
    return vtk_to_numpy(poly.GetPoints().GetData()).astype(float), lines


def between(surface, start, end):
    """VMTK's centerline over the Voronoi diagram of `surface`, a vtkPolyData, from `start` to `end` in mm."""
    from vmtk import vmtkscripts
    f = vmtkscripts.vmtkCenterlines()
    f.Surface, f.SeedSelectorName, f.AppendEndPoints, f.LogOn = surface, "pointlist", 0, 0
    f.SourcePoints, f.TargetPoints = list(start), list(end)
    f.Execute()
    return f.Centerlines


def longest(lines):
    """Points of the longest line of a vtkPolyData."""
    points, lines = _cells(lines)
    return points[max(lines, key=len)]


def vmtk_centerlines(case):
    """Over the Voronoi diagram of the surface, between the two points."""
    surface, about = _small_wall(case), case.about()
    return lambda: between(surface, about["start_mm"], about["end_mm"]), longest


def _small_wall(case):
    """The mesh of meshes.small_wall as vtkPolyData."""
    from job import load
    from peers.meshes import threads
    from vtk_data import to_poly
    threads()
    return to_poly(load(case.small_wall()), np.float32)


def vmtk_network(case):
    """The whole network from a hole cut at the start; of it, the way from start to end."""
    import vtk
    from vmtk import vmtkscripts

    from vtk_data import apply
    start, end = (np.array(case.about()[f"{k}_mm"]) for k in ("start", "end"))
    surface, (radius, inwards) = _small_wall(case), _end_of_lumen(case)
    hole = vtk.vtkSphere()
    hole.SetCenter(start - 0.9 * radius * inwards)
    hole.SetRadius(0.75 * radius)
    opened = apply("PolyDataConnectivityFilter", apply("ClipPolyData", surface, SetClipFunction=(hole,)),
                   SetExtractionModeToLargestRegion=())
    opened = apply("CleanPolyData", opened)  # drops the points that only the part cut off used

    def call():
        f = vmtkscripts.vmtkNetworkExtraction()
        f.Surface, f.AdvancementRatio, f.LogOn = opened, 1.05, 0
        f.Execute()
        return f.Network
    return call, lambda found: _shortest(*_cells(found), start, end)


def _end_of_lumen(case):
    """-> the distance from the start to the wall, mm, and the direction in which the lumen goes on from there:
    to the centroid of its voxels within three times that distance, as far as END_MM goes."""
    from scipy import ndimage
    (mask, spacing), start = case.volume("mask"), np.array(case.voxel("start"))
    low = np.maximum(start - (END_MM / np.array(spacing)).astype(int), 0)
    near = tuple(slice(i, 2 * j - i + 1) for i, j in zip(low[::-1], start[::-1]))
    box, at = mask[near], start - low
    reach = 3 * ndimage.distance_transform_edt(box, sampling=spacing[::-1])[tuple(at[::-1])]
    away = (np.argwhere(box)[:, ::-1] - at) * spacing
    inwards = away[(away ** 2).sum(1) <= reach ** 2].mean(0)
    return reach / 3, inwards / np.linalg.norm(inwards)


def _shortest(points, lines, start, end):
    """Dijkstra over the network's points, equal points joined."""
    places, number = np.unique(points.round(4), axis=0, return_inverse=True)
    number, next_to = number.ravel(), {}
    for line in lines:
        for a, b in zip(number[line[:-1]], number[line[1:]]):
            length = float(np.linalg.norm(places[a] - places[b]))
            next_to.setdefault(a, []).append((b, length))
            next_to.setdefault(b, []).append((a, length))
    first, last = (min(next_to, key=lambda i: np.linalg.norm(places[i] - p)) for p in (start, end))
    best, queue = {first: (0.0, None)}, [(0.0, first)]
    while queue:
        so_far, at = heapq.heappop(queue)
        for other, length in next_to[at] if so_far == best[at][0] else ():
            if so_far + length < best.get(other, (np.inf,))[0]:
                best[other] = (so_far + length, at)
                heapq.heappush(queue, (so_far + length, other))
    if last not in best:
        raise RuntimeError("the network falls apart between start and end")
    path = [last]
    while best[path[-1]][1] is not None:
        path.append(best[path[-1]][1])
    return places[path[::-1]]
