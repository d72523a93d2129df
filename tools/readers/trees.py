"""Trees that intima writes, opened by readers that are not ours."""

import csv

import morphio
import navis
import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy


def table(file):
    """Rows of a centerline CSV: places [n, 3], radii, branch numbers."""
    with open(file, newline="") as text:
        rows = list(csv.DictReader(text))
    of = lambda *names: np.array([[float(r[n]) for n in names] for r in rows])
    return of("x", "y", "z"), of("radius")[:, 0], of("branch")[:, 0].astype(int)


def length_of(places, branches):
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return steps[branches[1:] == branches[:-1]].sum()


def swc(file, csv_file):
    """Holds an SWC against the table of the same tree; says what it found."""
    places, radii, branches = table(csv_file)
    tree = navis.read_swc(str(file))
    nodes = tree.nodes
    assert tree.n_trees == 1, f"{tree.n_trees} trees"
    # A branch's first point is its parent's: once in the SWC, twice in the table.
    distinct = len(np.unique(np.c_[places, radii], axis=0))
    assert distinct <= len(nodes) <= len(places), (distinct, len(nodes), len(places))
    here = {tuple(p) for p in np.float32(places)}
    there = {tuple(p) for p in np.float32(nodes[["x", "y", "z"]])}
    assert here == there, "other places"
    assert np.isclose(sorted(set(nodes.radius))[-1], radii.max(), rtol=1e-6), "other radii"
    wanted = length_of(places, branches)
    # The table has no row for the gap between a branch and the point that it starts at.
    assert -1e-5 < tree.cable_length / wanted - 1 < 1e-3, (tree.cable_length, wanted)
    morphology = morphio.Morphology(str(file))
    assert len(morphology.root_sections) >= 1
    return (
        f"{len(nodes)} nodes, {tree.n_leafs} leaves, {tree.n_branches} forks, "
        f"{tree.cable_length:.1f} mm; morphio: {len(morphology.sections)} sections"
    )


def branches(file):
    """Holds a branches.vtp against VMTK's conventions; says what it found."""
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(file))
    reader.Update()
    data = reader.GetOutput()
    arrays = {}
    for name in ("CenterlineIds", "GroupIds", "TractIds", "Blanking"):
        array = data.GetCellData().GetArray(name)
        assert array is not None and array.GetDataType() == vtk.VTK_INT, f"{name} is not Int32"
        arrays[name] = vtk_to_numpy(array)
    ids, tracts = arrays["CenterlineIds"], arrays["TractIds"]
    for i in np.unique(ids):
        assert np.array_equal(tracts[ids == i], np.arange((ids == i).sum())), f"tracts of path {i}"
    groups = arrays["GroupIds"]
    for g in np.unique(groups):
        assert len(set(arrays["Blanking"][groups == g])) == 1, f"group {g} is blanked in part"
    for name in ("MaximumInscribedSphereRadius", "Radius", "Abscissa"):
        assert data.GetPointData().GetArray(name) is not None, name
    return f"{ids.max() + 1} paths, {len(ids)} tracts, {groups.max() + 1} groups"
