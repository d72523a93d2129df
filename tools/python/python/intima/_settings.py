"""Settings: the names of the command line, with underscores. `intima COMMAND --help` says more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypedDict

from ._volume import PathLike


class DeviceSettings(TypedDict, total=False):
    """Where work runs."""

    device: str
    """auto, cpu, gpu, gpu:N or gpu:NAME; auto takes the first real GPU, else the CPU."""
    threads: int | None
    """Threads of the CPU; all cores where None."""
    max_memory: int | None
    """Refuse what would take more, MB."""


class LumenSettings(DeviceSettings, total=False):
    """How the lumen is chosen."""

    organ: Literal["airway", "colon", "vessel"] | None
    """Find this organ: threshold, seed and leak control are chosen."""
    threshold: tuple[float | None, float | None] | None
    """Inclusive range in HU or real units; None is an open end."""
    labels: Sequence[int] | None
    """Labels of a label map that are the lumen; all but 0 where None."""
    seed: tuple[int, int, int] | None
    """Keep the component of this voxel, an index (z, y, x) of the array."""
    seed_mm: Sequence[float] | None
    """Keep the component of the voxel at this point, LPS mm (x, y, z)."""
    tagged: bool
    """Take a colon's tagged fluid too."""
    thin_bronchi: bool
    """Take an airway's thin bronchi too; on unless False."""
    all_components: bool
    """Keep every component."""
    fill: bool
    """Fill closed cavities; on unless False."""
    leak_control: bool
    """Draw the threshold in to just below the first leak (needs a seed)."""
    wall: Literal["auto", "field", "relaxed", "exact"]
    """How the wall is placed."""
    mode: Literal["default", "paper"]
    """Default methods, or those of the paper."""
    series: str | int | None
    """DICOM series of a path, by UID or number."""
    volume: int | None
    """Which of several volumes of a path at the same places, from 0: of a time, an echo, a phase."""
    segment: Sequence[str] | None
    """Names of the segments of a segmentation's path."""
    fill_gaps: bool
    """Interpolate where slices of a path are uneven or missing."""
    allow_burned_in: bool
    """Read pixels of a path that may show who the patient is."""


class WallSettings(LumenSettings, total=False):
    """How the wall is made."""

    smooth: int | None
    """Steps of the paper's normal smoothing; each vertex as its surroundings allow where None."""
    lambda_: float | None
    """Share of the neighbours' mean in a step."""
    weights: Literal["uniform", "inverse-distance"] | None
    """Weights of the neighbours in a step."""
    surface_from: Literal["grey", "mask"]
    """Vertices of an exact wall: where grey values cross the threshold, or half way."""
    open_ends: bool
    """Leave out caps at the edge of the volume."""
    facing: Literal["in", "out"]
    """Side to which faces and normals look."""
    decimate: int | None
    """Faces of `Session.base`."""


class CenterlineSettings(LumenSettings, total=False):
    """How the centerline is made."""

    tree: bool
    """All branches instead of one path."""
    loops: Literal["keep", "cut"]
    """Treatment of loops in a tree."""
    from_: Sequence[float] | None
    """Start here, LPS mm (x, y, z)."""
    to: Sequence[float] | None
    """End here, LPS mm (x, y, z)."""


class Settings(WallSettings, CenterlineSettings, total=False):
    """All settings of a session."""

    frames: int | None
    """Number of frames, equal steps in flight time; 120 where neither it nor speed is given."""
    speed: float | None
    """Cruising speed, mm/s."""
    fps: float
    """Frames a second of a video."""
    size: tuple[int, int]
    """Columns and rows of a frame."""
    view: Literal["inside", "translucent", "overview", "split", "cube", "panorama"]
    """View that a frame shows."""
    local_contrast: float
    """Share by which fine relief is raised in views from inside, 0 to 2 (default 0)."""
    behind: float | None
    """Depth of the tissue behind the wall that a frame shows, mm; the translucent view alone shows some."""
    fov: float
    """Vertical field of view, degrees."""
    msaa: Literal["auto", "edges", 1, 4]
    """How edges are kept from looking like stairs: samples a pixel, or one and its edges smoothed."""
    reverse: bool
    """Fly from the end to the start."""
    route: str
    """trunk, all, or leaf:N with the number of a branch."""
    path: PathLike | None
    """Fly this camera path (intima.path/1)."""
    lod: Literal["auto", "vds", "culled", "off"]
    """Level of detail."""
    scheme: Literal["1-to-4", "butterfly", "sqrt3", "4-8"]
    """Subdivision scheme of vds."""
    pixel_error: float
    """Pixels that what is drawn may be away from the full mesh."""
