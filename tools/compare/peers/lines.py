"""Peers that give a centerline from the case's start to its end, as points [n, 3] in mm."""

import heapq
import time

import numpy as np

VMTK_FACES = 20_000  # on a million faces vmtkCenterlines takes minutes


def _penalty(case):
    """Distance by edt, then TEASAR's penalty with kimimaro's constants (10.1109/PCCGA.2000.883951)."""
    from peers.volumes import edt_distance
    distance = edt_distance(case)

    def call(outside):
        d = distance()
        return np.where(d > 0, 1e5 * (1 - d / (1.01 * d.max())) ** 4 + 1e-2, outside).astype(np.float32)
    return call


def _points(case):
    spacing = np.array(case.about()["spacing"])
    return lambda path: np.asarray(path, float)[:, ::-1] * spacing


def dijkstra3d_path(case):
    import dijkstra3d
    cost, start, end = _penalty(case), case.voxel("start")[::-1], case.voxel("end")[::-1]
    return lambda: dijkstra3d.dijkstra(np.asfortranarray(cost(np.inf)), start, end, connectivity=26), _points(case)


def skimage_path(case):
    from skimage.graph import MCP_Geometric
    cost, start, end = _penalty(case), case.voxel("start")[::-1], case.voxel("end")[::-1]
    spacing = case.about()["spacing"][::-1]

    def call():
        paths = MCP_Geometric(cost(-1), sampling=spacing)
        paths.find_costs([start], [end])
        return paths.traceback(end)
    return call, _points(case)


def _vmtk_surface(case):
    """-> a closed surface of at most VMTK_FACES faces with normals outwards, and the seconds it took."""
    from peers.meshes import apply, image, threads
    threads()
    began = time.perf_counter()
    of = "ct" if case.path("ct.nrrd").exists() else "mask"
    wall = apply("FlyingEdges3D", image(*case.volume(of)), ComputeNormalsOff=(),
                 SetValue=(0, 0.5 if of == "mask" else case.about()["hu"]))
    wall = apply("CleanPolyData", wall, ConvertPolysToLinesOff=())
    wall = apply("PolyDataConnectivityFilter", wall, SetExtractionModeToLargestRegion=())
    wall = apply("TriangleFilter", wall, PassLinesOff=(), PassVertsOff=())
    share = max(0.0, 1 - VMTK_FACES / wall.GetNumberOfCells())
    wall = apply("QuadricDecimation", wall, SetTargetReduction=(share,))
    wall = apply("PolyDataNormals", wall, SplittingOff=(), AutoOrientNormalsOn=())
    return wall, time.perf_counter() - began


def _cells(poly):
    """-> points [n, 3] and the point numbers of each line."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
    lines, ids = [], vtk.vtkIdList()
    poly.GetLines().InitTraversal()
    while poly.GetLines().GetNextCell(ids):
        lines.append([ids.GetId(i) for i in range(ids.GetNumberOfIds())])
    return vtk_to_numpy(poly.GetPoints().GetData()).astype(float), lines


def vmtk_centerlines(case):
    """Over the Voronoi diagram of the surface, between the two points."""
    from vmtk import vmtkscripts
    (surface, mesh_s), about = _vmtk_surface(case), case.about()

    def call():
        f = vmtkscripts.vmtkCenterlines()
        f.Surface, f.SeedSelectorName, f.AppendEndPoints, f.LogOn = surface, "pointlist", 0, 0
        f.SourcePoints, f.TargetPoints = list(about["start_mm"]), list(about["end_mm"])
        f.Execute()
        return f.Centerlines
    call.also = {"mesh_s": mesh_s}

    def plain(found):
        points, lines = _cells(found)
        return points[max(lines, key=len)]
    return call, plain


def vmtk_network(case):
    """The whole network from a hole cut at the start; of it, the way from start to end."""
    import vtk
    from vmtk import vmtkscripts

    from peers.meshes import apply
    about = case.about()
    start, end = np.array(about["start_mm"]), np.array(about["end_mm"])
    hole, (surface, mesh_s) = vtk.vtkSphere(), _vmtk_surface(case)
    hole.SetCenter(start - 0.9 * about["start_radius_mm"] * np.array(about["inwards"]))
    hole.SetRadius(0.75 * about["start_radius_mm"])
    opened = apply("PolyDataConnectivityFilter", apply("ClipPolyData", surface, SetClipFunction=(hole,)),
                   SetExtractionModeToLargestRegion=())

    def call():
        f = vmtkscripts.vmtkNetworkExtraction()
        f.Surface, f.AdvancementRatio, f.LogOn = opened, 1.05, 0
        f.Execute()
        return f.Network
    call.also = {"mesh_s": mesh_s}
    return call, lambda found: _shortest(*_cells(found), start, end)


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
