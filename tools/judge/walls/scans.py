"""Rows of real CTs: organs found by intima, their walls judged by the grey profile."""

import numpy as np
import SimpleITK as sitk
from scipy.spatial import cKDTree

import grey
import score
import vtk_walls
from files import normals_of, read_ply, unzipped
from program import Failed
from vtk_data import from_poly, image as vtk_image

SCANS = {  # file, organ, level of the contour
    "chest": ("chest_ct_fnndsc.zip", "airway", -500.0),
    "colon": ("colon_ct_prone_half.nrrd", "colon", -450.0),
    "trunk": ("trunk_ct_contrast.zip", "airway", -500.0),
}
NEAR_MM = 2.0  # of the contour, what lies nearer than this to intima's wall


def series(folder):
    """The DICOM folder below `folder` with the most files."""
    folders = [folder, *(d for d in folder.rglob("*") if d.is_dir())]
    return max(folders, key=lambda d: sum(f.is_file() for f in d.iterdir()))


def read(path):
    if path.is_dir():
        reader = sitk.ImageSeriesReader()
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(path)))
        return reader.Execute()
    return sitk.ReadImage(str(path))


def _row(mesh, volume):
    return {"triangles": len(mesh[1]), **score.tunnels(mesh), **grey.profile(mesh[0], normals_of(mesh), volume)}


def masked(mask):
    """Array, spacing and origin in a frame without turns, and the way back: vertices -> LPS mm."""
    array, spacing = sitk.GetArrayFromImage(mask) > 0, mask.GetSpacing()
    turn, origin = np.array(mask.GetDirection()).reshape(3, 3), np.array(mask.GetOrigin())
    return array, spacing, lambda v: v @ turn.T + origin


def rows(name, data, programs, folder, want_peers=True):
    """intima's wall, VTK's contour near it, and VTK's walls of intima's own mask."""
    file, organ, level = SCANS[name]
    source = data / file
    if not source.exists():
        return
    if source.suffix == ".zip":
        source = series(unzipped(source, folder / name))
    image = read(source)
    volume, about, first = grey.Volume(image), {"part": "scans", "case": f"{name} CT, {organ}"}, None
    for program in programs:
        row = {**about, "program": program.name, "ours": True}
        out = folder / f"{name}-{program.name.replace(' ', '-')}.ply"
        try:
            row["seconds"] = program.surface(out, source, "--organ", organ)
            mesh = read_ply(out)
            first = mesh if first is None else first
            row.update(_row(mesh, volume))
        except Failed as e:
            row["error"] = str(e)
        yield row
    if first is None or not want_peers:
        return
    grid = vtk_image(volume.array, image.GetSpacing(), image.GetOrigin(), image.GetDirection())
    whole = from_poly(vtk_walls.flying_edges(grid, level))
    near = cKDTree(first[0]).query(whole[0], distance_upper_bound=NEAR_MM)[0] < NEAR_MM
    normals = normals_of(whole)
    yield {**about, "program": f"VTK Flying Edges at {level:g}, within 2 mm", "ours": False,
           **grey.profile(whole[0][near], normals[near], volume)}
    out = folder / f"{name}-mask.nrrd"
    try:
        programs[0].run("segment", source, "--organ", organ, "-o", out)
    except Failed:
        return
    array, spacing, back = masked(sitk.ReadImage(str(out)))
    for peer in ("VTK mask + windowed sinc", "VTK SurfaceNets", "VTK mask + constrained smoothing"):
        vertices, faces, _ = vtk_walls.OF_MASKS[peer](array, spacing, (0.0, 0.0, 0.0))
        yield {**about, "program": f"{peer}, of intima's mask", "ours": False,
               **_row((back(vertices), faces, None), volume)}
