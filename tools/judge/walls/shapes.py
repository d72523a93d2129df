"""Signed distances of simple bodies, mm: negative inside. Points are arrays [..., 3] of (x, y, z).

Each is exact on both sides unless its function says otherwise. Unions (`min`) are exact outside and complements (`max`)
inside; on the other side they understate distances near a crease, nowhere else."""

import numpy as np
from scipy.spatial import cKDTree


def unit(v):
    """`v` at length 1."""
    v = np.asarray(v, float)
    return v / np.linalg.norm(v)


def turn(axis, degrees):
    """The rotation about `axis`."""
    (x, y, z), a = unit(axis), np.radians(degrees)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross


def along(p, start, way):
    """Position along an axis and distance from it, mm."""
    d = p - np.asarray(start, float)
    s = d @ way
    return s, np.sqrt(np.maximum((d * d).sum(-1) - s * s, 0))


def capsule(p, start, end, radius):
    """Everything within `radius` of the segment."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    way = end - start
    share = np.clip((p - start) @ way / (way @ way), 0, 1)
    return np.linalg.norm(p - start - share[..., None] * way, axis=-1) - radius


def cylinder(p, start, way, length, radius):
    """With flat ends."""
    s, rho = along(p, start, way)
    q = np.stack([rho - radius, np.abs(s - length / 2) - length / 2], -1)
    return np.minimum(q.max(-1), 0) + np.linalg.norm(np.maximum(q, 0), axis=-1)


def half_plate(p, centre, normal, up, thickness):
    """Within half of `thickness` of the half plane through `centre` that reaches from there along `up`: a plate with a
    round edge."""
    d = p - np.asarray(centre, float)
    return np.hypot(d @ normal, np.minimum(d @ up, 0)) - thickness / 2


def box(p, sides):
    """Centred on the origin."""
    q = np.abs(p) - np.asarray(sides, float) / 2
    return np.minimum(q.max(-1), 0) + np.linalg.norm(np.maximum(q, 0), axis=-1)


def torus(p, ring, tube):
    """About the z axis."""
    return np.hypot(np.hypot(p[..., 0], p[..., 1]) - ring, p[..., 2]) - tube


class RingedTube:
    """A tube along +s whose radius is `radius` + `swing` cos(2 pi s / period) between `first` and `last`, and `radius`
    beyond, where it has round ends. `inside` is a rough value of the right sign, `distance` the distance to the curve
    (s, radius) sampled every 5 micrometres."""

    def __init__(self, start, way, length, radius, swing, period, first, last):
        self.start, self.way, self.length, self.r0 = np.asarray(start, float), unit(way), length, radius
        self.swing, self.period, self.first, self.last = swing, period, first, last
        s = np.arange(0, length, 0.005)
        arc = np.linspace(0, np.pi / 2, 4000)
        side = np.stack([s, self.radius(s)], 1)
        ends = [np.stack([end + way * radius * np.sin(arc), radius * np.cos(arc)], 1)
                for end, way in ((0, -1), (length, 1))]
        self.curve = cKDTree(np.concatenate([side, *ends]))

    def radius(self, s):
        """Whole periods between `first` and `last`, begun and ended at the mean with a quarter period's shift."""
        on = (s > self.first) & (s < self.last)
        return self.r0 + np.where(on, self.swing * np.sin(2 * np.pi * (s - self.first) / self.period), 0)

    def inside(self, p):
        s, rho = along(p, self.start, self.way)
        beyond = np.where(s < 0, -s, np.maximum(s - self.length, 0))
        return np.hypot(rho, beyond) - self.radius(s)

    def distance(self, p):
        s, rho = along(p, self.start, self.way)
        off, _ = self.curve.query(np.stack([s, rho], -1))
        return np.sign(self.inside(p)) * off
