"""Sessions: a volume, settings, and products that are computed when they are asked for."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _intima
from ._results import Branch, Centerline, Coverage, Flight, Mesh, Segmentation
from ._settings import Settings
from ._volume import ImageLike, PathLike, borrowed, volume_of


class Progress(NamedTuple):
    """How far the present work is."""

    stage: str
    """Stage that began last; empty while nothing runs."""
    share: float
    """Share of the work done, 0 to 1."""
    seconds: float
    """Time since the work began."""


class Session:
    """A volume with settings, and everything that is made of it.

    Each method that has a product's name computes what the product needs, once, and returns it;
    other settings (`apply`) make again only what they change. Work runs without the interpreter's
    lock and stops at Ctrl-C.

    Parameters
    ----------
    image
        Grey values or a label map: an array, a `Volume`, or the path of a file or DICOM folder.
    mask
        A label map: the lumen. Then `image`, if given, is what the mask was drawn on.
    spacing, origin, direction
        Geometry of arrays, as in `Volume`; a path or `Volume` has its own.
    **settings
        As the command line's, with underscores: see `Settings`.

    Notes
    -----
    Arrays are borrowed, not copied: do not write to them while the session lives. A session does not
    survive a fork (its threads do not); it says so. Use the ``spawn`` start method, or make a session
    in each process.

    Examples
    --------
    >>> session = intima.Session("ct.nii.gz", organ="colon")      # doctest: +SKIP
    >>> session.centerline()                                       # doctest: +SKIP
    Centerline(812 points, 1 branch, 1623.4 mm)
    """

    def __init__(
        self,
        image: ImageLike | None = None,
        mask: ImageLike | None = None,
        *,
        spacing: Sequence[float] | None = None,
        origin: Sequence[float] | None = None,
        direction: ArrayLike | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        geometry = (spacing, origin, direction)
        self._settings: dict[str, Any] = dict(settings)
        self._native = _intima.Session(
            _input(image, geometry), _input(mask, geometry), _native(self._settings)
        )

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that were given, a copy."""
        return dict(self._settings)

    def apply(self, **settings: Unpack[Settings]) -> None:
        """Change settings; products that they do not change stay."""
        changed = {**self._settings, **settings}
        self._native.apply(_native(changed))
        self._settings = changed

    def lumen(self) -> Segmentation:
        """The lumen."""
        found = self._native.lumen()
        del found["shape"]
        return Segmentation(**{**found, "report": json.loads(found["report"])})

    def distance(self) -> NDArray[np.float32]:
        """Distance of each voxel's centre to the nearest one outside the lumen, mm, exact; 0 outside."""
        return self._native.distance()

    def wall(self) -> Mesh:
        """The wall, with smoothed normals."""
        return Mesh(**self._native.wall(base=False))

    def evidence(self) -> NDArray[np.uint8] | None:
        """Why each vertex of the wall, caps included, is where it is; see `Mesh`."""
        return self._native.evidence()

    def base(self) -> Mesh:
        """The wall with few faces: `decimate` of them, or a twentieth."""
        return Mesh(**self._native.wall(base=True))

    def centerline(self) -> Centerline:
        """The path, or the tree with ``tree=True``."""
        return _centerline(self._native.centerline())

    def graph(self) -> dict[str, Any]:
        """All branches with the loops that they close: nodes and edges (intima.graph/1)."""
        graph: dict[str, Any] = json.loads(self._native.graph())
        return graph

    def flight(self) -> Flight:
        """The poses of the flight."""
        return Flight(**self._native.flight())

    def coverage(self) -> Coverage:
        """What the flight sees of the wall."""
        return Coverage(**self._native.coverage())

    def frames(self) -> _intima.Frames:
        """The frames of the flight, an iterator with a length, each drawn when it is asked for.

        A frame is an array of (height, width, 3), 8 bits each of red, green and blue. Drawing needs Vulkan; software Vulkan will do.
        """
        return self._native.frames()

    def video(self, out: PathLike) -> int:
        """Draw all frames into a video, .mp4 or .gif (needs ffmpeg); return their number."""
        return self._native.video(os.fspath(out), self._fps())

    def record(self, out: PathLike) -> int:
        """Draw all frames into a folder of PNG files; return their number."""
        return self._native.record(os.fspath(out))

    def run(self, out: PathLike, *, video: PathLike | None = None) -> dict[str, Any]:
        """Write everything into a folder, as ``intima run`` does; return the report."""
        to = None if video is None else os.fspath(video)
        report: dict[str, Any] = json.loads(self._native.run_to_folder(os.fspath(out), to, self._fps()))
        return report

    def report(self) -> dict[str, Any]:
        """The report of all products so far, as in ``report.json``."""
        report: dict[str, Any] = json.loads(self._native.report())
        return report

    def warnings(self) -> list[str]:
        """What a user should know of the products so far, a sentence each."""
        return self._native.warnings()

    def device(self) -> str:
        """Name of the device that computes."""
        return self._native.device()

    def geometry(self) -> dict[str, Any]:
        """Shape, spacing, origin and direction of all products, as in `Volume`."""
        return self._native.geometry()

    def progress(self) -> Progress:
        """How far the present work is; for another thread than the one that waits for it."""
        return Progress(*self._native.progress())

    def cancel(self) -> None:
        """Stop the work of all threads in this session: it raises `Cancelled`, until `resume`."""
        self._native.cancel()

    def resume(self) -> None:
        """Let the session go on after `cancel`."""
        self._native.resume()

    def _fps(self) -> float:
        return float(self._settings.get("fps") or 25.0)


def _native(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings in the types that the native module takes."""
    out = dict(settings)
    for name in ("threshold", "size"):
        if isinstance(out.get(name), (list, np.ndarray)):
            out[name] = tuple(out[name])
    if out.get("series") is not None:
        out["series"] = str(out["series"])
    if out.get("labels") is not None:
        out["labels"] = [int(label) for label in out["labels"]]
    if out.get("path") is not None:
        out["path"] = os.fspath(out["path"])
    return out


def _input(
    image: ImageLike | None,
    geometry: tuple[Sequence[float] | None, Sequence[float] | None, ArrayLike | None],
) -> str | dict[str, Any] | None:
    if image is None:
        return None
    if isinstance(image, (str, os.PathLike)):
        return os.fspath(image)
    return borrowed(volume_of(image, *geometry))


def _centerline(found: dict[str, Any]) -> Centerline:
    points, radius, abscissa = found["points"], found["radius"], found["abscissa"]
    branches, first = [], 0
    for count, start, end in zip(found["counts"], found["starts"], found["ends"], strict=True):
        part = slice(first, first + count)
        branches.append(Branch(points[part], radius[part], abscissa[part], start, end))
        first += count
    return Centerline(points, radius, abscissa, branches, json.loads(found["report"]))
