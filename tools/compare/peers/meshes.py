"""Peers that give a mesh: extraction, normals, simplification. Each returns the call to be timed, and where the
result is not a vtkPolyData, how to make (vertices, faces, normals) of it."""

import os

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

CORES = os.cpu_count() or 1


def threads():
    """All cores for VTK's own loops."""
    vtk.vtkSMPTools.Initialize(CORES)
    vtk.vtkSMPTools.SetBackend("STDThread")


def apply(name, data, **settings):
    """The output of the filter vtkNAME for `data`, after each method in `settings` with its arguments."""
    f = getattr(vtk, f"vtk{name}")()
    f.SetInputData(data)
    for method, given in settings.items():
        getattr(f, method)(*given)
    f.Update()
    return f.GetOutput()


def image(array, spacing):
    """[z, y, x] as vtkImageData, sharing memory."""
    out = vtk.vtkImageData()
    out.SetDimensions(array.shape[::-1])
    out.SetSpacing(spacing)
    out.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(array).ravel(), deep=True))
    return out


def from_poly(poly):
    """vtkPolyData of triangles -> (vertices, faces, normals or None)."""
    normals = poly.GetPointData().GetNormals()
    return (vtk_to_numpy(poly.GetPoints().GetData()).astype(float),
            vtk_to_numpy(poly.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64),
            None if normals is None else vtk_to_numpy(normals).astype(float))


def to_poly(mesh):
    """(vertices, faces, normals or None) -> vtkPolyData."""
    vertices, faces, normals = mesh
    points, cells, poly = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(vertices.astype(np.float32), deep=True))
    cells.SetData(numpy_to_vtkIdTypeArray(np.arange(0, 3 * len(faces) + 1, 3), deep=True),
                  numpy_to_vtkIdTypeArray(faces.astype(np.int64).ravel(), deep=True))
    poly.SetPoints(points)
    poly.SetPolys(cells)
    if normals is not None:
        poly.GetPointData().SetNormals(numpy_to_vtk(normals.astype(np.float32), deep=True))
    return poly


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


def staircase(case):
    """The mesh whose normals are wanted: VTK's, of the mask."""
    return discrete_flying_edges(case, "mask")()


def _point_normals(poly):
    return apply("PolyDataNormals", poly, SplittingOff=(), ConsistencyOff=(), AutoOrientNormalsOff=())


def plain_normals(case):
    poly = staircase(case)
    return lambda: _point_normals(poly)


def laplacian_normals(case):
    """Normals of a smoothed copy, put on the vertices that did not move."""
    poly = staircase(case)

    def call():
        smooth = apply("SmoothPolyDataFilter", poly, SetNumberOfIterations=(20,), SetRelaxationFactor=(0.3,),
                       BoundarySmoothingOff=(), FeatureEdgeSmoothingOff=())
        out = vtk.vtkPolyData()
        out.ShallowCopy(poly)
        out.GetPointData().SetNormals(_point_normals(smooth).GetPointData().GetNormals())
        return out
    return call


def constrained_smoothing(case):
    """Moves vertices, by three quarters of a voxel at most."""
    threads()
    poly, reach = staircase(case), 0.75 * max(case.about()["spacing"])
    return lambda: _point_normals(apply(
        "ConstrainedSmoothingFilter", poly, SetConstraintStrategyToConstraintDistance=(),
        SetConstraintDistance=(reach,), SetNumberOfIterations=(30,), SetRelaxationFactor=(0.3,)))


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
    poly, share = to_poly(mesh), 1 - keep / len(mesh[1])
    others = {f"{kind}AttributeOff": () for kind in ("Scalars", "Vectors", "TCoords", "Tensors")}
    return lambda: apply("QuadricDecimation", poly, SetTargetReduction=(share,), AttributeErrorMetricOn=(),
                         NormalsAttributeOn=(), SetNormalsWeight=(0.5,), **others)


def meshoptimizer(case):
    """Positions only: its Python package cannot pass normals."""
    import meshoptimizer as mo
    (vertices, faces, _), keep = case.mesh(), case.about()["keep"]
    points, index = vertices.astype(np.float32), faces.ravel().astype(np.uint32)

    def call():
        out, error = np.zeros_like(index), np.zeros(1, np.float32)
        n = mo.simplify(out, index, points, target_index_count=3 * keep, target_error=1e9, result_error=error)
        return out[:n].reshape(-1, 3).astype(np.int64)
    return call, lambda found: (vertices, found, None)


def fast_simplification(case):
    import fast_simplification as fs
    (vertices, faces, _), keep = case.mesh(), case.about()["keep"]
    points, index = vertices.astype(np.float32), faces.astype(np.int32)
    return (lambda: fs.simplify(points, index, target_count=keep),
            lambda found: (found[0].astype(float), found[1].astype(np.int64), None))


def pymeshlab_quadric(case):
    """Its filter works in place, so taking the mesh in is on the clock."""
    import pymeshlab
    (vertices, faces, _), keep = case.mesh(), case.about()["keep"]

    def call():
        f = pymeshlab.MeshSet(verbose=False)
        f.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
        f.meshing_decimation_quadric_edge_collapse(targetfacenum=keep, preservenormal=True, preservetopology=True,
                                                   optimalplacement=True, qualitythr=0.3)
        return f
    return call, lambda f: (f.current_mesh().vertex_matrix(), f.current_mesh().face_matrix().astype(np.int64), None)
