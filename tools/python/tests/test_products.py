"""Lumen, wall, centerline and frames beside SimpleITK, SciPy and VTK."""

import numpy as np
import pytest
import SimpleITK
from scipy.spatial import cKDTree

import intima


def polydata(mesh):
    """A mesh for VTK."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(mesh.vertices, deep=True))
    rows = np.insert(mesh.faces.astype(np.int64), 0, 3, axis=1)
    cells = vtk.vtkCellArray()
    cells.ImportLegacyFormat(numpy_to_vtkIdTypeArray(rows.ravel(), deep=True))
    data = vtk.vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    return data


def open_edges(data):
    """Edges that have not exactly two faces."""
    import vtk

    edges = vtk.vtkFeatureEdges()
    edges.SetInputData(data)
    edges.FeatureEdgesOff()
    edges.ManifoldEdgesOff()
    edges.BoundaryEdgesOn()
    edges.NonManifoldEdgesOn()
    edges.Update()
    return edges.GetOutput().GetNumberOfCells()


def mass(data):
    """Volume and area by VTK."""
    import vtk

    properties = vtk.vtkMassProperties()
    properties.SetInputData(data)
    properties.Update()
    return properties.GetVolume(), properties.GetSurfaceArea()


def test_a_threshold_with_a_seed_selects_what_simpleitk_grows(ct):
    values, spacing = ct
    seed = tuple(int(i) for i in np.argwhere(values == values.min())[0])
    found = intima.segment(values, spacing, threshold=(None, -600), seed=seed, wall="exact", fill=False)
    grown = SimpleITK.ConnectedThreshold(
        SimpleITK.GetImageFromArray(values), [seed[::-1]], lower=-3000, upper=-600
    )
    np.testing.assert_array_equal(found.mask, SimpleITK.GetArrayFromImage(grown) == 1)
    assert found.volume_ml == pytest.approx(found.mask.sum() * np.prod(spacing) / 1000)
    assert set(np.unique(found.classes)) == {0, 1, 2} and found.organ is None


def test_the_wall_follows_grey_values_within_a_fifth_of_a_voxel(ct, bend):
    values, spacing = ct
    mesh = intima.wall(values, spacing, threshold=(None, -600))
    off, _ = cKDTree(bend[2]).query(mesh.vertices)
    assert np.median(np.abs(off - 4.0)) < 0.2 * min(spacing)
    assert mesh.evidence is not None and (mesh.evidence == 0).mean() > 0.9


def test_the_surface_is_closed_and_looks_outwards_as_vtk_measures_it(bend):
    mask, spacing, _ = bend
    mesh = intima.surface(mask, spacing)
    data = polydata(mesh)
    volume, area = mass(data)
    assert open_edges(data) == 0
    assert volume == pytest.approx(mesh.enclosed, rel=1e-4) and mesh.enclosed > 0
    assert area == pytest.approx(mesh.area, rel=1e-4)
    assert volume == pytest.approx(mask.sum() * np.prod(spacing), rel=0.04)
    # Each normal against the faces about its vertex.
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    face = np.cross(b - a, c - a)
    assert (np.einsum("ij,ij->i", face, mesh.normals[mesh.faces[:, 0]]) > 0).mean() > 0.99
    inwards = intima.surface(mask, spacing, facing="in")
    assert inwards.enclosed == pytest.approx(-mesh.enclosed)


def test_vertices_stay_within_half_a_voxel_of_vtk_surface(bend):
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    mask, spacing, _ = bend
    mesh = intima.surface(mask, spacing)
    image = vtk.vtkImageData()
    image.SetDimensions(mask.shape[::-1])
    image.SetSpacing(spacing[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(mask.astype(np.uint8).ravel(), deep=True))
    cubes = vtk.vtkFlyingEdges3D()
    cubes.SetInputData(image)
    cubes.SetValue(0, 0.5)
    cubes.Update()
    theirs = vtk_to_numpy(cubes.GetOutput().GetPoints().GetData())
    off, _ = cKDTree(theirs).query(mesh.vertices)
    assert off.max() <= 0.5 * max(spacing) + 1e-3


def test_a_simplified_mesh_keeps_its_volume_and_stays_closed(bend):
    mask, spacing, _ = bend
    mesh = intima.surface(mask, spacing)
    few = intima.simplify(mesh, 800)
    assert 798 <= len(few.faces) <= 800 and open_edges(polydata(few)) == 0
    assert few.enclosed == pytest.approx(mesh.enclosed, rel=0.02)
    plain = intima.simplify((mesh.vertices, mesh.faces), 800, metric="qem", keep_vertices=True)
    assert set(map(bytes, plain.vertices)) <= set(map(bytes, mesh.vertices))
    with pytest.raises(intima.ArgumentError, match="faces"):
        intima.simplify((mesh.vertices[:10], mesh.faces), 800)


def test_the_centerline_lies_on_the_axis_with_the_distance_as_radius(bend):
    mask, spacing, axis = bend
    line = intima.centerline(mask, spacing)
    off, _ = cKDTree(axis).query(line.points)
    assert len(line.branches) == 1 and np.median(off) < 0.5 and off.max() < max(spacing) * 2
    true_length = np.linalg.norm(np.diff(axis, axis=0), axis=1).sum()
    assert line.length == pytest.approx(true_length, rel=0.08)
    volume = intima.Volume(mask, spacing)
    at = np.round(volume.to_index(line.points)).astype(int)
    assert mask[tuple(at.T)].all()
    # The wall lies between the last voxel centre inside and the first outside, 4 mm away or more.
    deepest = intima.distance(volume)[tuple(at.T)]
    assert (line.radius <= deepest + max(spacing) / 2).all() and (line.radius < 4.0).all()
    assert np.median(line.radius) > 4.0 - max(spacing)
    assert (np.diff(line.abscissa) > 0).all()


def test_a_tree_has_branches_that_meet():
    mask = np.zeros((60, 40, 60), bool)
    mask[4:56, 17:23, 27:33] = True
    mask[30:36, 17:23, 4:56] = True
    tree = intima.centerline(mask, tree=True)
    assert len(tree.branches) >= 3
    for branch in tree.branches[1:]:
        parent, point = branch.start
        np.testing.assert_allclose(branch.points[0], tree.branches[parent].points[point], atol=1e-6)
    way = tree.path_to(len(tree.branches) - 1)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 3.0
    np.testing.assert_allclose(way[0], tree.points[0])
    graph = intima.Session(mask=mask, tree=True).graph()
    assert sum(n["kind"] == "end" for n in graph["nodes"]) == 4


def test_a_session_computes_a_product_once_and_again_only_where_settings_change_it(bend):
    mask, spacing, _ = bend
    session = intima.Session(mask=mask, spacing=spacing, device="cpu")
    session.centerline()

    def runs(stage):
        return sum(s["name"] == stage for s in session.report()["stages"])

    session.centerline()
    assert runs("route") == 1
    assert session.report()["version"] == intima.__version__
    session.apply(tree=True)
    assert session.settings["tree"] and len(session.centerline().branches) >= 1
    assert (runs("segment"), runs("route")) == (1, 2)
    with pytest.raises(intima.ArgumentError):
        session.apply(nothing=1)
    assert "nothing" not in session.settings


def test_frames_of_a_flight_are_pictures_of_the_wall(bend, vulkan):
    mask, spacing, axis = bend
    session = intima.Session(mask=mask, spacing=spacing, frames=5, size=(160, 120))
    frames = session.frames()
    assert len(frames) == 5
    pictures = list(frames)
    assert [p.shape for p in pictures] == [(120, 160, 3)] * 5 and pictures[0].dtype == np.uint8
    assert all(p.std() > 5 for p in pictures)
    flight, coverage = session.flight(), session.coverage()
    off, _ = cKDTree(axis).query(flight.positions)
    assert len(flight) == 5 and off.max() < 4.0 and flight.fov == pytest.approx(90)
    assert 0.5 < coverage.one_way_fraction <= coverage.both_ways_fraction <= 1
    assert len(coverage.seen_one_way) == len(session.wall().faces)


def test_fly_writes_a_folder_of_frames_and_a_run_writes_everything(bend, vulkan, tmp_path):
    mask, spacing, _ = bend
    settings = {"frames": 3, "size": (96, 64)}
    flight = intima.fly(None, tmp_path / "frames", mask=mask, spacing=spacing, **settings)
    names = sorted(p.name for p in (tmp_path / "frames").glob("*.png"))
    assert names == [f"frame_0000{n}.png" for n in (1, 2, 3)] and len(flight) == 3
    report = intima.Session(mask=mask, spacing=spacing, **settings).run(tmp_path / "case")
    assert report["schema"] == "intima.report/1" and report["frames"]["count"] == 3
    assert (tmp_path / "case" / "centerline.vtp").is_file()
