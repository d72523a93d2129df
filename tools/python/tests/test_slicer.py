"""Geometry of the Slicer module, the part of it that runs without Slicer."""

import pathlib
import sys

import numpy as np

import intima

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "slicer" / "Intima"))
from conversion import to_ras, volume_arguments  # noqa: E402


def test_points_of_slicers_matrix_are_the_same_points_in_lps():
    turned = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) * [0.5, 0.75, 2.0]
    matrix = np.vstack([np.column_stack([turned, [10.0, -20.0, 30.0]]), [0, 0, 0, 1]])
    volume = intima.Volume(**volume_arguments(np.zeros((5, 6, 7)), matrix))
    for i, j, k in [(0, 0, 0), (3, 1, 2)]:
        ras = (matrix @ [i, j, k, 1])[:3]
        np.testing.assert_allclose(to_ras(volume.to_world((k, j, i))), ras)
    assert volume.spacing == (2.0, 0.75, 0.5)
