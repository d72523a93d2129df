"""Slicer's geometry and intima's. Slicer keeps points in RAS, intima in LPS. Needs NumPy alone."""

import numpy as np

LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0])


def volume_arguments(array, ijk_to_ras):
    """Arguments of `intima.Volume` for Slicer's array of (k, j, i) and its 4 x 4 matrix."""
    matrix = np.asarray(ijk_to_ras, dtype=float)
    axes = LPS_TO_RAS @ matrix[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    return {
        "array": np.ascontiguousarray(array),
        "spacing": tuple(float(n) for n in lengths[::-1]),
        "origin": tuple(float(x) for x in LPS_TO_RAS @ matrix[:3, 3]),
        "direction": axes / lengths,
    }


def to_ras(points):
    """Points or vectors of LPS as RAS, (n, 3)."""
    return np.ascontiguousarray(np.asarray(points, dtype=float) @ LPS_TO_RAS)
