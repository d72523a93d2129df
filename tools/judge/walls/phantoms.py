"""Organs given by formulas, with CT values: where their walls are is known.

A phantom has `dims` and `spacing` of its volume, `value(p)` (mm; of exact sign, and exact enough
near the wall to tell where to sample finely), `distance(p)` (signed distance from the wall, for scores), `hu(p, value)`
of a point, `seed_mm` about which the lumen is clicked, `air`, the value `half` at which other programs contour it, and
`most`: how far above air the lumen's threshold may lie. `parts(p)` says to which scored part a point belongs."""

import numpy as np

from shapes import RingedTube, along, capsule, cylinder, half_plate, turn, unit

TISSUE, LUNG = 40.0, -850.0


class Bronchi:
    """Six tilted tubes from one along x, with walls of 1.0 to 1.5 mm against lung, and a seventh whose wall thins to
    nothing towards its tip."""

    name, air, half, most = "bronchi", -950.0, -500.0, 70
    dims, spacing = (128, 128, 96), (0.7, 0.7, 0.8)
    header = (np.array([10.0, 44.0, 13.0]), np.array([79.0, 44.0, 13.0]), 5.0, 1.5)
    seed_mm = (44.0, 44.0, 13.0)
    # Radius, wall, at which x of the header, slope along x; neighbours go to opposite sides.
    branches = [(5.0, 1.5, 14.0, -0.05), (1.5, 1.0, 24.0, -0.09), (4.0, 1.4, 34.0, 0.04), (2.0, 1.1, 44.0, -0.04),
                (3.0, 1.3, 62.0, -0.06), (2.5, 1.2, 54.0, 0.1)]
    fading = (3.0, 1.2, 75.0, 0.06)

    def __init__(self):
        self.tubes = []
        for i, (radius, wall, x, slope) in enumerate([*self.branches, self.fading]):
            side = 1 if (i % 2 == 0) else -1
            way = unit([slope, side * (0.42 + 0.03 * np.cos(1.7 * i)), 1.0])
            length = 52.0 / way[2]
            start = np.array([x, 44.0, 13.0])
            self.tubes.append((start, start + length * way, way, length, radius, wall))

    def value(self, p):
        start, end, radius, _ = self.header
        tubes = [capsule(p, a, b, r) for a, b, _, _, r, _ in self.tubes]
        return np.minimum.reduce([capsule(p, start, end, radius), *tubes])

    distance = value

    def hu(self, p, value):
        start, end, radius, wall = self.header
        outer = capsule(p, start, end, radius + wall)
        for i, (a, b, way, length, r, w) in enumerate(self.tubes):
            if i == 6:
                w = w * np.clip(1 - along(p, a, way)[0] / length, 0, 1)
            outer = np.minimum(outer, capsule(p, a, b, r) - w)
        return np.where(value < 0, self.air, np.where(outer < 0, TISSUE, LUNG))

    def parts(self, p):
        """Which of the six tubes a point belongs to (-1: none), and how far out the wall is scored: half of it."""
        best, part, reach = capsule(p, *self.header[:3]), np.full(len(p), -1), np.full(len(p), 0.75)
        for i, (a, b, way, length, r, w) in enumerate(self.tubes):
            d, (s, _) = capsule(p, a, b, r), along(p, a, way)
            near = d < best
            best = np.where(near, d, best)
            scored = (s > 17) & (s < length - 2) & (i < 6)
            part = np.where(near, np.where(scored, i, -1), part)
            reach = np.where(near, w / 2, reach)
        return part, reach

    def reached(self, points):
        """How many of the six tubes hold some of `points` in the last tenth of their length."""
        ends = [(s > 0.9 * t[3]) & (rho < t[4]) for t in self.tubes[:6] for s, rho in [along(points, t[0], t[2])]]
        return int(sum(e.any() for e in ends))

    def radii(self):
        return [r for r, *_ in self.branches]


class Carina:
    """A trachea with rings that parts into two bronchi at a sharp spur."""

    name, air, half, most = "carina", -950.0, -500.0, 70
    dims, spacing = (104, 96, 100), (0.7, 0.7, 0.8)
    swing, period, wall = 0.35, 4.5, 2.0

    def __init__(self):
        tilt = turn([1, 0.6, 0.2], 8)
        self.fork = np.array([36.0, 33.0, 36.0])
        up = tilt @ [0, 0, 1.0]
        self.length = 30.0
        self.top = self.fork + self.length * up
        self.trachea = RingedTube(self.top, -up, self.length, 8.0, self.swing, self.period, 2.0, 2.0 + 4 * self.period)
        ways = [tilt @ turn([0, 1, 0], a) @ [0, 0, -1.0] for a in (38, -34)]
        self.bronchi = [(self.fork, self.fork + 34 * w, r) for w, r in zip(ways, (6.0, 5.0))]
        self.seed_mm = tuple(self.fork + 12 * up)

    def _branches(self, p):
        return np.minimum(*[capsule(p, a, b, r) for a, b, r in self.bronchi])

    def value(self, p):
        return np.minimum(self.trachea.inside(p), self._branches(p))

    def distance(self, p):
        return np.minimum(self.trachea.distance(p), self._branches(p))

    def hu(self, p, value):
        outer = np.minimum(capsule(p, self.top, self.fork, 8.0 + self.wall), self._branches(p) - self.wall)
        return np.where(value < 0, self.air, np.where(outer < 0, TISSUE, LUNG))

    def parts(self, p):
        """All of it, less the ends."""
        s, _ = along(p, self.top, self.trachea.way)
        ends = [along(p, a, unit(b - a))[0] > 33 for a, b, _ in self.bronchi]
        return np.where((s < 1) | ends[0] | ends[1], -1, 0), np.full(len(p), self.wall / 2)

    def radii(self):
        return []

    def ring(self, vertices, distance):
        """Amplitude of the rings in a mesh over the true one, by least squares over whole periods."""
        s, rho = along(vertices, self.top, self.trachea.way)
        first = self.trachea.first + self.period / 2
        on = (np.abs(distance) < 1.5) & (s > first) & (s < first + 3 * self.period)
        a = 2 * np.pi * (s[on] - self.trachea.first) / self.period
        fit = np.linalg.lstsq(np.stack([np.sin(a), np.cos(a), np.ones_like(a)], 1), rho[on], rcond=None)[0]
        return float(fit[0] / self.swing)


class Colon:
    """A wide tube in tissue with half-moon folds from alternate sides and three sessile polyps."""

    name, air, half, most = "colon", -1000.0, -450.0, 200
    dims, spacing = (64, 64, 136), (0.8, 0.8, 0.8)
    radius, length, reach = 18.0, 100.0, 4.0
    thick = (0.6, 0.8, 1.0, 1.2, 1.6, 2.0, 2.4)
    across = (3, 4, 6)  # voxels

    def __init__(self):
        self.way = turn([0.3, 1, 0], 4) @ [0, 0, 1.0]
        self.middle = np.array([25.2, 25.2, 54.0])
        self.start = self.middle - self.length / 2 * self.way
        x = unit(np.cross([0, 1.0, 0], self.way))
        y = np.cross(self.way, x)
        self.x, self.y = x, y
        self.folds, self.polyps = [], []
        for i, t in enumerate(self.thick):
            side = (1 if i % 2 == 0 else -1) * (turn(self.way, 9 * np.sin(1.3 * i)) @ x)
            across = np.cross(self.way, side)
            tilt = turn(side, 16 + 3 * np.cos(2.3 * i)) @ turn(across, 10 * np.sin(0.9 * i + 0.5))
            normal, up = tilt @ self.way, tilt @ side
            at = self.middle + (i - 3) * 12.0 * self.way
            self.folds.append((at + self.reach * up, normal, up, t))
        for n, s in zip(self.across, (-21.0, 3.0, 27.0)):
            r = n * self.spacing[0] / 2
            self.polyps.append((self.middle + s * self.way + (self.radius - 0.6 * r) * y, r))
        self.seed_mm = tuple(self.middle + 6 * self.way - 12 * y)

    def _tube(self, p):
        return cylinder(p, self.start, self.way, self.length, self.radius)

    def fold(self, p, i):
        return half_plate(p, *self.folds[i])

    def polyp(self, p, i):
        centre, r = self.polyps[i]
        return np.linalg.norm(p - centre, axis=-1) - r

    def value(self, p):
        bumps = [self.fold(p, i) for i in range(len(self.folds))] + [self.polyp(p, i) for i in range(len(self.polyps))]
        return np.maximum(self._tube(p), -np.minimum.reduce(bumps))

    distance = value

    def hu(self, p, value):
        return np.where(value < 0, self.air, TISSUE)

    def parts(self, p):
        """0: flat wall, away from everything else. 1: the rest; -1: the ends."""
        bumps = np.minimum.reduce([self.fold(p, i) for i in range(len(self.folds))]
                                  + [self.polyp(p, i) for i in range(len(self.polyps))])
        s, rho = along(p, self.start, self.way)
        end = (s < 3) | (s > self.length - 3)
        return np.where(end, -1, np.where((bumps > 3) & (rho > self.radius - 2), 0, 1)), np.full(len(p), 1.0)

    def radii(self):
        return []


def make(name):
    """The phantom of that name."""
    return {c.name: c for c in (Bronchi, Carina, Colon)}[name]()
