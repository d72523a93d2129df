"""Peers that give a mesh: extraction, normals, simplification. Each returns the call to be timed, and where the
result is not a vtkPolyData, how to make (vertices, faces, normals) of it."""

import os

import numpy as np
import vtk
from vtk_data import apply, from_poly, image, to_poly

CORES = os.cpu_count() or 1


def threads():
    """All cores for VTK's own loops."""
    vtk.vtkSMPTools.Initialize(CORES)
    vtk.vtkSMPTools.SetBackend("STDThread")


def _source(case, of):
    """What is contoured: the mask as it is, or the CT; and the level of the wall."""
    array, spacing = case.volume(of)
    return array, spacing, 0.5 if of == "mask" else case.about()["hu"]


PLAIN = {"ComputeScalarsOff": (), "ComputeGradientsOff": (), "ComputeNormalsOff": ()}


def flying_edges(case, of):
    threads()
    array, spacing, level = _source(case, of)
    volume = image(array, spacing)
    return lambda: apply("FlyingEdges3D", volume, SetValue=(0, level), **PLAIN)


def discrete_flying_edges(case, of):
    """Of a label map: the mask, or the CT's thresholded (outside the clock)."""
    threads()
    array, spacing, level = _source(case, of)
    volume = image(array if of == "mask" else (array <= level).astype(np.uint8), spacing)
    return lambda: apply("DiscreteFlyingEdges3D", volume, SetValue=(0, 1), **PLAIN)


def skimage_cubes(case, of):
    from skimage.measure import marching_cubes
    array, spacing, level = _source(case, of)
    grey = array.astype(np.float32)
    return (lambda: marching_cubes(grey, level, spacing=spacing[::-1]),
            lambda found: (found[0][:, ::-1].astype(float), found[1].astype(np.int64), None))


def surface_nets(case, of):
    """Vertices within the cells, smoothed within them: its defaults."""
    threads()
    array, spacing, level = _source(case, of)
    volume = image(array if of == "mask" else (array <= level).astype(np.uint8), spacing)
    return lambda: _nets(volume)


def _nets(volume):
    return apply("SurfaceNets3D", volume, SetValue=(0, 1), SetOutputMeshTypeToTriangles=())


def constrained_wall(case, of):
    """Flying Edges, then constrained smoothing as in `constrained_smoothing`."""
    extract, reach = discrete_flying_edges(case, of), _reach(case)
    return lambda: _constrained(extract(), reach)


def small_wall(case, keep, closed):
    """What VMTK wants: a surface with normals outwards, of `keep` faces. Of the CT where there is one; the largest
    component, which is looked for when there are few faces left. Where it has to be `closed` and decimation joins
    sheets that nearly touch, so that edges have more than two faces, all faces are kept."""
    threads()
    of = "ct" if case.about()["hu"] is not None else "mask"
    array, spacing, level = _source(case, of)
    volume = image(array, spacing)

    def wall(small):
        found = apply("FlyingEdges3D", volume, SetValue=(0, level), **PLAIN)
        if small:
            found = to_poly(decimated(*from_poly(found)[:2], keep), np.float32)
        found = apply("CleanPolyData", found, SetTolerance=(0,), ConvertPolysToLinesOff=())
        found = apply("PolyDataConnectivityFilter", found, SetExtractionModeToLargestRegion=())
        found = apply("CleanPolyData", found, SetTolerance=(0,))  # drops the points of the other components
        return apply("PolyDataNormals", found, SplittingOff=(), AutoOrientNormalsOn=())
    small = not closed or _closed(wall(True))
    return lambda: wall(small)


def _closed(poly):
    """Whether every edge has two faces."""
    edges = apply("FeatureEdges", poly, BoundaryEdgesOn=(), NonManifoldEdgesOn=(), FeatureEdgesOff=(),
                  ManifoldEdgesOff=())
    return edges.GetNumberOfCells() == 0


def staircase(case):
    """The mesh whose normals are wanted: VTK's, of the mask."""
    return discrete_flying_edges(case, "mask")()


def _point_normals(poly):
    return apply("PolyDataNormals", poly, SplittingOff=(), ConsistencyOff=(), AutoOrientNormalsOff=())


def plain_normals(case):
    poly = staircase(case)
    return lambda: _point_normals(poly)


def _normals_of(poly, smooth):
    """`poly` with the normals of a smoothed copy; its vertices do not move."""
    out = vtk.vtkPolyData()
    out.ShallowCopy(poly)
    out.GetPointData().SetNormals(_point_normals(smooth).GetPointData().GetNormals())
    return out


def laplacian_normals(case):
    """Normals of a smoothed copy, put on the vertices that did not move."""
    poly = staircase(case)
    return lambda: _normals_of(poly, apply(
        "SmoothPolyDataFilter", poly, SetNumberOfIterations=(20,), SetRelaxationFactor=(0.3,),
        BoundarySmoothingOff=(), FeatureEdgeSmoothingOff=()))


def windowed_sinc(poly):
    """A low-pass filter of positions (Taubin, Zhang and Golub, "Optimal surface smoothing as filter design", 1996)."""
    return apply("WindowedSincPolyDataFilter", poly, SetNumberOfIterations=(20,), SetPassBand=(0.01,),
                 NormalizeCoordinatesOn=(), BoundarySmoothingOff=(), FeatureEdgeSmoothingOff=(),
                 NonManifoldSmoothingOn=())


def sinc_normals(case):
    """Normals of a copy smoothed by windowed sinc, put on the vertices that did not move."""
    threads()
    poly = staircase(case)
    return lambda: _normals_of(poly, windowed_sinc(poly))


def sinc_smoothing(case):
    """Moves vertices, without a bound."""
    threads()
    poly = staircase(case)
    return lambda: _point_normals(windowed_sinc(poly))


def _reach(case):
    return 0.75 * max(case.about()["spacing"])


def _constrained(poly, reach):
    return apply("ConstrainedSmoothingFilter", poly, SetConstraintStrategyToConstraintDistance=(),
                 SetConstraintDistance=(reach,), SetNumberOfIterations=(30,), SetRelaxationFactor=(0.3,))


def constrained_smoothing(case):
    """Moves vertices, by three quarters of a voxel at most."""
    threads()
    poly, reach = staircase(case), _reach(case)
    return lambda: _point_normals(_constrained(poly, reach))


def nets_normals(case):
    """A mesh of its own from the mask, on the clock, smoothed within the cells; normals of its faces."""
    threads()
    volume = image(*case.volume("mask"))
    return lambda: _point_normals(_nets(volume))


def gradient_normals(case):
    """Gradient of the mask after a Gaussian of two voxels, at the vertices."""
    from scipy import ndimage
    mask, spacing = case.volume("mask")
    vertices, faces, _ = from_poly(staircase(case))
    at = (vertices / spacing).T[::-1]

    def call():
        soft = ndimage.gaussian_filter(mask.astype(np.float32), 2.0)
        slope = [-ndimage.map_coordinates(np.gradient(soft, axis=2 - k), at, order=1) / spacing[k] for k in range(3)]
        normals = np.stack(slope, 1)
        return vertices, faces, normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12)
    return call, lambda found: found


def vtk_quadric(case):
    """Normals are part of the error, and come out."""
    threads()
    mesh, keep = case.mesh(), case.about()["keep"]
    poly, share = to_poly(mesh, np.float32), 1 - keep / len(mesh[1])
    others = {f"{kind}AttributeOff": () for kind in ("Scalars", "Vectors", "TCoords", "Tensors")}
    return lambda: apply("QuadricDecimation", poly, SetTargetReduction=(share,), AttributeErrorMetricOn=(),
                         NormalsAttributeOn=(), SetNormalsWeight=(0.5,), **others)


def _simplified(points, index, keep, normals=None):
    """meshoptimizer's index of `keep` faces, at whatever error; with normals as attributes where they are given."""
    import ctypes

    import meshoptimizer as mo
    from meshoptimizer._loader import lib
    out, error = np.zeros_like(index), np.zeros(1, np.float32)
    to = {"target_index_count": 3 * keep, "target_error": 1e9, "result_error": error}
    if normals is None:
        n = mo.simplify(out, index, points, **to)
    else:
        # The package declares no argument types for this function, without which ctypes refuses the float among them.
        floats, count, number = ctypes.POINTER(ctypes.c_float), ctypes.c_size_t, ctypes.POINTER(ctypes.c_uint)
        lib.meshopt_simplifyWithAttributes.argtypes = [
            number, number, count, floats, count, count, floats, count, floats, count,
            ctypes.POINTER(ctypes.c_ubyte), count, ctypes.c_float, ctypes.c_uint, floats]
        lib.meshopt_simplifyWithAttributes.restype = count
        n = mo.simplify_with_attributes(out, index, points, normals, np.full(3, 0.5, np.float32), **to)
    return out[:n].reshape(-1, 3).astype(np.int64)


def decimated(vertices, faces, keep):
    """By meshoptimizer, positions alone; -> (vertices that are left, faces, None)."""
    found = _simplified(vertices.astype(np.float32), faces.ravel().astype(np.uint32), keep)
    used, number = np.unique(found, return_inverse=True)
    return vertices[used], number.reshape(-1, 3), None


def meshoptimizer(case, with_normals=False):
    """Keeps some of the vertices, and so their normals."""
    (vertices, faces, normals), keep = case.mesh(), case.about()["keep"]
    points, index = vertices.astype(np.float32), faces.ravel().astype(np.uint32)
    more = [normals.astype(np.float32)] if with_normals else []
    return lambda: _simplified(points, index, keep, *more), lambda found: (vertices, found, normals)


def fast_simplification(case):
    import fast_simplification as fs
    (vertices, faces, _), keep = case.mesh(), case.about()["keep"]
    points, index = vertices.astype(np.float32), faces.astype(np.int32)
    return (lambda: fs.simplify(points, index, target_count=keep),
            lambda found: (found[0].astype(float), found[1].astype(np.int64), None))


def pymeshlab_quadric(case):
    """Its filter works in place, so every call gets a mesh of its own, made off the clock."""
    import pymeshlab
    (vertices, faces, _), keep = case.mesh(), case.about()["keep"]

    def fresh():
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
        return meshes

    def call(meshes):
        meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=keep, preservenormal=True, preservetopology=True,
                                                        optimalplacement=True, qualitythr=0.3)
        return meshes
    call.fresh = fresh
    return call, lambda meshes: (meshes.current_mesh().vertex_matrix(),
                                 meshes.current_mesh().face_matrix().astype(np.int64), None)
