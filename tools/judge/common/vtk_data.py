"""VTK's data from and to arrays. Meshes are (vertices, faces, normals or None)."""

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

def apply(name, data, **settings):
    """The output of the filter vtkNAME for `data`, after each method in `settings` with its arguments."""
    f = getattr(vtk, f"vtk{name}")()
    f.SetInputData(data)
    for method, given in settings.items():
        getattr(f, method)(*given)
    f.Update()
    return f.GetOutput()


def image(array, spacing, origin=(0.0, 0.0, 0.0), direction=None):
    """[z, y, x] as vtkImageData; `origin` is the place of its first voxel, mm."""
    out = vtk.vtkImageData()
    out.SetDimensions(array.shape[::-1])
    out.SetSpacing(spacing)
    out.SetOrigin(origin)
    if direction is not None:
        out.SetDirectionMatrix(*direction)
    out.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(array).ravel(), deep=True))
    return out


def triangles(poly):
    """Polygons and strips as triangles, without lines and points."""
    return apply("TriangleFilter", poly, PassLinesOff=(), PassVertsOff=())


def from_poly(poly):
    """vtkPolyData of triangles -> mesh."""
    normals = poly.GetPointData().GetNormals()
    if not poly.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), None
    return (vtk_to_numpy(poly.GetPoints().GetData()).astype(float),
            vtk_to_numpy(poly.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64),
            None if normals is None else vtk_to_numpy(normals).astype(float))


def to_poly(mesh, kind=np.float64):
    """mesh -> vtkPolyData with points of this type, and normals where there are some."""
    vertices, faces, normals = mesh
    points, cells, poly = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetDataType(vtk.VTK_DOUBLE if kind is np.float64 else vtk.VTK_FLOAT)
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, kind), deep=True))
    cells.SetData(numpy_to_vtkIdTypeArray(np.arange(0, 3 * len(faces) + 1, 3), deep=True),
                  numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, np.int64).ravel(), deep=True))
    poly.SetPoints(points)
    poly.SetPolys(cells)
    if normals is not None:
        poly.GetPointData().SetNormals(numpy_to_vtk(normals.astype(np.float32), deep=True))
    return poly


def read_vtp(path):
    """-> vtkPolyData."""
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()
