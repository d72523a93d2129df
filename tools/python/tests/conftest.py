"""Phantoms that the tests share, and the device that frames need."""

import os

import numpy as np
import pytest

import intima


def tube(shape, spacing, axis, radius):
    """Mask of the voxels nearer to a polyline (mm, x y z from voxel 0) than a radius, mm."""
    z, y, x = np.meshgrid(*(np.arange(n) * s for n, s in zip(shape, spacing)), indexing="ij")
    voxels = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    from scipy.spatial import cKDTree

    near, _ = cKDTree(axis).query(voxels, distance_upper_bound=radius)
    return (near <= radius).reshape(shape)


@pytest.fixture(scope="session")
def bend():
    """A bent tube of 4 mm: mask, spacing (z, y, x), and its axis, LPS mm."""
    shape, spacing = (40, 56, 72), (1.5, 1.0, 0.8)
    t = np.linspace(0.0, np.pi, 400)
    axis = np.stack([28 - 18 * np.cos(t), 10 + 34 * np.sin(t), 30 + 12 * np.cos(t)], axis=1)
    return tube(shape, spacing, axis, 4.0), spacing, axis


@pytest.fixture(scope="session")
def ct(bend):
    """The bend as air of -1000 HU in tissue of 40 HU, blurred, int16."""
    from scipy.ndimage import gaussian_filter

    mask, spacing, _ = bend
    values = gaussian_filter(np.where(mask, -1000.0, 40.0), [0.6 / s for s in spacing])
    return np.round(values).astype(np.int16), spacing


@pytest.fixture(scope="session")
def vulkan(bend):
    """Skips without a device that draws; with INTIMA_REQUIRE_GPU=1 that fails."""
    mask, spacing, _ = bend
    try:
        next(iter(intima.Session(mask=mask, spacing=spacing, frames=2, size=(64, 48)).frames()))
    except intima.DeviceError as e:
        if os.environ.get("INTIMA_REQUIRE_GPU") == "1":
            raise
        pytest.skip(f"no device that draws: {e}")
