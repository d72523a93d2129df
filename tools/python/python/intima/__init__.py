"""intima: virtual endoscopy on NumPy arrays.

From a CT or MR volume, or a label map, to the lumen of a hollow organ, its exact distance field, its
wall, its centerline and a flight through it. Volumes are arrays of (z, y, x), C-contiguous, with a
`spacing` of (z, y, x) in mm; points are LPS mm (x, y, z). See `Volume`.

Arrays are borrowed, not copied; work runs without the interpreter's lock and stops at Ctrl-C.

Research and education only. Not a medical device. Not for diagnosis.
"""

from ._errors import ArgumentError, Cancelled, DeviceError, Error, InputError, MemoryLimitError
from ._functions import centerline, distance, fly, segment, simplify, surface, wall
from ._intima import __version__
from ._results import Branch, Centerline, Coverage, Flight, Mesh, Segmentation
from ._session import Progress, Session
from ._settings import CenterlineSettings, DeviceSettings, LumenSettings, Settings, WallSettings
from ._volume import Volume

__all__ = [
    "ArgumentError",
    "Branch",
    "Cancelled",
    "Centerline",
    "CenterlineSettings",
    "Coverage",
    "DeviceError",
    "DeviceSettings",
    "Error",
    "Flight",
    "InputError",
    "LumenSettings",
    "MemoryLimitError",
    "Mesh",
    "Progress",
    "Segmentation",
    "Session",
    "Settings",
    "Volume",
    "WallSettings",
    "__version__",
    "centerline",
    "distance",
    "fly",
    "segment",
    "simplify",
    "surface",
    "wall",
]
