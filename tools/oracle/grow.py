"""Region growing on grey values: 6-connected component of the seed between two inclusive limits, then filled; and the
flood level, c(v) = the least maximum on any 6-path from the seed to v, by morphological reconstruction."""

import numpy as np
from scipy.ndimage import binary_fill_holes, gaussian_filter, label
from skimage.morphology import reconstruction

import masks

DIMS = (28, 25, 16)
SPACING = (0.8, 0.8, 1.5)
LEVELS = [-980, -960, -940, -920, -900, -850, -800, -700, -600, -500]


def volume():
    """A tube of air in noisy tissue whose wall has a thin place, with a pocket of noise beyond it: int16, HU-like."""
    q = masks.points(DIMS, (1, 1, 1))
    axis = np.hypot(q[..., 0] - 9.3, q[..., 1] - 11.6)
    grey = np.where(axis <= 5.2, -1000.0, 40.0)
    pocket = q[..., 0] >= 17
    grey[pocket] = -860.0
    gap = (np.abs(q[..., 1] - 12) <= 1) & (np.abs(q[..., 2] - 7) <= 1) & (q[..., 0] > 9)
    grey[gap & ~pocket] = -880.0
    grey[(axis <= 1.5) & (np.abs(q[..., 2] - 12) <= 1)] = 60.0  # an island of tissue: a hole to fill
    grey = gaussian_filter(grey, 0.6)
    grey += np.random.default_rng(31).normal(0, 25, grey.shape)
    return np.rint(grey).astype(np.int16)


SEED = (9, 11, 3)


def grown(grey, low, high):
    inside = (grey >= low) & (grey <= high)
    labels, _ = label(inside)
    at = labels[SEED[::-1]]
    return (labels == at) if at else np.zeros_like(inside)


def fixture():
    grey = volume()
    six = np.zeros((3, 3, 3), bool)
    six[1, 1, :] = six[1, :, 1] = six[:, 1, 1] = True
    start = np.full(grey.shape, grey.max(), float)
    start[SEED[::-1]] = grey[SEED[::-1]]
    level = reconstruction(start, grey.astype(float), method="erosion", footprint=six)
    recipes = []
    for low, high in [(None, t) for t in LEVELS] + [(-1060, -900), (-1060, None)]:
        low_, high_ = -32768 if low is None else low, 32767 if high is None else high
        g = grown(grey, low_, high_)
        if low is None:
            assert int((level <= high).sum()) == int(g.sum()), "flood level and growing differ"
        recipes.append({
            "low": low, "high": high, "grown": int(g.sum()), "filled": int(binary_fill_holes(g).sum()),
        })
    return grey, level.astype(np.int16), {"seed": list(SEED), "recipes": recipes}
