"""The Hessian ridge of the distance map, in float64 and with a general eigensolver.

Definition, for a mask with spacing h = (hx, hy, hz) mm and h_min its smallest entry:

  d      distance to the nearest external voxel centre, mm (edt.py). Outside the lumen, two continuations:
           zero    d = 0
           signed  d = -(distance to the nearest inside voxel centre)
  f      d blurred by a Gaussian of sigma = h_min (physical), so sigma / h voxels along each axis; the kernel is cut at
         int(4 sigma / h + 0.5) voxels and its weights sum to one; the volume continues outside as external voxels
  g, H   central differences: (f+ - f-) / 2h, (f+ - 2f + f-) / h^2, (f++ - f+- - f-+ + f--) / 4 h_i h_j
  l3, v3 largest eigenvalue of H and its unit eigenvector
  a, b   an orthonormal basis of the plane across v3
  K      [a b]^T H [a b], eigenvalues l1 <= l2
  t      -[a b] K^-1 [a b]^T g, the offset in mm to the ridge

A voxel is accepted if d >= h_min (every inside voxel is), l2 < -1e-4 / h_min, |t_i| <= 0.6 h_i on each axis and
|g| <= 0.7. `paper` is the same without the last condition. Where H is a multiple of the identity (p < 1e-6 |q| with
q = tr H / 3, p = sqrt(|H - q I|^2 / 6)) v3 has no direction: there t = -g / q and l1 = l2 = q.

Why two continuations: with zeros outside, the blur sees the crease at the wall and bends f over the last two voxels; the
slope there falls below the gate and a second layer of "ridge" appears along the wall, on clean tubes most of all that
is accepted. Signed distances have no such crease, and what is left lies on the axis.

Uncertain voxels, on which a single-precision program may decide either way, are those that loose thresholds accept and
strict ones do not:
  |t_i| / h_i  0.61 and 0.59      |g|  0.71 and 0.69      l2 h_min  -0.5e-4 and -2e-4
  and, for the strict thresholds only, (l3 - l2) h_min > 1e-3 (closer eigenvalues leave v3 to rounding).
`accepted` holds what passes the strict thresholds, `uncertain` what passes only the loose ones; all else is rejected.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from edt import distance

MASKS = ["tube", "oblique", "torus", "oblique_thick", "torus_thick"]
PAD = 8  # more than the kernel reaches, so that blur and differences never meet an edge


def derivatives(f, h):
    """Central differences of f [z, y, x]; h is (x, y, z). -> g [.., 3], H [.., 3, 3] in x, y, z order."""

    def at(*offset):  # offset along x, y, z
        return np.roll(f, [-o for o in offset[::-1]], (0, 1, 2))

    unit = np.eye(3, dtype=int)
    g = np.stack([(at(*u) - at(*-u)) / (2 * h[i]) for i, u in enumerate(unit)], -1)
    hessian = np.empty(f.shape + (3, 3))
    for i, u in enumerate(unit):
        hessian[..., i, i] = (at(*u) - 2 * f + at(*-u)) / h[i] ** 2
        for j in range(i):
            v = unit[j]
            cross = at(*(u + v)) - at(*(u - v)) - at(*(v - u)) + at(*-(u + v))
            hessian[..., i, j] = hessian[..., j, i] = cross / (4 * h[i] * h[j])
    return g, hessian


def analyse(mask, spacing, beyond):
    """-> dict of arrays over the inside voxels, in the order of their index (x fastest)."""
    h = np.array(spacing)
    h_min = h.min()
    d = np.pad(distance(mask, spacing), PAD)
    if beyond == "signed":
        d -= distance_transform_edt(~np.pad(mask, PAD), sampling=h[::-1])
    f = gaussian_filter(d, h_min / h[::-1], mode="constant", cval=0.0, truncate=4.0)
    inside = np.pad(mask, PAD)
    g, hessian = (v[inside] for v in derivatives(f, h))
    value, vector = np.linalg.eigh(hessian)  # ascending
    across = vector[..., :2]
    k = np.einsum("nia,nij,njb->nab", across, hessian, across)
    gamma = np.einsum("nia,ni->na", across, g)
    lam = np.linalg.eigvalsh(k)
    with np.errstate(all="ignore"):
        singular = np.abs(np.linalg.det(k)) < 1e-300
        k[singular] = np.eye(2)
        t = -np.einsum("nia,na->ni", across, np.linalg.solve(k, gamma[..., None])[..., 0])
        t[singular] = np.inf
        q = np.trace(hessian, axis1=1, axis2=2) / 3
        rest = hessian - q[:, None, None] * np.eye(3)
        p = np.sqrt((rest**2).sum((1, 2)) / 6)
        blob = p < 1e-6 * np.abs(q)
        t[blob] = (-g / q[:, None])[blob]
        lam[blob] = q[blob, None]
    z, y, x = np.nonzero(mask)
    return {
        "index": x + mask.shape[2] * (y + mask.shape[1] * z),
        "d": d[inside],
        "l12": lam,
        "l3": value[:, 2],
        "v3": vector[..., 2],
        "t": t,
        "t_vox": np.abs(t / h).max(-1),
        "slope": np.linalg.norm(g, axis=-1),
        "flat": lam[:, 1] * h_min,
        "gap": np.where(blob, np.inf, (value[:, 2] - lam[:, 1]) * h_min),
    }


def rows(v, pick):
    """One row a voxel, in the order of COLUMNS; six significant digits."""
    table = np.column_stack([v["d"], v["l12"], v["l3"], v["t"], v["slope"]])[pick]
    floats = [[float(f"{x:.6g}") for x in row] for row in table]
    return [[int(n)] + row for n, row in zip(v["index"][pick], floats)]


COLUMNS = ["index", "d", "l1", "l2", "l3", "tx", "ty", "tz", "slope"]


def fixture(mask, spacing):
    out = {"dims": list(mask.shape[::-1]), "spacing_mm": list(spacing), "columns": COLUMNS}
    for beyond in ("zero", "signed"):
        v = analyse(mask, spacing, beyond)
        paper_loose = (v["t_vox"] <= 0.61) & (v["flat"] < -0.5e-4)
        paper_strict = (v["t_vox"] <= 0.59) & (v["flat"] < -2e-4) & (v["gap"] > 1e-3)
        loose = paper_loose & (v["slope"] <= 0.71)
        strict = paper_strict & (v["slope"] <= 0.69)

        def ids(pick):
            return [int(n) for n in v["index"][pick]]

        out[beyond] = {
            "accepted": rows(v, strict),
            "uncertain": ids(loose & ~strict),
            "paper_accepted": ids(paper_strict),
            "paper_uncertain": ids(paper_loose & ~paper_strict),
        }
    return out
