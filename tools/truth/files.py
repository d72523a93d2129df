"""Files that pass between this and intima: NRRD, PLY, CSV; and VTK's data. Meshes are (vertices, faces, normals or
None)."""

import csv
import zipfile

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

NRRD_TYPES = {"uint8": "u1", "int16": "<i2", "float": "<f4"}


def write_nrrd(path, array, spacing, origin=(0.0, 0.0, 0.0)):
    """Uncompressed, LPS."""
    kind = next(k for k, code in NRRD_TYPES.items() if np.dtype(code) == array.dtype)
    (x, y, z), o = (float(h) for h in spacing), ",".join(repr(float(v)) for v in origin)
    head = ["NRRD0004", f"type: {kind}", "dimension: 3", "space: left-posterior-superior",
            "sizes: {2} {1} {0}".format(*array.shape), f"space directions: ({x},0,0) (0,{y},0) (0,0,{z})",
            "kinds: domain domain domain", "endian: little", "encoding: raw", f"space origin: ({o})"]
    with open(path, "wb") as out:
        out.write(("\n".join(head) + "\n\n").encode())
        out.write(np.ascontiguousarray(array).tobytes())


def from_poly(poly):
    """vtkPolyData -> mesh, in triangles."""
    only = vtk.vtkTriangleFilter()
    only.SetInputData(poly)
    only.PassLinesOff()
    only.PassVertsOff()
    only.Update()
    poly = only.GetOutput()
    normals = poly.GetPointData().GetNormals()
    if not poly.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), None
    return (vtk_to_numpy(poly.GetPoints().GetData()).astype(float),
            vtk_to_numpy(poly.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64),
            None if normals is None else vtk_to_numpy(normals).astype(float))


def to_poly(mesh):
    """mesh -> vtkPolyData."""
    vertices, faces, _ = mesh
    points, cells, poly = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, float), deep=True))
    cells.SetData(numpy_to_vtkIdTypeArray(np.arange(0, 3 * len(faces) + 1, 3), deep=True),
                  numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, np.int64).ravel(), deep=True))
    poly.SetPoints(points)
    poly.SetPolys(cells)
    return poly


def read_ply(path):
    """-> mesh; one that says that it looks out of the lumen is turned."""
    reader = vtk.vtkPLYReader()
    reader.SetFileName(str(path))
    reader.Update()
    vertices, faces, normals = from_poly(reader.GetOutput())
    with open(path, "rb") as file:
        if b"FACING=OUT" in file.read(200):
            faces, normals = faces[:, ::-1], None if normals is None else -normals
    return vertices, faces, normals


def write_ply(path, mesh):
    """Binary, without normals."""
    writer = vtk.vtkPLYWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(to_poly(mesh))
    writer.Write()


def read_vtp(path):
    """-> vtkPolyData."""
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def read_csv(path):
    """-> {heading: column}."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {k: np.array([float(r[k]) for r in rows]) for k in rows[0] if _number(rows[0][k])}


def _number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def unzipped(archive, folder):
    """The folder with the files of a zip archive, unpacked once."""
    if not folder.is_dir():
        part = folder.with_suffix(".part")
        with zipfile.ZipFile(archive) as z:
            z.extractall(part)
        part.rename(folder)
    return folder


def normals_of(mesh):
    """Of the file; where it has none, those of the faces, weighted by area."""
    vertices, faces, given = mesh
    if given is not None:
        return given
    sums, across = np.zeros_like(vertices), np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
    for k in range(3):
        for axis in range(3):
            sums[:, axis] += np.bincount(faces[:, k], across[:, axis], len(vertices))
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)


def welded(mesh):
    """With vertices at the same place made one, and faces without area left out that this makes of some."""
    vertices, faces, _ = mesh
    one, number = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    faces = number.reshape(-1)[faces]
    kept = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return one.astype(float), faces[kept], None
