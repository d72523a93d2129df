"""CT volumes of phantoms: supersampled, blurred by the scanner, sliced, with noise; kept on disk.

Arrays are [z, y, x]; points (x, y, z) in mm with the centre of voxel (0, 0, 0) at the origin."""

import numpy as np
from scipy import ndimage

SPREAD_VOX = 0.6   # Gaussian of the scanner, in voxels of the thin slices
SUPER = 4          # samples a voxel along each axis
GRAIN_VOX = 0.8    # Gaussian of correlated noise


def grid(dims, spacing, offset=(0.0, 0.0, 0.0)):
    """Centres of the voxels, [z, y, x, 3], moved by `offset` voxels."""
    x, y, z = ((np.arange(n) + o) * h for n, h, o in zip(dims, spacing, offset))
    return np.stack(np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None]), -1)


def clean(phantom):
    """Without noise: mean of 4 x 4 x 4 samples a voxel, then the point spread. Only voxels in which two materials may
    meet are sampled finely: those that differ from a neighbour, and all within two voxels of such."""
    dims, spacing = phantom.dims, np.array(phantom.spacing)
    centre = grid(dims, spacing)
    value = np.concatenate([phantom.value(z)[None] for z in centre])
    hu = np.concatenate([phantom.hu(z, v)[None] for z, v in zip(centre, value)]).astype(np.float32)
    mixed = np.abs(value) < 1.5 * spacing.max()
    mixed |= ndimage.maximum_filter(hu, 5) != ndimage.minimum_filter(hu, 5)
    at = np.argwhere(mixed)[:, ::-1] * spacing
    steps = (np.arange(SUPER) + 0.5) / SUPER - 0.5
    total = np.zeros(len(at))
    for dz in steps:
        for dy in steps:
            for dx in steps:
                p = at + np.array([dx, dy, dz]) * spacing
                total += phantom.hu(p, phantom.value(p))
    hu[mixed] = total / SUPER ** 3
    return ndimage.gaussian_filter(hu, SPREAD_VOX)


def noise(shape, sigma, correlated, seed):
    """Of standard deviation `sigma` HU; correlated noise is white noise through a Gaussian, scaled back to `sigma`."""
    grain = np.random.default_rng(seed).standard_normal(shape, np.float32)
    if correlated:
        grain = ndimage.gaussian_filter(grain, GRAIN_VOX, mode="wrap")
        grain /= grain.std()
    return sigma * grain


def slices(array, spacing, count):
    """Means of `count` slices -> (array, spacing, place of the first voxel)."""
    n = len(array) // count
    thick = array[:n * count].reshape(n, count, *array.shape[1:]).mean(1)
    return thick, (*spacing[:2], spacing[2] * count), (0.0, 0.0, (count - 1) / 2 * spacing[2])


def component(mask, voxel):
    """The 6-connected component of voxel (z, y, x)."""
    label, _ = ndimage.label(mask)
    return label == label[voxel] if label[voxel] else np.zeros_like(mask)


def core(phantom, array, spacing, origin, most_mm3=50.0):
    """-> (threshold, seed mm, mask) of the lumen as an organ search would choose it: the largest threshold, up to
    `most` above air, that takes at most `most_mm3` farther than 1 mm outside the wall. The seed is the darkest voxel
    near the middle, as somebody would click it."""
    value = phantom.value(grid(array.shape[::-1], spacing) + np.array(origin))
    seed = np.round((np.array(phantom.seed_mm) - origin) / spacing).astype(int)[::-1]
    near = tuple(slice(max(s - 2, 0), s + 3) for s in seed)
    voxel = np.unravel_index(np.argmin(array[near]), array[near].shape)
    voxel = tuple(int(n.start + v) for n, v in zip(near, voxel))
    cell = float(np.prod(spacing))
    for above in range(phantom.most, -100, -5):
        found = component(array <= phantom.air + above, voxel)
        if found.any() and (found & (value > 1)).sum() * cell <= most_mm3:
            break
    seed_mm = np.array(voxel)[::-1] * np.array(spacing) + origin
    return phantom.air + above, tuple(float(s) for s in seed_mm), found
