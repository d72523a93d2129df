"""Arrays with their place in the patient."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _intima
from ._errors import ArgumentError

PathLike: TypeAlias = "str | os.PathLike[str]"
"""A file or folder."""

Vector: TypeAlias = "tuple[float, float, float]"
"""Three lengths, or a point."""

DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")

_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclasses.dataclass(frozen=True, eq=False)
class Volume:
    """An array of voxels and where they lie in the patient.

    Every function takes one in the place of an array. The array is borrowed, never copied; do not
    write to it while a function runs or a `Session` has it.

    Attributes
    ----------
    array
        Samples, axes (z, y, x), C-contiguous, as SimpleITK's ``GetArrayViewFromImage`` gives them.
    spacing
        Distance of voxel centres along the array's axes, mm: (z, y, x), as in scikit-image.
    origin
        Centre of voxel (0, 0, 0), LPS mm: (x, y, z).
    direction
        3 x 3; its columns are the directions of the x, y and z axis in LPS.
    rescale
        Slope and intercept from stored to real values (HU of CT).
    """

    array: NDArray[Any]
    spacing: Vector = (1.0, 1.0, 1.0)
    origin: Vector = (0.0, 0.0, 0.0)
    direction: ArrayLike = _IDENTITY
    rescale: tuple[float, float] = (1.0, 0.0)

    @classmethod
    def read(
        cls,
        path: PathLike,
        *,
        series: str | int | None = None,
        volume: int | None = None,
        segment: Sequence[str] | None = None,
        fill_gaps: bool = False,
        allow_burned_in: bool = False,
        max_memory: int | None = None,
    ) -> Volume:
        """Read a DICOM folder or file, NIfTI, NRRD, MetaImage or a closed mesh.

        Parameters
        ----------
        path
            File or folder.
        series
            DICOM series, by UID or by its number in the listing.
        volume
            Which of several volumes at the same places, from 0: of a time, an echo, a phase.
        segment
            Names of the segments of a segmentation that are read, together as 1.
        fill_gaps
            Interpolate where slices are uneven or missing.
        allow_burned_in
            Read pixels that may show who the patient is.
        max_memory
            Refuse what takes more, MB.
        """
        settings = {
            "series": None if series is None else str(series),
            "volume": volume,
            "segment": None if segment is None else list(segment),
            "fill_gaps": fill_gaps,
            "allow_burned_in": allow_burned_in,
            "max_memory": max_memory,
        }
        found = _intima.read(os.fspath(path), settings)
        del found["shape"]
        return cls(**found)

    @classmethod
    def from_sitk(cls, image: Any) -> Volume:
        """The voxels and geometry of a ``SimpleITK.Image``, not copied. Keep the image."""
        import SimpleITK

        if image.GetDimension() != 3:
            raise ArgumentError(f"an image of {image.GetDimension()} dimensions; 3 are needed")
        x, y, z = image.GetSpacing()
        direction = np.reshape(image.GetDirection(), (3, 3))
        array = SimpleITK.GetArrayViewFromImage(image)
        return cls(array, (z, y, x), tuple(image.GetOrigin()), direction)

    @classmethod
    def from_nibabel(cls, image: Any) -> Volume:
        """The voxels and geometry of a nibabel image. RAS becomes LPS, (x, y, z) becomes (z, y, x)."""
        data, rescale = image.dataobj, (1.0, 0.0)
        if hasattr(data, "get_unscaled"):
            rescale = (float(data.slope), float(data.inter))
            data = data.get_unscaled()
        array = np.asarray(data).T
        if array.ndim != 3:
            raise ArgumentError(f"an image of {array.ndim} dimensions; 3 are needed")
        lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.asarray(image.affine, dtype=float)
        lengths = np.linalg.norm(lps[:3, :3], axis=0)
        x, y, z = (float(n) for n in lengths)
        origin = (float(lps[0, 3]), float(lps[1, 3]), float(lps[2, 3]))
        return cls(array, (z, y, x), origin, lps[:3, :3] / lengths, rescale)

    @property
    def shape(self) -> tuple[int, ...]:
        """Voxels along z, y and x."""
        return self.array.shape

    def with_array(self, array: NDArray[Any]) -> Volume:
        """Another array on the same grid, whose stored values are its real ones."""
        return dataclasses.replace(self, array=array, rescale=(1.0, 0.0))

    def real(self) -> NDArray[np.float32]:
        """Real values (HU of CT), a new array."""
        slope, intercept = self.rescale
        out: NDArray[np.float32] = self.array.astype(np.float32)
        out *= np.float32(slope)
        out += np.float32(intercept)
        return out

    def to_world(self, index: ArrayLike) -> NDArray[np.float64]:
        """Points in LPS mm (x, y, z) of indices (z, y, x), one or many."""
        at = np.asarray(index, dtype=float) * np.asarray(self.spacing)
        local = at[..., ::-1] @ np.asarray(self.direction, dtype=float).T
        world: NDArray[np.float64] = local + np.asarray(self.origin)
        return world

    def to_index(self, point: ArrayLike) -> NDArray[np.float64]:
        """Indices (z, y, x), not rounded, of points in LPS mm (x, y, z), one or many."""
        local = np.asarray(point, dtype=float) - np.asarray(self.origin)
        at = local @ np.linalg.inv(np.asarray(self.direction, dtype=float)).T
        index: NDArray[np.float64] = at[..., ::-1] / np.asarray(self.spacing)
        return index

    def __repr__(self) -> str:
        """Shape, type and geometry."""
        spacing = ", ".join(f"{s:.4g}" for s in self.spacing)
        return f"Volume({'x'.join(map(str, self.shape))} {self.array.dtype}, spacing=({spacing}) mm)"


ImageLike: TypeAlias = "NDArray[Any] | Volume | PathLike"
"""A volume: an array (with `spacing`, `origin`, `direction`), a `Volume`, or a path."""


def volume_of(
    image: NDArray[Any] | Volume,
    spacing: Sequence[float] | None,
    origin: Sequence[float] | None,
    direction: ArrayLike | None,
) -> Volume:
    """A volume of an array and its geometry; a `Volume` has its own."""
    if isinstance(image, Volume):
        if not (spacing is None and origin is None and direction is None):
            raise ArgumentError("a Volume has its own spacing, origin and direction")
        return image
    array = np.asarray(image)
    return Volume(
        array,
        _triple("spacing", spacing, (1.0, 1.0, 1.0)),
        _triple("origin", origin, (0.0, 0.0, 0.0)),
        _IDENTITY if direction is None else direction,
    )


def _triple(name: str, values: Sequence[float] | None, default: Vector) -> Vector:
    if values is None:
        return default
    if np.ndim(values) != 1 or len(values) != 3:
        raise ArgumentError(f"{name}={values!r}: three numbers")
    a, b, c = (float(v) for v in values)
    return (a, b, c)


def borrowed(volume: Volume) -> dict[str, Any]:
    """The bytes of a volume's array, and its geometry, as the native module takes them."""
    array = np.asarray(volume.array)
    if array.ndim != 3:
        raise ArgumentError(f"an array of {array.ndim} axes {array.shape}; three are needed: z, y, x")
    if array.size == 0:
        raise ArgumentError(f"an array of no voxels: {array.shape}")
    if array.dtype == np.bool_:
        array = array.view(np.uint8)
    if not array.dtype.isnative:
        raise ArgumentError(
            f"samples of type {array.dtype.str}, in the byte order of another machine: "
            "pass array.astype(array.dtype.newbyteorder('='))"
        )
    if array.dtype.name not in DTYPES:
        raise ArgumentError(f"samples of type {array.dtype}: bool, {', '.join(DTYPES)}")
    if not array.flags.c_contiguous:
        raise ArgumentError(
            f"the array is not C-contiguous (shape {array.shape}, strides {array.strides}): of an "
            "array of x, y, z in Fortran order, as nibabel's, pass array.T; of a view, "
            "numpy.ascontiguousarray(array), which copies"
        )
    direction = np.asarray(volume.direction, dtype=float)
    if direction.size != 9:
        raise ArgumentError(f"direction of shape {direction.shape}; 3 x 3 is needed")
    return {
        "buffer": array.reshape(-1).view(np.uint8),
        "dtype": array.dtype.name,
        "shape": array.shape,
        "spacing": _triple("spacing", volume.spacing, (1.0, 1.0, 1.0)),
        "origin": _triple("origin", volume.origin, (0.0, 0.0, 0.0)),
        "direction": direction.reshape(3, 3).tolist(),
        "rescale": volume.rescale,
    }
