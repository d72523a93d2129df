"""Rows of published midlines and radii, which others made with other programs: not the truth, but not ours either."""

import numpy as np
import SimpleITK as sitk
from scipy.spatial import cKDTree
from vtk.util.numpy_support import vtk_to_numpy

from files import from_poly, read_csv, read_vtp, write_ply
from program import Failed

CASES = ("colon_label_3 midline", "aorto-iliac tree")
CM = 10.0


def _resampled(points, values, step=0.25):
    """A polyline and what lies on it, at equal steps, mm."""
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, s[-1], max(2, int(s[-1] / step)))
    return np.stack([np.interp(at, s, c) for c in points.T], 1), np.interp(at, s, values)


def _ours(path):
    """Points and radii of all branches."""
    table = read_csv(path)
    points, radius = np.stack([table[k] for k in "xyz"], 1), table["radius"]
    of = [table["branch"] == b for b in np.unique(table["branch"])]
    parts = [_resampled(points[o], radius[o]) for o in of if o.sum() > 1]
    return np.concatenate([p for p, _ in parts]), np.concatenate([r for _, r in parts])


def _apart(published, ours):
    """Both ways; the ends of a path that goes on beyond the other count."""
    there, _ = cKDTree(ours).query(published)
    back, _ = cKDTree(published).query(ours)
    return {"to_ours_mean_mm": float(there.mean()), "to_ours_p95_mm": float(np.percentile(there, 95)),
            "from_ours_mean_mm": float(back.mean()), "from_ours_p95_mm": float(np.percentile(back, 95))}


def _colon(data, program, folder):
    mask = data / "colon_label_3.nii.gz"
    image, table = sitk.ReadImage(str(mask)), read_csv(data / "colon_label_3_midline.csv")
    voxels = np.stack([table[k] for k in "ijk"], 1)
    published = np.array([image.TransformContinuousIndexToPhysicalPoint(v.tolist()) for v in voxels])
    published, _ = _resampled(published, np.zeros(len(published)))
    out = folder / f"colon-3-{program.name.replace(' ', '-')}.csv"
    seconds = program.run("centerline", "--mask", mask, "-o", out)
    ours, _ = _ours(out)
    return {"seconds": seconds, "length_mm": 0.25 * len(ours), "published_mm": 0.25 * len(published), **_apart(published, ours)}


def _vessel(data, program, folder):
    vertices, faces, _ = from_poly(read_vtp(data / "aorto_iliac_surface.vtp"))
    mesh, out = folder / "aorto-iliac.ply", folder / f"aorto-iliac-{program.name.replace(' ', '-')}.csv"
    write_ply(mesh, (vertices * CM, faces, None))
    lines = read_vtp(data / "aorto_iliac_centerlines.vtp")
    published = vtk_to_numpy(lines.GetPoints().GetData()).astype(float) * CM
    radius = vtk_to_numpy(lines.GetPointData().GetArray("MaximumInscribedSphereRadius")).astype(float) * CM
    seconds = program.run("centerline", mesh, "--tree", "-o", out)
    ours, our_radius = _ours(out)
    off, foot = cKDTree(ours).query(published)
    near = off < radius / 2
    more = our_radius[foot][near] - radius[near]
    return {"seconds": seconds, **_apart(published, ours), "covered": float(near.mean()),
            "radius_mean_mm": float(more.mean()), "radius_rms_mm": float(np.sqrt((more ** 2).mean()))}


def rows(data, programs, folder, cases):
    """A row for each program; the published line is the peer."""
    for case, measure, file in zip(CASES, (_colon, _vessel), ("colon_label_3.nii.gz", "aorto_iliac_surface.vtp")):
        if case not in cases or not (data / file).exists():
            continue
        for program in programs:
            row = {"part": "lines", "case": case, "program": program.name, "ours": True}
            try:
                row.update(measure(data, program, folder))
            except Failed as e:
                row["error"] = str(e)
            yield row
