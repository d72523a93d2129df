"""Measures distance and centerline beside edt, SciPy, kimimaro and skan, and memory.

    python measure.py distance MASK.nii.gz    seconds and values on 256^3 and on a label map
    python measure.py centerline MASK.nii.gz  seconds, points inside, length
    python measure.py memory                  resident memory while a 512^3 mask goes through

Needs edt, scipy, kimimaro, skan and scikit-image. Medians of five in one process, alternating, so
that another load falls on all alike; ratios say more than seconds.
"""

import json
import resource
import statistics
import sys
import time

import numpy as np

import intima


def alternate(programs, repeats=5):
    """Median seconds of each program, and what each returned last."""
    seconds = {name: [] for name in programs}
    results = {}
    for _ in range(repeats):
        for name, program in programs.items():
            began = time.perf_counter()
            results[name] = program()
            seconds[name].append(time.perf_counter() - began)
    return {name: statistics.median(s) for name, s in seconds.items()}, results


def balls(n):
    """A mask of overlapping balls in n^3 voxels."""
    random = np.random.default_rng(1)
    mask = np.zeros((n, n, n), bool)
    for _ in range(60):
        r = int(random.integers(n // 20, n // 7))
        at = random.integers(r, n - r, 3)
        box = tuple(slice(a - r, a + r + 1) for a in at)
        z, y, x = np.ogrid[-r : r + 1, -r : r + 1, -r : r + 1]
        mask[box] |= z * z + y * y + x * x <= r * r
    return mask


def measure_distance(path):
    """Seconds and largest difference beside edt and SciPy."""
    import edt
    from scipy import ndimage

    cases = {"balls 256^3": intima.Volume(balls(256), (1.0, 1.0, 1.0))}
    if path:
        labels = intima.Volume.read(path)
        cases[path.rsplit("/", 1)[-1]] = labels.with_array(np.ascontiguousarray(labels.array != 0))
    for name, volume in cases.items():
        mask, spacing = volume.array, volume.spacing
        bytes_ = mask.astype(np.uint8)
        programs = {
            "intima": lambda: intima.distance(volume, device="cpu", threads=2),
            "edt": lambda: edt.edt(bytes_, spacing, black_border=True, parallel=2),
            "scipy": lambda: ndimage.distance_transform_edt(np.pad(mask, 1), spacing)[1:-1, 1:-1, 1:-1],
        }
        seconds, results = alternate(programs)
        off = {n: float(np.abs(results[n] - results["intima"]).max()) for n in ("edt", "scipy")}
        ratio = {n: s / seconds["intima"] for n, s in seconds.items()}
        print(json.dumps({"case": name, "voxels": mask.size, "inside": int(mask.sum()), "seconds": seconds,
                          "ratio": ratio, "largest_difference_mm": off}))


def longest_path(points, pairs):
    """Longest shortest path of a graph of points, mm, from the end farthest from any one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components, dijkstra

    weights = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((weights, pairs.T), shape=(len(points),) * 2).tocsr()
    _, label = connected_components(graph, directed=False)
    first = np.flatnonzero(label == np.bincount(label).argmax())[0]
    far = dijkstra(graph, directed=False, indices=first)
    far[~np.isfinite(far)] = -1
    away = dijkstra(graph, directed=False, indices=int(far.argmax()))
    return float(away[np.isfinite(away)].max())


def inside(volume, points):
    """Share of points whose voxel is in the mask."""
    at = np.round(volume.to_index(points)).astype(int)
    within = ((at >= 0) & (at < volume.shape)).all(axis=1)
    return float((volume.array[tuple(at[within].T)] != 0).sum() / len(at))


def measure_centerline(path):
    """Seconds, points inside and end-to-end length beside kimimaro and skan."""
    import kimimaro
    from scipy import ndimage
    from skan import Skeleton
    from skimage.morphology import skeletonize

    read = intima.Volume.read(path)
    parts, _ = ndimage.label(read.array != 0)
    largest = np.bincount(parts.ravel())[1:].argmax() + 1
    volume = intima.Volume(np.ascontiguousarray(parts == largest), read.spacing)
    spacing = np.asarray(volume.spacing)

    def by_kimimaro():
        labels = np.asfortranarray(volume.array.astype(np.uint8))
        teasar = {"scale": 1.5, "const": 5.0}
        made = kimimaro.skeletonize(labels, teasar_params=teasar, anisotropy=tuple(spacing), progress=False,
                                    parallel=1, dust_threshold=100)
        return made[1]

    programs = {
        "intima path": lambda: intima.centerline(volume, device="cpu", threads=2),
        "intima tree": lambda: intima.centerline(volume, tree=True, device="cpu", threads=2),
        "kimimaro": by_kimimaro,
        "skan": lambda: Skeleton(skeletonize(volume.array), spacing=tuple(spacing)),
    }
    seconds, found = alternate(programs, 3)
    out = {}
    for name in ("intima path", "intima tree"):
        line = found[name]
        firsts = np.cumsum([0] + [len(b.points) for b in line.branches])
        pairs = [[i, i + 1] for b, f in zip(line.branches, firsts) for i in range(f, f + len(b.points) - 1)]
        for b, f in zip(line.branches, firsts):
            if b.start:
                pairs.append([firsts[b.start[0]] + b.start[1], f])
            if b.end:
                pairs.append([firsts[b.end[0]] + b.end[1], f + len(b.points) - 1])
        out[name] = (line.points, np.asarray(pairs))
    # Both have vertices in z, y, x mm.
    k = found["kimimaro"]
    out["kimimaro"] = (k.vertices[:, ::-1].astype(float), k.edges.astype(int))
    s = found["skan"]
    graph = s.graph.tocoo()
    out["skan"] = ((s.coordinates * spacing)[:, ::-1], np.stack([graph.row, graph.col], axis=1))
    for name, (points, pairs) in out.items():
        print(json.dumps({"program": name, "seconds": round(seconds[name], 3),
                          "ratio": round(seconds[name] / seconds["intima path"], 2), "points": len(points),
                          "inside": inside(volume, points), "end_to_end_mm": round(longest_path(points, pairs), 1)}))


def measure_memory():
    """Peak of resident memory beside input and result."""
    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    n = 512
    mask = np.zeros((n, n, n), np.uint8)
    mask[:256, :256, :256] = balls(256)
    mask += 0  # resident
    before = peak()
    found = intima.distance(mask, device="cpu", threads=2)
    grown = peak() - before
    print(json.dumps({"mask_mb": mask.nbytes / 1e6, "result_mb": found.nbytes / 1e6, "before_mb": before / 1e6,
                      "grown_mb": grown / 1e6, "beside_result_mb": (grown - found.nbytes) / 1e6}))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    what, path = sys.argv[1], (sys.argv[2:] or [None])[0]
    {"distance": measure_distance, "centerline": measure_centerline}.get(what, lambda _: measure_memory())(path)
