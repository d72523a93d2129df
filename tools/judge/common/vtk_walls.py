"""Walls that one would make with VTK instead."""

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from files import welded
from volumes import component
from vtk_data import apply, from_poly, image, to_poly

SINC_STEPS, SINC_BAND = 30, 0.1


def _padded(array, value, spacing, origin):
    """One voxel more on every side, so that walls are closed."""
    return image(np.pad(array, 1, constant_values=value), spacing, tuple(o - h for o, h in zip(origin, spacing)))


def flying_edges(volume, level):
    """VTK's contour of vtkImageData."""
    return apply("FlyingEdges3D", volume, SetValue=(0, level), ComputeNormalsOff=(), ComputeGradientsOff=(),
                  ComputeScalarsOff=())


def contour(array, spacing, origin, level, outside):
    """Flying Edges at `level`; beyond the volume lies `outside`."""
    volume = _padded(array, outside, spacing, origin)
    return welded(from_poly(flying_edges(volume, level)))


def lumen(array, level, voxel):
    """The 6-connected component of voxels under `level`. Its cavities stay: where it leaks, walls are cavities."""
    return component(array <= level, voxel)


def contour_of_lumen(array, spacing, origin, level, voxel):
    """Flying Edges at `level`, only of the component of `voxel`: what else lies under the level is filled."""
    inside = lumen(array, level, voxel)
    grey = np.where(inside, np.minimum(array, level - 0.01), np.maximum(array, level + 0.01)).astype(np.float32)
    return contour(grey, spacing, origin, level, level + 500)


def stairs(mask, spacing, origin):
    """The mask's own wall, half way between voxels."""
    volume = _padded(mask.astype(np.uint8), 0, spacing, origin)
    return apply("DiscreteFlyingEdges3D", volume, SetValue=(0, 1), ComputeNormalsOff=(), ComputeGradientsOff=(),
                  ComputeScalarsOff=())


def sinc(mask, spacing, origin):
    """Windowed sinc on it (Taubin, Zhang and Golub, "Optimal surface smoothing as filter design", 1996)."""
    return from_poly(apply("WindowedSincPolyDataFilter", stairs(mask, spacing, origin),
                            SetNumberOfIterations=(SINC_STEPS,), SetPassBand=(SINC_BAND,), NormalizeCoordinatesOn=(),
                            BoundarySmoothingOff=(), FeatureEdgeSmoothingOff=(), NonManifoldSmoothingOn=()))


def nets(mask, spacing, origin):
    """Surface nets with their default smoothing within the cells (Gibson 1998, doi:10.1007/BFb0056277)."""
    volume = _padded(mask.astype(np.uint8), 0, spacing, origin)
    return from_poly(apply("SurfaceNets3D", volume, SetValue=(0, 1), SetOutputMeshTypeToTriangles=()))


def constrained(mask, spacing, origin):
    """Constrained smoothing of it: no vertex moves by more than three quarters of a voxel."""
    return from_poly(apply("ConstrainedSmoothingFilter", stairs(mask, spacing, origin),
                            SetConstraintStrategyToConstraintDistance=(), SetConstraintDistance=(0.75 * max(spacing),),
                            SetNumberOfIterations=(30,), SetRelaxationFactor=(0.3,)))


OF_MASKS = {"VTK mask, halfway": lambda *a: from_poly(stairs(*a)), "VTK mask + windowed sinc": sinc,
            "VTK SurfaceNets": nets, "VTK mask + constrained smoothing": constrained}


def filled(mesh, shape, spacing, origin):
    """Which voxel centres of a volume the closed mesh encloses, [z, y, x]."""
    if not len(mesh[1]):
        return np.zeros(shape, bool)
    to_stencil = vtk.vtkPolyDataToImageStencil()
    to_stencil.SetInputData(to_poly(mesh))
    to_stencil.SetOutputOrigin(origin)
    to_stencil.SetOutputSpacing(spacing)
    to_stencil.SetOutputWholeExtent(0, shape[2] - 1, 0, shape[1] - 1, 0, shape[0] - 1)
    to_stencil.SetTolerance(0)
    to_image = vtk.vtkImageStencilToImage()
    to_image.SetInputConnection(to_stencil.GetOutputPort())
    to_image.SetOutputScalarTypeToUnsignedChar()
    to_image.SetInsideValue(1)
    to_image.SetOutsideValue(0)
    to_image.Update()
    return vtk_to_numpy(to_image.GetOutput().GetPointData().GetScalars()).reshape(shape) > 0
