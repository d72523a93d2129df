"""Hollow organs given by formulas, independent of intima, so that the truth is nobody's output.

A phantom has `value(p)`, negative inside and zero on the wall, and an `axis` with the radius `reach` of the largest
ball there. `value` is a distance in mm for the round ones and close to one near the wall for the others.
All lengths follow the smallest side of the box, so one shape serves every grid."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from files import resample


class Phantom:
    """What all phantoms share."""

    def slope(self, p, h=1e-3):
        """Gradient of `value`, by central differences."""
        steps = np.eye(3) * h
        return np.stack([(self.value(p + e) - self.value(p - e)) / (2 * h) for e in steps], 1)

    def distance(self, p):
        """Distance to the wall, mm, to first order in it."""
        return self.value(p) / np.maximum(np.linalg.norm(self.slope(p), axis=1), 1e-9)

    def normal(self, p):
        """Unit vectors away from the lumen."""
        g = self.slope(p)
        return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)


class Sphere(Phantom):
    """Off the grid's symmetry, as all centres here are."""

    def __init__(self, box):
        self.reach = 0.37 * box.min()
        self.axis = np.tile(box / 2 + (0.13, 0.21, 0.07), (2, 1))

    def value(self, p):
        return np.linalg.norm(p - self.axis[0], axis=1) - self.reach


class Torus(Phantom):
    """A ring, tilted."""

    def __init__(self, box):
        self.ring, self.reach = 0.29 * box.min(), 0.12 * box.min()
        self.centre, up = box / 2 + (0.13, 0.21, 0.07), np.array([0.3, 0.2, 1.0])
        self.up = up / np.linalg.norm(up)
        a = np.cross(self.up, (1, 0, 0))
        a /= np.linalg.norm(a)
        turn = np.linspace(0, 2 * np.pi, 721)[:, None]
        self.axis = self.centre + self.ring * (np.cos(turn) * a + np.sin(turn) * np.cross(self.up, a))

    def value(self, p):
        q = p - self.centre
        height = q @ self.up
        flat = np.linalg.norm(q - height[:, None] * self.up, axis=1)
        return np.hypot(flat - self.ring, height) - self.reach


class Branches(Phantom):
    """A trunk, two children, four grandchildren: capsules. Its axis runs to the first grandchild."""

    def __init__(self, box):
        m = box.min()
        trunk, fork, left, right, *tips = box / 2 + m * (np.array([
            (0.5, 0.5, 0.1), (0.5, 0.5, 0.4), (0.3, 0.52, 0.62), (0.72, 0.46, 0.6),
            (0.14, 0.4, 0.88), (0.34, 0.7, 0.88), (0.66, 0.26, 0.88), (0.88, 0.6, 0.86)]) - 0.5)
        pairs = [(trunk, fork), (fork, left), (fork, right), *((left, t) for t in tips[:2]),
                 *((right, t) for t in tips[2:])]
        self.parts = list(zip(pairs, m * np.array([0.075, 0.052, 0.052, *[0.034] * 4])))
        self.reach = 0.075 * m
        self.axis = resample(np.array([trunk, fork, left, tips[0]]), m / 1280)
        self.all_axes = np.concatenate([resample(np.array(pair), m / 320) for pair in pairs])

    def value(self, p):
        best = np.full(len(p), np.inf)
        for (a, b), radius in self.parts:
            along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            best = np.minimum(best, np.linalg.norm(p - a - along[:, None] * (b - a), axis=1) - radius)
        return best


class Turned(Phantom):
    """A body of revolution, or of three half axes, about a tilted axis of its own through the box's centre."""

    def place(self, box, half_length):
        """The frame, and an axis of `half_length` mm both ways."""
        up = np.array([0.35, 0.2, 0.9])
        self.centre, up = box / 2 + (0.13, 0.21, 0.07), up / np.linalg.norm(up)
        side = np.cross(up, (0.4, 1, 0))
        side /= np.linalg.norm(side)
        self.frame = np.stack([side, np.cross(up, side), up])
        self.axis = resample(self.centre + np.outer([-half_length, half_length], up), half_length / 100)

    def local(self, p):
        """Coordinates along the body's axes, the long one last; mm."""
        return (p - self.centre) @ self.frame.T

    def polar(self, p):
        """-> distance from the long axis, and how far along it; mm."""
        q = self.local(p)
        return np.hypot(q[:, 0], q[:, 1]), q[:, 2]


class Ellipsoid(Turned):
    """Three different half axes: curvature changes everywhere."""

    def __init__(self, box):
        self.half = box.min() * np.array([0.14, 0.24, 0.38])
        self.reach = self.half[1]
        self.place(box, self.half[2])

    def value(self, p):
        q = self.local(p) / self.half
        size = np.linalg.norm(q, axis=1)
        return size * (size - 1) / np.maximum(np.linalg.norm(q / self.half, axis=1), 1e-9)


class Cone(Turned):
    """A ball that shrinks as it moves along a line: a cone with a wide cap and a tip of 2.5 % of the box."""

    def __init__(self, box):
        m = box.min()
        self.wide, self.tip, self.length = 0.2 * m, 0.025 * m, 0.5 * m
        self.reach = self.wide
        self.place(box, self.length / 2)

    def value(self, p):
        away, along = self.polar(p)
        along = along + self.length / 2
        sine = (self.wide - self.tip) / self.length
        cosine = np.sqrt(1 - sine ** 2)
        foot = cosine * along - sine * away  # along the wall, from the wide ball's contact with it
        side = away * cosine + along * sine - self.wide
        return np.where(foot < 0, np.hypot(away, along) - self.wide,
                        np.where(foot > self.length * cosine, np.hypot(away, along - self.length) - self.tip, side))


class Hyperboloid(Turned):
    """Of one sheet, a saddle everywhere, between two planes; the rims are rounded."""

    def __init__(self, box):
        m = box.min()
        self.waist, self.slope_at_infinity, self.half_length, self.rim = 0.1 * m, 0.55, 0.34 * m, 0.05 * m
        self.reach = np.hypot(self.waist, self.slope_at_infinity * self.half_length)
        self.place(box, self.half_length)

    def value(self, p):
        away, along = self.polar(p)
        radius = np.hypot(self.waist, self.slope_at_infinity * along)
        steep = self.slope_at_infinity ** 2 * along / radius
        wall, end = (away - radius) / np.hypot(1, steep), np.abs(along) - self.half_length
        inner = np.minimum(np.maximum(wall, end), -self.rim)
        return inner + np.hypot(np.maximum(wall + self.rim, 0), np.maximum(end + self.rim, 0))


class Swept(Phantom):
    """A section swept along a curve with frames that do not twist, and rounded ends."""

    def sweep(self, points, tightest=0.0):
        """Makes the axis of `points`, smoothed until no bend is tighter than `tightest` mm."""
        self.axis = resample(_relaxed(points, tightest), self.unit / 10)
        steps = np.linalg.norm(np.diff(self.axis, axis=0), axis=1)
        self.along = np.concatenate([[0], np.cumsum(steps)])
        self.t = np.gradient(self.axis, axis=0)
        self.t /= np.linalg.norm(self.t, axis=1, keepdims=True)
        self.u, side = np.empty_like(self.t), np.cross(self.t[0], np.eye(3)[np.argmin(np.abs(self.t[0]))])
        for i, t in enumerate(self.t):
            side = side - (side @ t) * t
            side /= np.linalg.norm(side)
            self.u[i] = side
        self.v, self.tree = np.cross(self.t, self.u), cKDTree(self.axis)

    def local(self, p):
        """-> position along the curve, across (two ways), and how far beyond an end; mm.
        Samples lie a tenth of a mm apart, so the nearest one with its frame stands for the foot point."""
        _, i = self.tree.query(p, workers=-1)
        d = p - self.axis[i]
        ahead, a, b = (np.einsum("ij,ij->i", d, frame[i]) for frame in (self.t, self.u, self.v))
        end = (i == 0) & (ahead < 0) | (i == len(self.axis) - 1) & (ahead > 0)
        return self.along[i] + np.where(end, 0, ahead), a, b, np.where(end, ahead, 0)


class Tube(Swept):
    """Bent, of elliptical section 3:2."""

    def __init__(self, box):
        self.unit = box.min() / 128
        self.small = 0.062 * box.min()
        self.reach = 1.5 * self.small
        self.sweep(_spline(box, [(.18, .20, .22), (.30, .62, .30), (.52, .74, .52), (.70, .48, .66),
                                 (.64, .28, .76), (.54, .17, .85)]), 2.2 * self.reach)

    def value(self, p):
        _, a, b, beyond = self.local(p)
        return np.sqrt((a / 1.5) ** 2 + b ** 2 + beyond ** 2) - self.small


class Helix(Swept):
    """Two and a half turns of a round tube."""

    def __init__(self, box):
        m, t = box.min(), np.linspace(0, 1, 6000)
        self.unit, self.reach, turn = m / 128, 0.055 * m, 5 * np.pi * t
        ring = [0.3 * m * np.cos(turn), 0.3 * m * np.sin(turn), (t - 0.5) * 0.68 * m]
        self.sweep(box / 2 + np.stack(ring, 1))

    def value(self, p):
        _, a, b, beyond = self.local(p)
        return np.sqrt(a ** 2 + b ** 2 + beyond ** 2) - self.reach


class Colon(Swept):
    """Long and winding, with folds in three columns and a slowly changing calibre."""

    def __init__(self, box):
        self.unit, self.mean = box.min() / 128, 0.062 * box.min()
        self.reach, self.fold = 1.25 * self.mean, 2.1 * self.mean
        self.sweep(_spline(box, [
            (.50, .86, .10), (.46, .70, .14), (.58, .60, .26), (.76, .58, .30), (.84, .40, .44), (.83, .24, .66),
            (.80, .16, .86), (.64, .27, .78), (.46, .33, .70), (.28, .24, .84), (.15, .20, .78), (.14, .34, .54),
            (.16, .46, .34), (.20, .64, .18)]), 1.6 * self.reach)

    def value(self, p):
        s, a, b, beyond = self.local(p)
        phase = (np.mod(s, self.fold) / self.fold - 0.5) / 0.16
        calibre = 1 + 0.22 * np.sin(2 * np.pi * s / (0.37 * self.along[-1]) + 0.5)
        columns = 0.72 + 0.28 * np.cos(3 * np.arctan2(b, a))
        wall = self.mean * calibre * (1 - 0.38 * np.exp(-phase ** 2) * columns)
        return np.sqrt(a ** 2 + b ** 2 + beyond ** 2) - wall


KINDS = {"sphere": Sphere, "torus": Torus, "tube": Tube, "helix": Helix, "y": Branches, "colon": Colon,
         "ellipsoid": Ellipsoid, "cone": Cone, "hyperboloid": Hyperboloid}


def make(kind, box):
    """The phantom `kind` in a box of (x, y, z) mm."""
    return KINDS[kind](np.asarray(box, float))


def sample(phantom, dims, spacing, block=8):
    """`value` on the grid, float32 [z, y, x]; 1000 where the wall is far. `dims` is (x, y, z)."""
    spacing = np.asarray(spacing, float)
    out = np.full(dims[::-1], 1e3, np.float32)
    tree = cKDTree(getattr(phantom, "all_axes", phantom.axis))
    corners = np.stack(np.meshgrid(*(np.arange(0, n, block) for n in dims), indexing="ij"), -1).reshape(-1, 3)
    near = phantom.reach + np.linalg.norm(spacing) * (block / 2 + 3)
    found, _ = tree.query((corners + (block - 1) / 2) * spacing, distance_upper_bound=near, workers=-1)
    inner = np.stack(np.meshgrid(*[np.arange(block)] * 3, indexing="ij"), -1).reshape(-1, 3)
    chosen = corners[np.isfinite(found)]
    for start in range(0, len(chosen), 1000):
        voxels = (chosen[start:start + 1000, None] + inner).reshape(-1, 3)
        voxels = voxels[(voxels < dims).all(1)]
        out[tuple(voxels.T[::-1])] = phantom.value(voxels * spacing)
    return out


def grey(values, spacing, noise_hu=15.0):
    """CT-like int16: air -950 HU, wall 40 HU, one voxel of partial volume, noise; -455 HU is where `value` is 0."""
    share = np.clip(values / np.mean(spacing) * 0.5 + 0.5, 0, 1)
    noise = np.random.default_rng(1).normal(0, noise_hu, values.shape)
    return np.round(-950 + 990 * share + noise).astype(np.int16)


def _spline(box, knots):
    knots = np.asarray(knots) * box
    chord = np.sqrt(np.linalg.norm(np.diff(knots, axis=0), axis=1))
    at = np.concatenate([[0], np.cumsum(chord)])
    return CubicSpline(at, knots)(np.linspace(0, at[-1], 8000))


def _relaxed(points, tightest):
    """Where a bend is tighter than the section is wide, the sweep folds over itself and its axis is medial no more."""
    start = resample(points, np.linalg.norm(np.diff(points, axis=0), axis=1).sum() / 2000)
    n, curve, width = len(start), start, 8.0
    mirrored = np.concatenate([2 * start[0] - start[:0:-1], start, 2 * start[-1] - start[-2::-1]])
    while width < 400:
        step = np.linalg.norm(curve[1] - curve[0])
        bend = np.linalg.norm(curve[2:] - 2 * curve[1:-1] + curve[:-2], axis=1) / step ** 2
        if bend[10:-10].max() * tightest <= 1:
            break
        curve = resample(gaussian_filter1d(mirrored, width, axis=0)[n - 1:2 * n - 1], step)
        width *= 1.15
    return curve
