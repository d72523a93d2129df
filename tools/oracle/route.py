"""Cheapest routes through a lumen, by SciPy's Dijkstra on an explicit graph.

Nodes are inside voxels, steps go to the 26 neighbours. A diagonal step is legal only if every voxel of the 2x2 or 2x2x2
block it spans is inside. A step of length e mm from u to v costs e (w(u) + w(v)) / 2 with w = (h_min / d)^2 and d the
distance in mm of edt.py (`centred`), or w = 1 (`plain`, so the cost is a length in mm).
"""

import itertools

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from edt import distance

MASKS = ["oblique", "torus", "torus_thick", "blobs", "blobs_thick", "lines", "noise_dense"]
TARGETS = 12


def steps(mask):
    """Each legal step once: (from node, to node, (dz, dy, dx))."""
    node = -np.ones(mask.shape, int)
    node[mask] = np.arange(mask.sum())
    for d in itertools.product((-1, 0, 1), repeat=3):
        if d <= (0, 0, 0):
            continue
        here = tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(d, mask.shape))
        legal = np.ones(mask[here].shape, bool)
        for part in itertools.product(*[(0, s) if s else (0,) for s in d]):
            block = tuple(slice(h.start + p, h.stop + p) for h, p in zip(here, part))
            legal &= mask[block]
        there = tuple(slice(h.start + s, h.stop + s) for h, s in zip(here, d))
        yield node[here][legal], node[there][legal], d


def fixture(mask, spacing):
    h = np.array(spacing[::-1])
    d = distance(mask, spacing)[mask]
    count = len(d)
    place = np.argwhere(mask)

    def costs(w, source):
        i, j, c = [], [], []
        for a, b, step in steps(mask):
            i.append(a)
            j.append(b)
            c.append(np.linalg.norm(step * h) * (w[a] + w[b]) / 2)
        i, j, c = (np.concatenate(x) for x in (i, j, c))
        graph = coo_matrix((c, (i, j)), shape=(count, count)).tocsr()
        return dijkstra(graph, directed=False, indices=source)

    source = int(np.argmax(d))  # deepest voxel; among equals the first, x fastest
    plain = costs(np.ones(count), source)
    centred = costs((min(spacing) / d) ** 2, source)
    reached = np.flatnonzero(np.isfinite(plain))
    assert (np.isfinite(centred) == np.isfinite(plain)).all()
    some = np.unique(np.linspace(0, len(reached) - 1, TARGETS).astype(int))

    def ijk(n):
        return [int(x) for x in place[n][::-1]]

    return {
        "spacing_mm": list(spacing),
        "source": ijk(source),
        "reached": len(reached),
        "unreached": count - len(reached),
        "sum_plain_mm": float(f"{plain[reached].sum():.12g}"),
        "sum_centred": float(f"{centred[reached].sum():.12g}"),
        "targets": [
            {"at": ijk(n), "plain_mm": float(plain[n]), "centred": float(centred[n])}
            for n in reached[some]
        ],
    }
