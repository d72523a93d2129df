"""Results: arrays with names. Points are LPS mm (x, y, z), volumes (z, y, x)."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._volume import Vector, Volume

Points = NDArray[np.float64]
Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Segmentation:
    """A lumen.

    Attributes
    ----------
    classes
        0 outside, 1 inside, 2 inside and beside a voxel outside: an array of (z, y, x).
    spacing, origin, direction
        The grid, as in `Volume`.
    report
        Counts, components left out, how the wall is placed and, where an organ was looked for, what
        it was found by, as in ``report.json``.
    notes
        What a reader of the result should know, a sentence each.
    """

    classes: NDArray[np.uint8]
    spacing: Vector
    origin: Vector
    direction: NDArray[np.float64]
    report: dict[str, Any]
    notes: list[str]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Whether a voxel is inside, a new array."""
        inside: NDArray[np.bool_] = self.classes != 0
        return inside

    @property
    def volume(self) -> Volume:
        """The classes with their grid."""
        return Volume(self.classes, self.spacing, self.origin, self.direction)

    @property
    def volume_ml(self) -> float:
        """Volume of the lumen, ml."""
        return float(self.report["lumen"]["volume_ml"])

    @property
    def organ(self) -> dict[str, Any] | None:
        """Name, threshold, seeds, confidence and reasons of the organ that was looked for."""
        organ: dict[str, Any] | None = self.report["organ"]
        return organ

    def __repr__(self) -> str:
        """Organ, volume and shape."""
        organ = self.organ
        what = f"{organ['name']}, confidence {organ['confidence']:.2f}, " if organ else ""
        shape = "x".join(map(str, self.classes.shape))
        return f"Segmentation({what}{self.volume_ml:.1f} ml in {shape} voxels)"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """A triangle mesh.

    Attributes
    ----------
    vertices
        Points, (n, 3), LPS mm.
    faces
        Vertices of each triangle, (m, 3).
    normals
        Unit vectors, (n, 3). They and the faces look out of the lumen unless ``facing="in"``.
    caps
        Whether a face closes the lumen at the edge of the volume, (m,).
    evidence
        Why the wall is where it is, a code a vertex: 0 the profile of the grey values, 1 a sheet
        thinner than the blur, 2 the limit of growth. None where it does not follow grey values.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32] | None = None
    caps: NDArray[np.bool_] | None = None
    evidence: NDArray[np.uint8] | None = None

    @property
    def area(self) -> float:
        """Area, mm2."""
        return float(0.5 * np.linalg.norm(self._crosses(), axis=1).sum())

    @property
    def enclosed(self) -> float:
        """Volume inside a closed mesh, mm3; negative where the faces look inwards."""
        corners = self.vertices.astype(float)[self.faces[:, 0]]
        return float((corners * self._crosses()).sum() / 6.0)

    def _crosses(self) -> Points:
        a, b, c = np.moveaxis(self.vertices.astype(float)[self.faces], 1, 0)
        crosses: Points = np.cross(b - a, c - a)
        return crosses

    def __repr__(self) -> str:
        """Numbers of vertices and faces."""
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces)"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Branch:
    """A branch of a centerline. Its ends repeat the points that they are attached to.

    Attributes
    ----------
    points
        From the start to the end, (n, 3), LPS mm.
    radius
        Distance to the wall (maximum inscribed sphere), mm.
    abscissa
        Length of the way from the root, mm.
    start, end
        Branch and point that it leaves, and that it ends on where it closes a loop.
    """

    points: Points
    radius: Floats
    abscissa: Floats
    start: tuple[int, int] | None
    end: tuple[int, int] | None

    @property
    def parent(self) -> int | None:
        """The branch that this one leaves."""
        return None if self.start is None else self.start[0]

    @property
    def length(self) -> float:
        """Length, mm."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def __repr__(self) -> str:
        """Points, length and parent."""
        return f"Branch({len(self.points)} points, {self.length:.1f} mm, parent={self.parent})"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Centerline:
    """A path or tree inside a lumen.

    Attributes
    ----------
    points, radius, abscissa
        Those of all branches, one branch after the other.
    branches
        The branches, as views of these arrays; parents come before children.
    report
        Length, clearance, loops and visibility, as in ``report.json``.
    """

    points: Points
    radius: Floats
    abscissa: Floats
    branches: list[Branch]
    report: dict[str, Any]

    @property
    def length(self) -> float:
        """Length of all branches, mm."""
        return sum(b.length for b in self.branches)

    def path_to(self, branch: int) -> Points:
        """The way from the root to the end of a branch."""
        b = self.branches[branch]
        if b.start is None:
            return b.points
        parent, point = b.start
        before = self.path_to(parent)
        kept = len(before) - (len(self.branches[parent].points) - 1 - point)
        return np.concatenate([before[:kept], b.points[1:]])

    def __repr__(self) -> str:
        """Points, branches and length."""
        n = len(self.branches)
        return f"Centerline({len(self.points)} points, {n} branch{'es'[: 2 * (n != 1)]}, {self.length:.1f} mm)"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """Poses of a camera along a centerline.

    Attributes
    ----------
    positions
        Places of the eye, (n, 3), LPS mm.
    rotations
        From camera to world, unit quaternions x, y, z, w, (n, 4). The camera looks along -z, y up.
    seconds
        Time since the first pose.
    near_mm
        Distance of the near plane.
    clearance_mm
        Proven distance to the wall.
    fov
        Vertical field of view, degrees.
    aspect
        Width over height of a frame.
    """

    positions: NDArray[np.float32]
    rotations: NDArray[np.float32]
    seconds: Floats
    near_mm: NDArray[np.float32]
    clearance_mm: Floats
    fov: float
    aspect: float

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.positions)

    def __repr__(self) -> str:
        """Number of poses and duration."""
        return f"Flight({len(self)} poses, {self.seconds[-1]:.1f} s)"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Coverage:
    """What a flight sees of the wall.

    Attributes
    ----------
    one_way_fraction, both_ways_fraction
        Share of the wall's area seen by the flight, and by it and the one back.
    area_mm2
        Area of the wall without caps.
    seen_one_way, seen_both_ways
        Whether a face was seen, one flag a face of `Session.wall` with its caps.
    """

    one_way_fraction: float
    both_ways_fraction: float
    area_mm2: float
    seen_one_way: NDArray[np.bool_]
    seen_both_ways: NDArray[np.bool_]

    def __repr__(self) -> str:
        """Shares seen."""
        one, both = 100 * self.one_way_fraction, 100 * self.both_ways_fraction
        return f"Coverage({one:.1f} % one way, {both:.1f} % both ways)"
