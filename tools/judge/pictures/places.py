"""Which frames of a flight are shown: by place, and the two where intima's own picture is weakest."""

from dataclasses import dataclass

import numpy as np

BEFORE_RADII = 2.5   # how far before a branching or a fold the eye stands, in radii
WIDE_SHARE = 0.4     # a branch counts if it is this wide beside the path
LONG_RADII = 3.0     # and this long, in radii of the path
FOLD_AHEAD_MM = 20.0
APART = 4            # frames nearer than this to one that is taken are not taken too


@dataclass(frozen=True)
class Flight:
    """What intima wrote: poses, the distance flown, the path's radius there, branchings along it."""

    poses: list
    fov_y_deg: float
    eye: np.ndarray
    arc_mm: np.ndarray
    radius_mm: np.ndarray
    branchings_mm: list

    @classmethod
    def of(cls, path, line):
        """From a camera path (the JSON) and the columns of the centerline with its branches."""
        poses = path["poses"]
        eye = np.array([p["position"] for p in poses])
        steps = np.linalg.norm(np.diff(eye, axis=0), axis=1)
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        points = np.stack([line["x"], line["y"], line["z"]], 1)
        radius = np.array([line["radius"][np.argmin(((points - e) ** 2).sum(1))] for e in eye])
        return cls(poses, path["fov_y_deg"], eye, arc, radius, _branchings(line, points, eye, arc, radius))

    def frame(self, arc_mm):
        """The frame nearest to a distance flown."""
        return int(np.argmin(np.abs(self.arc_mm - arc_mm)))

    def before(self, arc_mm):
        """The frame from which a place is looked at."""
        at = self.frame(arc_mm)
        return self.frame(arc_mm - BEFORE_RADII * self.radius_mm[at])


def _branchings(line, points, eye, arc, radius):
    """Where wide and long branches leave the way flown, mm flown. Their width is that of their first stretch, beyond
    the lumen they come from."""
    found = []
    for branch in np.unique(line["branch"]):
        own = line["branch"] == branch
        if line["parent"][own][0] < 0:
            continue
        start, along = points[own][0], line["abscissa"][own] - line["abscissa"][own].min()
        at = int(np.argmin(((eye - start) ** 2).sum(1)))
        first = (along > radius[at]) & (along < LONG_RADII * radius[at])
        near = np.linalg.norm(eye[at] - start) < radius[at]
        if near and along.max() > LONG_RADII * radius[at]:
            if np.median(line["radius"][own][first]) > WIDE_SHARE * radius[at]:
                found.append(float(arc[at]))
    return sorted(found)


def _folds(flight):
    """Frames before which the lumen narrows most, the sharpest first."""
    drop = []
    for i, arc in enumerate(flight.arc_mm):
        ahead = (flight.arc_mm > arc) & (flight.arc_mm < arc + FOLD_AHEAD_MM)
        drop.append(flight.radius_mm[ahead].min() / flight.radius_mm[i] if ahead.any() else 1.0)
    return [int(i) for i in np.argsort(drop, kind="stable")]


def chosen(kind, flight, look):
    """-> [(name, frame)] in the order of the flight. `look[i]` is (mean, relief) of intima's own frame i."""
    last, total = len(flight.poses) - 1, flight.arc_mm[-1]
    named = []
    if kind == "airway":
        widest = int(np.argmax(flight.radius_mm))
        forks = [b for b in flight.branchings_mm if b > flight.arc_mm[widest]][:4] or [total / 2]
        named = [("trachea", widest), ("carina", flight.before(forks[0]))]
        named += [(f"branching {i}", flight.before(b)) for i, b in enumerate(forks[1:], 2)]
        named += [("bronchus", flight.frame((forks[-1] + total) / 2)), ("thin bronchus", flight.frame(0.9 * total))]
    elif kind == "colon":
        folds = []
        for i in _folds(flight):
            if all(abs(i - f) > last // 8 for f in folds) and len(folds) < 4:
                folds.append(i)
        named = [("fold", f) for f in folds] + [("widest place", int(np.argmax(flight.radius_mm)))]
        named += [("a third of the way", flight.frame(total / 3)), ("two thirds", flight.frame(total * 2 / 3))]
    else:
        named = [("start", flight.frame(0.1 * total)), ("widest place", int(np.argmax(flight.radius_mm)))]
        named += [("branching", flight.before(b)) for b in flight.branchings_mm[:3]]
        named += [("half way", flight.frame(0.5 * total)), ("near the tip", flight.frame(0.9 * total))]
    named.append(("darkest frame", int(np.argmin([mean for mean, _ in look]))))
    named.append(("flattest frame", int(np.argmin([relief for _, relief in look]))))
    kept = []
    for name, frame in named:
        if all(abs(frame - other) >= APART for _, other in kept):
            kept.append((name, frame))
    return sorted(kept, key=lambda place: place[1])
