"""How far a surface lies from the half-maximum of the grey profile across it, in a CT without known truth.

The definition. The volume is smoothed with a Gaussian of half a voxel. Each of up to 20,000 vertices (chosen at random,
seed 1) looks along the grey gradient at it, which points outwards, as gas is dark. L, one value for all, is the median
of the profiles between 3 and 2 mm inwards. The wall's value is the largest on the way out, from half a millimetre
inside to 3 mm outside, until the profile has fallen 50 HU below it (so the first maximum), and at most 60 HU: what is
brighter counts as tissue. A place counts if the gradient is over 50 HU/mm, the wall rises over 300 HU above L and its
value is over -50 HU: a wall that is darker is thinner than its blur, and half of its maximum is not its edge. There the
offset is the distance to the nearest crossing of (L + wall) / 2, positive where the crossing lies farther out than the
vertex.

It says nothing about thin walls; those are for phantoms. `normals` is the mean angle between the mesh's normals and the
gradient."""

import numpy as np
from scipy import ndimage

MOST, SEED = 20_000, 1
SPAN_MM, STEP_MM = 3.0, 0.1


class Volume:
    """A CT that is looked into between its voxels."""

    def __init__(self, image):
        import SimpleITK as sitk
        self.array = sitk.GetArrayFromImage(image).astype(np.float32)
        self.spacing, self.origin = np.array(image.GetSpacing()), np.array(image.GetOrigin())
        self.direction = np.array(image.GetDirection()).reshape(3, 3)
        self.soft = ndimage.gaussian_filter(self.array, 0.5)

    def at(self, points):
        """Smoothed values, HU."""
        voxel = ((points - self.origin) @ self.direction) / self.spacing
        return ndimage.map_coordinates(self.soft, voxel.T[::-1], order=1, mode="nearest")

    def slope(self, points):
        """Gradient, HU/mm."""
        h = self.spacing.min() / 2
        return np.stack([(self.at(points + h * e) - self.at(points - h * e)) / (2 * h) for e in np.eye(3)], 1)


def _crossing(profile, level, steps):
    """Position of the upward crossing of 0 nearest to the middle of each row of `profile - level`; NaN for none."""
    q = profile - level[:, None]
    up = (q[:, :-1] < 0) & (q[:, 1:] >= 0)
    rise = np.where(up, q[:, 1:] - q[:, :-1], 1)
    at = np.where(up, steps[:-1] - STEP_MM * q[:, :-1] / rise, np.inf)
    best = at[np.arange(len(at)), np.abs(at).argmin(1)]
    return np.where(np.isfinite(best), best, np.nan)


def profile(vertices, normals, volume):
    """-> the figures of a row."""
    pick = np.random.default_rng(SEED).permutation(len(vertices))[:MOST]
    p = vertices[pick]
    slope = volume.slope(p)
    steep = np.linalg.norm(slope, axis=1)
    out = slope / np.maximum(steep, 1e-9)[:, None]
    steps = np.linspace(-SPAN_MM, SPAN_MM, int(round(2 * SPAN_MM / STEP_MM)) + 1)
    seen = np.stack([volume.at(p + s * out) for s in steps], 1)
    dark = float(np.median(seen[:, steps < -2 + STEP_MM / 2]))
    ahead = seen[:, steps > -0.5 - STEP_MM / 2]
    most = np.maximum.accumulate(ahead, axis=1)
    fallen = most - ahead > 50
    stop = np.where(fallen.any(1), fallen.argmax(1), ahead.shape[1] - 1)
    bright = np.minimum(most[np.arange(len(most)), stop], 60)
    judged = (bright - dark > 300) & (bright > -50) & (steep > 50)
    off = np.where(judged, _crossing(seen, (dark + bright) / 2, steps), np.nan)
    known = ~np.isnan(off)
    found = {"places": int(known.sum()), "judged": float(known.mean())}
    if not known.any():
        return found
    found.update(rms_mm=float(np.sqrt((off[known] ** 2).mean())), p95_mm=float(np.percentile(np.abs(off[known]), 95)),
                 mean_mm=float(off[known].mean()))
    if normals is not None:
        cos = np.abs((normals[pick][known] * out[known]).sum(1))
        found["normals_deg"] = float(np.degrees(np.arccos(np.clip(cos, 0, 1))).mean())
    return found
