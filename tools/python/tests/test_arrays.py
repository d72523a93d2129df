"""How arrays come in: borrowed, and refused where they cannot be."""

import subprocess
import sys

import nibabel
import numpy as np
import pytest
import SimpleITK

import intima


def test_an_array_is_borrowed_not_copied():
    # Ten times the size of what is computed of it: a copy would show.
    program = """
import resource, numpy as np, intima
mask = np.zeros((200, 300, 400)); mask[60:90, 60:90, 60:90] = 1
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
intima.Session(mask=np.ones((8, 8, 8)), device="cpu", threads=2).lumen()
before = peak()
session = intima.Session(mask=mask, device="cpu", threads=2); session.lumen()
print(mask.nbytes, peak() - before)
"""
    out = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    size, grown = map(int, out.stdout.split())
    assert grown < 0.4 * size, f"{grown} bytes more for an array of {size}"


def test_a_session_sees_what_is_written_to_its_array_before_it_reads():
    mask = np.zeros((12, 12, 12), np.uint8)
    session = intima.Session(mask=mask)
    mask[3:9, 3:9, 3:9] = 1
    assert session.lumen().mask.sum() == 216


def test_a_session_keeps_its_array():
    mask = np.ones((12, 12, 12), np.uint8)
    session = intima.Session(mask=mask)
    del mask
    junk = [np.zeros((12, 12, 12), np.uint8) for _ in range(100)]
    assert session.lumen().mask.all() and len(junk) == 100


def test_a_read_only_array_is_as_good():
    mask = np.ones((6, 6, 6), np.float32)
    mask.flags.writeable = False
    assert intima.distance(mask).max() == 3


@pytest.mark.parametrize(
    "array, what",
    [
        (np.ones((4, 4)), "three are needed"),
        (np.ones((4, 0, 4)), "no voxels"),
        (np.ones((4, 5, 6), order="F"), "pass array.T"),
        (np.ones((4, 5, 12))[..., ::2], "ascontiguousarray"),
        (np.ones((4, 5, 6), complex), "samples of type complex128"),
        (np.ones((4, 5, 6), np.float16), "samples of type float16"),
        (np.ones((4, 5, 6), ">i2"), "byte order"),
        (np.array([[[object()]]]), "samples of type object"),
        (np.frombuffer(bytes(8 * 8 + 1), np.uint8)[1:].view(np.float64).reshape(2, 2, 2), "aligned"),
    ],
)
def test_arrays_that_cannot_be_borrowed_are_refused_with_a_reason(array, what):
    with pytest.raises(intima.ArgumentError, match=what):
        intima.Session(mask=array)


@pytest.mark.parametrize(
    "geometry, what",
    [
        ({"spacing": (1, 0, 1)}, "spacing"),
        ({"spacing": (1, 1)}, "three numbers"),
        ({"origin": (0, np.nan, 0)}, "origin"),
        ({"direction": np.zeros((3, 3))}, "direction"),
        ({"direction": np.eye(2)}, "3 x 3"),
    ],
)
def test_geometry_that_cannot_be_is_refused(geometry, what):
    with pytest.raises(intima.ArgumentError, match=what):
        intima.Session(mask=np.ones((4, 4, 4)), **geometry)


def image():
    """An oblique SimpleITK image."""
    image = SimpleITK.GetImageFromArray(np.arange(4 * 5 * 6, dtype=np.int16).reshape(4, 5, 6))
    image.SetSpacing((0.5, 0.75, 2.0))
    image.SetOrigin((-10.0, 20.0, 30.0))
    image.SetDirection((0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0))
    return image


def test_points_of_a_simpleitk_image_lie_where_simpleitk_has_them():
    itk = image()
    volume = intima.Volume.from_sitk(itk)
    assert volume.shape == (4, 5, 6) and volume.spacing == (2.0, 0.75, 0.5)
    for x, y, z in [(0, 0, 0), (5, 0, 0), (1, 3, 2), (0, 0, 3)]:
        point = itk.TransformIndexToPhysicalPoint((x, y, z))
        np.testing.assert_allclose(volume.to_world((z, y, x)), point)
        np.testing.assert_allclose(volume.to_index(point), (z, y, x), atol=1e-9)


def test_the_engine_puts_points_where_the_volume_does():
    mask = np.zeros((14, 15, 16), np.uint8)
    mask[5:9, 6:10, 7:12] = 1
    volume = intima.Volume.from_sitk(image()).with_array(mask)
    vertices = intima.surface(volume, wall="exact").vertices
    at = volume.to_index(vertices)
    np.testing.assert_allclose(at.min(axis=0), (4.5, 5.5, 6.5), atol=1e-4)
    np.testing.assert_allclose(at.max(axis=0), (8.5, 9.5, 11.5), atol=1e-4)
    session = intima.Session(mask=volume)
    np.testing.assert_allclose(session.geometry()["direction"], volume.direction, atol=1e-12)
    assert session.geometry()["spacing"] == volume.spacing


@pytest.mark.parametrize("extension", ["nrrd", "mha", "nii.gz"])
def test_a_file_reads_as_simpleitk_reads_it(tmp_path, extension):
    itk = image()
    path = tmp_path / f"a.{extension}"
    SimpleITK.WriteImage(itk, str(path))
    read, expected = intima.Volume.read(path), intima.Volume.from_sitk(itk)
    np.testing.assert_array_equal(read.array, expected.array)
    np.testing.assert_allclose(read.to_world((3, 2, 1)), expected.to_world((3, 2, 1)), atol=1e-4)


def test_a_nibabel_image_lies_where_the_reader_puts_the_file(tmp_path):
    path = tmp_path / "a.nii.gz"
    SimpleITK.WriteImage(image(), str(path))
    nib = nibabel.load(path)
    volume, read = intima.Volume.from_nibabel(nib), intima.Volume.read(path)
    np.testing.assert_array_equal(volume.array, read.array)
    assert volume.array.flags.c_contiguous
    np.testing.assert_allclose(volume.to_world((3, 2, 1)), read.to_world((3, 2, 1)), atol=1e-4)


def test_rescale_makes_real_values(tmp_path):
    nib = nibabel.Nifti1Image(np.arange(24, dtype=np.int16).reshape(2, 3, 4), np.eye(4))
    nib.header.set_slope_inter(2.0, -1000.0)
    path = tmp_path / "a.nii"
    nibabel.save(nib, path)
    # nibabel divides by the slope when it writes: what it reads again is the truth.
    real = nibabel.load(path).get_fdata().T
    for volume in intima.Volume.read(path), intima.Volume.from_nibabel(nibabel.load(path)):
        np.testing.assert_allclose(volume.real(), real, atol=1e-3)
        found = intima.segment(volume, threshold=(-980, None), all_components=True, wall="exact", fill=False)
        np.testing.assert_array_equal(found.mask, real >= -980)
