"""Small label volumes from formulas or a seeded generator; the input of the other modules. Arrays are [z, y, x]; spacing is (x, y, z) in mm.

Shapes are sampled at voxel centres; voxel (0, 0, 0)'s centre is the origin. A few touch the edge of their volume on
purpose: outside the volume is external.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

ISO = (1.0, 1.0, 1.0)
THICK = (0.7, 0.7, 2.5)  # thick slices, the common shape of clinical CT
STEEP = (0.5, 0.5, 5.0)  # 1 : 10


def points(dims, spacing):
    """Voxel centres in mm, [z, y, x, 3], last axis x, y, z."""
    x, y, z = (np.arange(n) * h for n, h in zip(dims, spacing))
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    return np.stack([x, y, z], -1)


def centre(dims, spacing):
    return (np.array(dims) - 1) * np.array(spacing) / 2


def tube(dims, spacing, through, along, radius, half_length):
    """Capsule: all points within `radius` of a segment of the given half length."""
    along = np.array(along, float) / np.linalg.norm(along)
    q = points(dims, spacing) - np.array(through)
    t = np.clip(q @ along, -half_length, half_length)
    return np.linalg.norm(q - t[..., None] * along, axis=-1) <= radius


def torus(dims, spacing, through, major, minor):
    """Ring around the z axis."""
    q = points(dims, spacing) - np.array(through)
    return np.hypot(np.hypot(q[..., 0], q[..., 1]) - major, q[..., 2]) <= minor


def blobs(dims, seed, sigma, part):
    """Smoothed noise, the given part of it inside."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(dims[::-1]), sigma)
    return noise > np.quantile(noise, 1 - part)


def shell(dims):
    """A ball in a shell in a shell: closed cavities inside closed cavities, two of them joined by a hole."""
    q = np.linalg.norm(points(dims, ISO) - centre(dims, ISO), axis=-1)
    mask = (q <= 11) & ((q > 8) | ((q <= 6) & (q > 3)) | (q <= 1))
    c = [n // 2 for n in dims]
    mask[c[2], c[1], c[0] + 3 : c[0] + 7] = False  # joins the two inner cavities
    return mask


def pinholes(dims):
    """A box whose cavities touch the outside by a face, by an edge only, and not at all."""
    mask = np.ones(dims[::-1], bool)
    mask[1:3, 1:3, 1:3] = False
    mask[1, 1, 0] = False  # a face: the first cavity is open
    mask[5:7, 5:7, 5:7] = False
    mask[4, 4, 5] = False  # an edge: does not open the second
    mask[0, 8, 8] = False  # a dent, open by itself
    mask[1, 9, 8] = False  # closed: meets the dent by an edge
    return mask


def lines(dims):
    """One voxel wide: three axis lines, a staircase diagonal and pairs that meet by an edge or a corner only."""
    mask = np.zeros(dims[::-1], bool)
    mask[4, 4, :] = mask[4, :, 4] = mask[:, 4, 4] = True
    for n in range(8, 14):
        mask[n, n, n] = True  # corner contact
        mask[n, n, 2] = mask[2, n, n] = True  # corner-free diagonals: edge contact
    return mask


def every():
    """name -> (mask, spacing)"""
    out = {}

    def add(name, mask, spacing=ISO):
        out[name] = (mask, spacing)

    add("empty", np.zeros((2, 3, 4), bool))
    add("single", np.pad(np.ones((1, 1, 1), bool), 1))
    add("full", np.ones((7, 6, 5), bool))
    add("full_thick", np.ones((5, 9, 8), bool), THICK)
    z, y, x = np.indices((7, 8, 9))
    add("checker", (x + y + z) % 2 == 0)
    add("noise", np.random.default_rng(11).random((22, 23, 24)) < 0.5)
    add("noise_dense", np.random.default_rng(12).random((15, 14, 17)) < 0.85)
    add("lines", lines((17, 16, 15)))
    add("shell", shell((25, 25, 25)))
    add("pinholes", pinholes((12, 11, 10)))
    add("blobs", blobs((34, 31, 26), 21, 2.0, 0.35))
    add("blobs_thick", blobs((33, 29, 21), 22, 2.0, 0.4), THICK)
    add("blobs_steep", blobs((30, 24, 16), 23, 1.8, 0.45), STEEP)
    add("ring", torus((30, 30, 9), ISO, (14.5, 14.5, 4.0), 11.0, 1.2))
    # Half a voxel off the grid: the even-width tube that a test of half a voxel loses whole.
    add("tube", tube((22, 22, 30), ISO, (10.5, 10.5, 14.5), (0, 0, 1), 5.0, 8.0))
    add("oblique", tube((36, 32, 36), ISO, (17.3, 15.2, 17.6), (1.0, 0.45, 0.8), 4.6, 12.0))
    add("torus", torus((34, 34, 15), ISO, (16.3, 16.6, 7.2), 9.0, 4.3))
    d = (32, 30, 22)
    add("oblique_thick", tube(d, THICK, centre(d, THICK), (0.35, 0.25, 1.0), 5.2, 18.0), THICK)
    d = (40, 40, 9)
    add("torus_thick", torus(d, THICK, centre(d, THICK) + (0.1, 0.2, 0.4), 8.0, 4.4), THICK)
    return out
