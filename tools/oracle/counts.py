"""Counts of a mask: components, cavities, voxel classes, and vertices, faces and Euler characteristic of its iso-surface.

Components are 6-connected. Filling closes the background's 6-components that do not reach the outside. A boundary voxel
is inside and has at least one external 6-neighbour (outside the volume is external); the other inside voxels are
internal.

Surface: the consistent-face table of marching cubes (inside corners separated on ambiguous faces) at one half, on the
padded mask. Then without running any marching cubes
  vertices = 6-adjacent pairs of one inside and one outside voxel
  euler    = 2 (chi6 + X),  chi6 = voxels - 6-pairs + inside 2x2 squares - inside 2x2x2 cubes,
             X = cells of 2x2x2 with exactly two outside corners, diagonally opposite through the body
  faces    = 2 (vertices - euler), because every edge of a closed triangle mesh has two faces
"""

import numpy as np
from scipy.ndimage import binary_fill_holes, label
from skimage.measure import marching_cubes


def _shifts(padded, axes):
    """All corners of the cells spanned by `axes`: one view for each corner."""
    views = [padded]
    for axis in axes:
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        views = [v[s] for v in views for s in (low, high)]
    return np.stack(views)


def classes(mask):
    """-> (boundary voxels, internal voxels)"""
    p = np.pad(mask, 1)
    inner = p.copy()
    for axis in range(3):
        inner &= np.roll(p, 1, axis) & np.roll(p, -1, axis)
    internal = int(inner.sum())
    return int(mask.sum()) - internal, internal


def surface(mask):
    p = np.pad(mask, 1)
    vertices = pairs = squares = 0
    for axis in range(3):
        low, high = _shifts(p, [axis])
        vertices += int((low != high).sum())
        pairs += int((low & high).sum())
        squares += int(_shifts(p, [a for a in range(3) if a != axis]).all(0).sum())
    cells = _shifts(p, [0, 1, 2])  # corner number: 4 z + 2 y + x
    cubes = int(cells.all(0).sum())
    two_out = (~cells).sum(0) == 2
    crossed = sum(int((two_out & ~cells[c] & ~cells[7 - c]).sum()) for c in range(4))
    euler = 2 * (int(p.sum()) - pairs + squares - cubes + crossed)
    return {"vertices": vertices, "euler": euler, "faces": 2 * (vertices - euler)}


def measured(mask, spacing):
    """Area and volume of scikit-image's mesh (method "lorensen"): its table cuts some polygons along other diagonals,
    so ours may differ by a percent or so. Only meaningful where no face is ambiguous."""
    v, f, _, _ = marching_cubes(
        np.pad(mask, 1).astype(np.float32), 0.5, spacing=spacing[::-1], method="lorensen"
    )
    a, b, c = (v[f[:, i]].astype(float) for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    volume = abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
    return {
        "vertices": len(v),
        "faces": len(f),
        "area_mm2": round(float(area), 4),
        "volume_mm3": round(float(volume), 4),
    }


def flying_edges(mask, spacing):
    """The same of VTK's Flying Edges, whose table agrees with ours on unambiguous cells up to diagonals."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    p = np.ascontiguousarray(np.pad(mask, 1).astype(np.uint8))
    image = vtk.vtkImageData()
    image.SetDimensions(p.shape[2], p.shape[1], p.shape[0])
    image.SetSpacing(*(float(s) for s in spacing))
    image.GetPointData().SetScalars(numpy_to_vtk(p.ravel(), deep=True))
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 0.5)
    edges.ComputeNormalsOff()
    edges.ComputeScalarsOff()
    edges.Update()
    mesh = edges.GetOutput()
    mass = vtk.vtkMassProperties()
    mass.SetInputData(mesh)
    mass.Update()
    return {
        "vertices": mesh.GetNumberOfPoints(),
        "faces": mesh.GetNumberOfPolys(),
        "area_mm2": round(mass.GetSurfaceArea(), 4),
    }


def ambiguous(mask):
    """Whether any face of any cell has its two inside corners on a diagonal."""
    p = np.pad(mask, 1)
    for axis in range(3):
        c = _shifts(p, [a for a in range(3) if a != axis])
        if ((c.sum(0) == 2) & (c[0] == c[3])).any():
            return True
    return False


def describe(mask, spacing):
    labels, n = label(mask)
    sizes = np.bincount(labels.ravel(), minlength=n + 1)[1:]
    filled = binary_fill_holes(mask)
    boundary, internal = classes(mask)
    out = {
        "dims": list(mask.shape[::-1]),
        "spacing_mm": list(spacing),
        "inside": int(mask.sum()),
        "component_sizes": sorted((int(s) for s in sizes), reverse=True),
        "boundary": boundary,
        "internal": internal,
        "surface": surface(mask),
        "filled": {"inside": int(filled.sum())},
    }
    out["filled"]["boundary"], out["filled"]["internal"] = classes(filled)
    out["filled"]["surface"] = surface(filled)
    if n:
        # Equal sizes: the one whose first voxel (x fastest) comes first.
        largest = labels == 1 + int(np.argmax(sizes))
        solid = binary_fill_holes(largest)
        boundary, internal = classes(solid)
        z, y, x = (int(i) for i in np.argwhere(largest)[0])
        out["largest_filled"] = {
            "first_voxel": [x, y, z],
            "before_fill": int(largest.sum()),
            "inside": int(solid.sum()),
            "boundary": boundary,
            "internal": internal,
            "surface": surface(solid),
        }
        if not ambiguous(mask):
            out["lorensen"] = measured(mask, spacing)
            out["flying_edges"] = flying_edges(mask, spacing)
            same = (out["lorensen"]["vertices"], out["lorensen"]["faces"])
            assert same == (out["surface"]["vertices"], out["surface"]["faces"]), "counting formula"
    return out
