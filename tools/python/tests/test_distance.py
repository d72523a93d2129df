"""Distances beside SciPy and edt."""

import edt
import numpy as np
import pytest
from scipy import ndimage

import intima

RANDOM = np.random.default_rng(7)


def scipy_distance(mask, spacing):
    """What is beyond the array is outside: SciPy says so of a padded one."""
    return ndimage.distance_transform_edt(np.pad(mask, 1), spacing)[1:-1, 1:-1, 1:-1]


@pytest.mark.parametrize("spacing", [(1, 1, 1), (0.7, 0.7, 0.7), (2.5, 0.7, 0.9)])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_distance_equals_scipy_on_random_masks(share, spacing):
    mask = RANDOM.random((37, 29, 45)) < share
    found = intima.distance(mask, spacing)
    assert found.dtype == np.float32 and found.shape == mask.shape
    np.testing.assert_allclose(found, scipy_distance(mask, spacing), rtol=1e-6, atol=1e-6)


def test_squared_distance_in_voxels_is_the_integer_that_edt_finds(bend):
    mask = bend[0]
    squares = edt.edtsq(mask.astype(np.uint8), black_border=True)
    found = intima.distance(mask)
    np.testing.assert_array_equal(np.round(found.astype(float) ** 2), squares)
    np.testing.assert_array_equal(found, np.sqrt(squares.astype(np.float32)))


def test_every_sample_type_of_a_mask_gives_the_same_distance(bend):
    mask, spacing, _ = bend
    expected = intima.distance(mask, spacing)
    for dtype in "uint8 int8 uint16 int16 uint32 int32 uint64 int64 float32 float64".split():
        np.testing.assert_array_equal(intima.distance(mask.astype(dtype), spacing), expected, dtype)


def test_components_and_cavities_stay_as_they_are():
    mask = np.zeros((20, 20, 20), bool)
    mask[2:9, 2:9, 2:9] = True
    mask[5, 5, 5] = False
    mask[12:15, 12:15, 12:15] = True
    np.testing.assert_allclose(intima.distance(mask), scipy_distance(mask, 1), rtol=1e-6)


def test_labels_choose_what_is_inside():
    labels = np.zeros((9, 9, 9), np.int16)
    labels[1:4], labels[5:8] = 3, 7
    expected = scipy_distance(labels == 7, 1)
    np.testing.assert_allclose(intima.distance(labels, labels=[7]), expected, rtol=1e-6)
    assert not intima.distance(labels, labels=[5]).any()


def test_an_empty_mask_has_no_distance():
    found = intima.distance(np.zeros((4, 5, 6), bool))
    assert found.shape == (4, 5, 6) and not found.any()


def test_distance_does_not_depend_on_the_number_of_threads():
    mask = RANDOM.random((50, 60, 70)) < 0.9
    one, many = (intima.distance(mask, (2, 1, 1), threads=n) for n in (1, 5))
    np.testing.assert_array_equal(one, many)
