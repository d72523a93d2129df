"""One small surface in the ways VTK's XML writer has of storing it.

`vtp/NAME.vtp`: a cone of 12 corners with normals and `SPACE` = `RAS` in its field data; `strips` has it
as triangle strips. `vtp/cone.json` holds its points, its normals and its triangles as VTK has them
before the file is written.
"""

import vtk
from vtk.util.numpy_support import vtk_to_numpy

CORNERS = 12


def cone():
    source = vtk.vtkConeSource()
    source.SetResolution(CORNERS)
    source.SetCenter(10.5, -3.25, 7)
    source.SetDirection(0.5, 0.25, 1)
    source.CappingOff()
    normals = vtk.vtkPolyDataNormals()
    normals.SetInputConnection(source.GetOutputPort())
    normals.SplittingOff()
    normals.Update()
    out = normals.GetOutput()
    space = vtk.vtkStringArray()
    space.SetName("SPACE")
    space.InsertNextValue("RAS")
    out.GetFieldData().AddArray(space)
    # Its range as an InformationKey among the numbers.
    out.GetPointData().GetNormals().GetRange(-1)
    out.GetPoints().GetData().GetRange(-1)
    return out


def stripped(data):
    stripper = vtk.vtkStripper()
    stripper.SetInputData(data)
    stripper.Update()
    return stripper.GetOutput()


def written(data, set_up=lambda writer: None):
    writer = vtk.vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.SetWriteToOutputString(True)
    set_up(writer)
    writer.Write()
    return writer.GetOutputString()


def small_blocks(writer):
    writer.SetDataModeToBinary()
    writer.SetBlockSize(64)


def plain(writer):
    writer.SetCompressorTypeToNone()


def fixture():
    data = cone()
    files = {
        "as_vtk_writes": written(data),
        "inline": written(data, lambda w: w.SetDataModeToBinary()),
        "inline_blocks": written(data, small_blocks),
        "appended_plain": written(data, plain),
        "text": written(data, lambda w: w.SetDataModeToAscii()),
        "strips": written(stripped(data)),
    }
    faces = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    truth = {
        "points": vtk_to_numpy(data.GetPoints().GetData()).astype(float).tolist(),
        "normals": vtk_to_numpy(data.GetPointData().GetNormals()).astype(float).tolist(),
        "faces": faces.tolist(),
    }
    return {f"{n}.vtp": text.encode("latin-1") for n, text in files.items()}, truth


def content(data):
    """What a file holds: points, normals and corners of cells."""
    reader = vtk.vtkXMLPolyDataReader()
    reader.ReadFromInputStringOn()
    reader.SetInputString(data.decode("latin-1"))
    reader.Update()
    out = reader.GetOutput()
    arrays = [out.GetPoints().GetData(), out.GetPointData().GetNormals(),
              out.GetPolys().GetConnectivityArray(), out.GetStrips().GetConnectivityArray()]
    return [vtk_to_numpy(a).tolist() for a in arrays]
