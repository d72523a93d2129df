"""How far a surface lies from the half-maximum of the grey profile across it, in a CT without known truth.

The definition. The volume is smoothed with a Gaussian of half a voxel. Each of up to 20,000 vertices (chosen at random,
seed 1) looks along the grey gradient at it, which points outwards, as gas is dark. L, one value for all, is the median
of the profiles between 3 and 2 mm inwards. The wall's value is the largest on the way out, from half a millimetre
inside to 3 mm outside, until the profile has fallen 50 HU below it (so the first maximum), and at most 60 HU: what is
brighter counts as tissue. A place counts if the gradient is over 50 HU/mm, the wall rises over 300 HU above L and its
value is over -50 HU: a wall that is darker is thinner than its blur, and half of its maximum is not its edge. There the
offset is the distance to the nearest crossing of (L + wall) / 2, positive where the crossing lies farther out than the
vertex.

Tagged fluid is brighter than its wall: the gradient at a vertex points into the lumen there. `fluid` judges such
places by the mesh's normals (into the lumen): the profile runs against the normal, from 3 mm inwards to 3 mm outwards.
A place is fluid's if the values from 3 to 1 mm inwards are all over 250 HU; L is the median of those from 3 to 2 mm at
each place, as tagging is uneven. The wall's value is the least on the way out, until the profile has risen 50 HU above
it; it has to be under 150 HU and counts as at least 40 HU, so that fat is tissue. The offset is the distance to the
nearest downward crossing of (L + wall) / 2. A place with less than -300 HU within 4 mm along an axis is left out: gas,
fluid and tissue are mixed there. `gas` in its answer is the same for places that are under -700 HU inwards, without
those with more than 250 HU within 4 mm; in a lumen with fluid, `profile` mixes both and the level.

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


def fluid(vertices, normals, volume):
    """-> figures of walls of tagged fluid and of gas; places are told apart by the values inwards."""
    pick = np.random.default_rng(SEED).permutation(len(vertices))[:MOST]
    p, way = vertices[pick], -normals[pick]
    steps = np.linspace(-SPAN_MM, SPAN_MM, int(round(2 * SPAN_MM / STEP_MM)) + 1)
    seen = np.stack([volume.at(p + s * way) for s in steps], 1)
    inwards = seen[:, steps < -1 + STEP_MM / 2]
    reach = [s * d for d in np.concatenate([np.eye(3), -np.eye(3)]) for s in (1, 2, 3, 4)]
    about = np.stack([volume.at(p + d) for d in reach])
    no_gas, no_fluid = about.min(0) > -300, about.max(0) < 250
    found = {}
    for name, own, sign, limits in [("fluid", (inwards > 250).all(1) & no_gas, -1, (-150, 0)),
                                    ("gas", (inwards < -700).all(1) & no_fluid, 1, (-50, 60))]:
        # Counted so that the wall is a rise.
        q = sign * seen[own]
        if not len(q):
            continue
        lumen = np.median(q[:, steps < -2 + STEP_MM / 2], axis=1)
        ahead = q[:, steps > -0.5 - STEP_MM / 2]
        most = np.maximum.accumulate(ahead, axis=1)
        fallen = most - ahead > 50
        stop = np.where(fallen.any(1), fallen.argmax(1), ahead.shape[1] - 1)
        wall = most[np.arange(len(most)), stop]
        # Fat beyond fluid's wall counts as tissue.
        wall_top = np.minimum(wall, -40 if sign < 0 else limits[1])
        clear = (wall > limits[0]) & (wall_top - lumen > 200)
        off = np.where(clear, _crossing(q, (lumen + wall_top) / 2, steps), np.nan)
        known = off[~np.isnan(off)]
        found[name] = {"places": len(known), "judged": float(len(known) / len(q)), "share": float(own.mean())}
        if len(known):
            found[name].update(rms_mm=float(np.sqrt((known ** 2).mean())), mean_mm=float(known.mean()),
                               p95_mm=float(np.percentile(np.abs(known), 95)))
    return found


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
