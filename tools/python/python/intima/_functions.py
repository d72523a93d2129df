"""One result of one volume, each in a session of its own."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _intima
from ._errors import ArgumentError
from ._results import Centerline, Flight, Mesh, Segmentation
from ._session import Session
from ._settings import CenterlineSettings, DeviceSettings, LumenSettings, Settings, WallSettings
from ._volume import ImageLike, PathLike, Volume, volume_of


def distance(
    mask: NDArray[Any] | Volume,
    spacing: Sequence[float] | None = None,
    *,
    labels: Sequence[int] | None = None,
    **settings: Unpack[DeviceSettings],
) -> NDArray[np.float32]:
    """Compute the exact Euclidean distance to the nearest voxel outside a mask.

    What is beyond the array is outside, as with ``edt(..., black_border=True)``. Time and memory
    beside input and result follow the mask, not the array.

    Parameters
    ----------
    mask
        Array of (z, y, x); what is not 0 is inside.
    spacing
        Distance of voxel centres along the array's axes, mm; 1 where not given.
    labels
        Labels that are inside, instead of all but 0.
    **settings
        `DeviceSettings`: device, threads, max_memory.

    Returns
    -------
    numpy.ndarray
        Distance between voxel centres, mm, 0 outside; float32, of the shape of the mask.

    Examples
    --------
    >>> mask = np.zeros((5, 5, 5), bool)
    >>> mask[1:4, 1:4, 1:4] = True
    >>> intima.distance(mask, spacing=(2, 1, 1))[2, 2]
    array([0., 1., 2., 1., 0.], dtype=float32)
    """
    volume = volume_of(mask, spacing, None, None)
    array = np.asarray(volume.array)
    if array.ndim == 3 and not (array.any() if labels is None else np.isin(array, list(labels)).any()):
        return np.zeros(array.shape, np.float32)
    session = Session(mask=volume, labels=labels, all_components=True, fill=False, wall="exact", **settings)
    return session.distance()


def segment(
    image: ImageLike,
    spacing: Sequence[float] | None = None,
    *,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    mask: ImageLike | None = None,
    **settings: Unpack[LumenSettings],
) -> Segmentation:
    """Choose the lumen of a hollow organ.

    Parameters
    ----------
    image
        Grey values or a label map: an array of (z, y, x), a `Volume` or a path.
    spacing, origin, direction
        Geometry of an array, as in `Volume`.
    mask
        A label map on the image; its labels are the lumen.
    **settings
        `LumenSettings`, of which one chooses: ``organ``, ``threshold`` (with ``seed`` or
        ``seed_mm``), or ``labels``. Of an image that is a label map, all labels are taken.

    Examples
    --------
    >>> airway = intima.segment(ct, spacing=(1.25, 0.7, 0.7), organ="airway")  # doctest: +SKIP
    >>> airway.organ["confidence"], airway.mask.sum()                          # doctest: +SKIP
    """
    return _session(image, mask, spacing, origin, direction, settings).lumen()


def surface(
    mask: ImageLike,
    spacing: Sequence[float] | None = None,
    *,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    **settings: Unpack[WallSettings],
) -> Mesh:
    """Extract the closed surface of a mask, with smooth normals.

    Vertices slide within half a voxel to where the wall agrees with its normals (``wall="relaxed"``);
    every voxel's centre stays on its side. ``wall="exact"`` leaves them half way between voxels.

    Parameters
    ----------
    mask
        Label map: an array of (z, y, x), a `Volume` or a path. What is not 0 is inside; of several
        components the largest is taken, cavities are filled (see ``all_components``, ``fill``).
    spacing, origin, direction
        Geometry of an array, as in `Volume`.
    **settings
        `WallSettings`. Grey values instead of a mask need ``organ`` or ``threshold``: see `wall`.
    """
    return _session_of_mask(mask, spacing, origin, direction, settings).wall()


def wall(
    image: ImageLike,
    spacing: Sequence[float] | None = None,
    *,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    mask: ImageLike | None = None,
    **settings: Unpack[WallSettings],
) -> Mesh:
    """Draw the wall of a lumen where the profile of the grey values puts it.

    Parameters
    ----------
    image
        Grey values: an array of (z, y, x), a `Volume` or a path.
    spacing, origin, direction
        Geometry of an array, as in `Volume`.
    mask
        A label map on the image; then ``wall="field"`` draws the wall about it by grey values.
    **settings
        `WallSettings`, of which one chooses the lumen: ``organ``, ``threshold`` or ``labels``.

    Returns
    -------
    Mesh
        With ``evidence`` at each vertex where the wall follows grey values.
    """
    session = _session(image, mask, spacing, origin, direction, settings)
    mesh = session.wall()
    evidence = session.evidence()
    if evidence is None or len(evidence) != len(mesh.vertices):
        return mesh
    return dataclasses.replace(mesh, evidence=evidence)


def centerline(
    mask: ImageLike,
    spacing: Sequence[float] | None = None,
    *,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    **settings: Unpack[CenterlineSettings],
) -> Centerline:
    """Find the path through a lumen, or all its branches, centred and proven inside.

    Parameters
    ----------
    mask
        Label map: an array of (z, y, x), a `Volume` or a path. What is not 0 is inside; of several
        components the largest is taken, cavities are filled.
    spacing, origin, direction
        Geometry of an array, as in `Volume`.
    **settings
        `CenterlineSettings`. Grey values instead of a mask need ``organ`` or ``threshold``.

    Examples
    --------
    >>> mask = np.zeros((9, 9, 40), bool)
    >>> mask[2:7, 2:7, 2:38] = True
    >>> line = intima.centerline(mask)
    >>> len(line.branches), bool((line.radius > 0).all())
    (1, True)
    """
    return _session_of_mask(mask, spacing, origin, direction, settings).centerline()


def simplify(
    mesh: Mesh | tuple[ArrayLike, ArrayLike],
    faces: int,
    *,
    metric: Literal["qem", "normal-qem", "paper"] = "normal-qem",
    max_error: float | None = None,
    keep_vertices: bool = False,
    threads: int | None = None,
) -> Mesh:
    """Simplify a mesh by half-edge collapse.

    Parameters
    ----------
    mesh
        A `Mesh`, or vertices of (n, 3) and faces of (m, 3). Where edges have more than two faces, it
        is made a manifold first.
    faces
        Faces wanted; one less where the last collapse removes two.
    metric
        Cost of a collapse.
    max_error
        Stop before a vertex is farther than this from the planes it stands for, mm.
    keep_vertices
        Leave the vertices that stay where they were.
    threads
        Threads; all cores where None.
    """
    if isinstance(mesh, Mesh):
        vertices, triangles, normals = mesh.vertices, mesh.faces, mesh.normals
    else:
        vertices, triangles = (np.asarray(part) for part in mesh)
        normals = None
    indices = np.asarray(triangles)
    if indices.size and not (indices.dtype.kind in "iu" and 0 <= indices.min() and indices.max() < len(vertices)):
        raise ArgumentError(f"faces: numbers of {len(vertices)} vertices, from 0")
    found = _intima.simplify(
        np.ascontiguousarray(vertices, np.float32),
        np.ascontiguousarray(indices, np.uint32),
        None if normals is None else np.ascontiguousarray(normals, np.float32),
        faces,
        metric,
        max_error,
        keep_vertices,
        threads,
    )
    return Mesh(found["vertices"], found["faces"], found["normals"])


def fly(
    image: ImageLike | None,
    out: PathLike,
    spacing: Sequence[float] | None = None,
    *,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    mask: ImageLike | None = None,
    **settings: Unpack[Settings],
) -> Flight:
    """Fly through a hollow organ: a video, or a folder of frames.

    Parameters
    ----------
    image
        Grey values or a label map: an array of (z, y, x), a `Volume` or a path.
    out
        Video, .mp4 or .gif (needs ffmpeg), or else a folder for PNG files.
    spacing, origin, direction
        Geometry of an array, as in `Volume`.
    mask
        A label map on the image; its labels are the lumen.
    **settings
        `Settings`, of which one chooses the lumen: ``organ``, ``threshold`` or ``labels``.

    Returns
    -------
    Flight
        The poses that were flown.
    """
    session = _session(image, mask, spacing, origin, direction, settings)
    if os.path.splitext(os.fspath(out))[1].lower() in (".mp4", ".gif"):
        session.video(out)
    else:
        session.record(out)
    return session.flight()


def _session(
    image: ImageLike | None,
    mask: ImageLike | None,
    spacing: Sequence[float] | None,
    origin: Sequence[float] | None,
    direction: ArrayLike | None,
    settings: Any,
) -> Session:
    return Session(image, mask, spacing=spacing, origin=origin, direction=direction, **settings)


def _session_of_mask(
    mask: ImageLike,
    spacing: Sequence[float] | None,
    origin: Sequence[float] | None,
    direction: ArrayLike | None,
    settings: Any,
) -> Session:
    """A session of a label map or, where the settings choose from them, of grey values."""
    is_grey = settings.get("organ") is not None or settings.get("threshold") is not None
    image, mask_ = (mask, None) if is_grey else (None, mask)
    return _session(image, mask_, spacing, origin, direction, settings)
