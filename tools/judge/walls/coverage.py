"""Rows of flights: which share of the wall intima says they show, beside a ray from each eye to each boundary voxel."""

import json

import numpy as np
import SimpleITK as sitk

from program import Failed

CASES = {  # title: file, arguments
    "aorta MRA, threshold 1100": ("aorta_mra.mha", ("--threshold", "1100:", "--seed", "75,133,16")),
    "airway 4, label map": ("airway_label_lidc4.nii.gz", ("--mask",)),
    "airway 4, every branch": ("airway_label_lidc4.nii.gz", ("--route", "all", "--mask")),
}
FRAMES = 120
SIZE = (640, 360)  # its ratio is the picture's width over height; what is seen does not depend on its pixels
STEP = 0.25  # between the samples of a ray, voxels
SHORT = 1.0  # a ray ends this far before the voxel's centre, voxels


def boundary(lumen):
    """Voxels of a lumen with an external 6-neighbour in the volume -> k, j, i. Beyond the volume there is no wall."""
    beside = np.zeros_like(lumen)
    for axis in range(3):
        a, b = (np.moveaxis(m, axis, 0) for m in (lumen, beside))
        b[1:] |= ~a[:-1]
        b[:-1] |= ~a[1:]
    return np.argwhere(lumen & beside)


def turned(quaternion):
    """x, y, z, w -> rotation matrix."""
    x, y, z, w = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def in_lumen(lumen, eye, ends):
    """Whether the segments from an eye to places short of ends stay in the lumen; all in voxels, x fastest."""
    way = ends - eye
    length = np.linalg.norm(way, axis=1)
    reach = np.maximum(length - SHORT, 0.0)
    unit = way / np.maximum(length, 1e-9)[:, None]
    free, walking, block = np.ones(len(ends), bool), np.arange(len(ends)), 32
    start, top = 0, np.array(lumen.shape)[::-1] - 1
    while len(walking):
        at = np.minimum(STEP * np.arange(start, start + block), reach[walking, None])
        place = np.rint(eye + at[:, :, None] * unit[walking, None]).astype(np.int64)
        out = ((place < 0) | (place > top)).any(2)
        x, y, z = np.moveaxis(np.clip(place, 0, top), 2, 0)
        blocked = (out | ~lumen[z, y, x]).any(1)
        free[walking[blocked]] = False
        start += block
        walking = walking[~blocked & (STEP * (start - 1) < reach[walking])]
    return free


def seen(lumen, to_voxel, voxels, world, path, halves, flips):
    """Flags of the boundary voxels that any pose sees. `flips`: +1 as flown, -1 turned half about the camera's up."""
    shown = np.zeros(len(voxels), bool)
    for pose in path["poses"]:
        eye, turn = np.array(pose["position"]), turned(pose["quaternion"])
        for flip in flips:
            at = (world - eye) @ turn
            at[:, 2] *= flip
            depth = -at[:, 2]
            inside = (depth >= pose["near"]) & (np.abs(at[:, 0]) <= depth * halves[0]) \
                & (np.abs(at[:, 1]) <= depth * halves[1])
            asked = np.flatnonzero(inside & ~shown)
            shown[asked] = in_lumen(lumen, to_voxel(eye), voxels[asked])
    return shown


def by_rays(mask, path):
    """Share of boundary voxels seen one way and both ways, and how many there are."""
    lumen = sitk.GetArrayFromImage(mask) > 0
    voxels = boundary(lumen)[:, ::-1].astype(float)
    axes = np.array(mask.GetDirection()).reshape(3, 3) * np.array(mask.GetSpacing())
    origin, back = np.array(mask.GetOrigin()), np.linalg.inv(axes)
    half = np.tan(np.radians(path["fov_y_deg"]) / 2)
    world, halves = voxels @ axes.T + origin, (half * SIZE[0] / SIZE[1], half)
    views = lumen, lambda p: (p - origin) @ back.T, voxels, world, path, halves
    one = seen(*views, (1,))
    both = one | seen(*views, (-1,))
    return float(one.mean()), float(both.mean()), len(voxels)


def rows(name, data, programs, folder):
    """intima's figures, the rays' and how far they are apart, for each wall asked for."""
    file, lumen = CASES[name]
    if not (data / file).exists():
        return
    for program in programs:
        row = {"part": "coverage", "case": name, "program": program.name, "ours": True}
        out = folder / f"coverage-{name}-{program.name}".replace(", ", "-").replace(" ", "-")
        path = out.with_suffix(".json")
        wall = ("--wall", program.wall) if program.wall else ()
        given = (*lumen, data / file) if lumen[-1] == "--mask" else (data / file, *lumen)
        try:
            row["seconds"] = program.run("run", *given, *wall, "--out", out, "--frames", FRAMES, "--size",
                                         "{}x{}".format(*SIZE), "--lod", "off", "--write-path", path)
            said = json.loads((out / "report.json").read_text())["coverage"]
            one, both, count = by_rays(sitk.ReadImage(str(out / "mask.nrrd")), json.loads(path.read_text()))
            ours = said["one_way_fraction"], said["both_ways_fraction"]
            row.update(one_way=ours[0], one_way_rays=one, one_way_off=ours[0] - one, both_ways=ours[1],
                       both_ways_rays=both, both_ways_off=ours[1] - both, boundary_voxels=count)
        except Failed as e:
            row["error"] = str(e)
        yield row
