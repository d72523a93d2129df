"""A bright vessel tree in noise, of any size, as OME-Zarr 0.5 (chunks of 64³, zstd) or raw NRRD.

    python tools/large/tree.py 2048 tree.zarr
    python tools/large/tree.py 1024 tree.nhdr

Six generations of straight branches from a trunk, 0.25 mm voxels, uint8: 180 in vessels, 60 about
them, noise of 6; edges are a ramp of two voxels. Every chunk holds noise, so none is left out.
"""

import argparse
import json
import multiprocessing
import pathlib

import numcodecs
import numpy as np

CHUNK = 64
SPACING_MM = 0.25
INSIDE, OUTSIDE, NOISE = 180, 60, 6
# Of the trunk, in voxels of a volume of 2048: length and radius; and their ratio to the next one.
LENGTH, RADIUS, SHORTER, THINNER = 500, 12, 0.78, 0.8
GENERATIONS = 7


def branches(side):
    """Ends and radius of each branch, voxels."""
    rng = np.random.default_rng(5)
    scale = side / 2048
    out = []

    def grow(start, along, length, radius, generation):
        end = start + along * length
        out.append((start, end, radius))
        if generation + 1 == GENERATIONS:
            return
        across = np.cross(along, rng.normal(size=3))
        across /= np.linalg.norm(across)
        for sign in (1, -1):
            angle = sign * np.radians(rng.uniform(28, 48))
            way = np.cos(angle) * along + np.sin(angle) * across
            # A branch that would leave the volume turns back at its face.
            tip = end + way * length * 1.5
            way = np.where((tip < 60 * scale) | (tip > side - 60 * scale), -way, way)
            grow(end, way, length * SHORTER, radius * THINNER, generation + 1)

    trunk = np.array([side / 2, side / 2, 60 * scale])
    grow(trunk, np.array([0.0, 0.0, 1.0]), LENGTH * scale, RADIUS * max(scale, 0.5), 0)
    return out


def values(tree, lo, noise):
    """Samples of the chunk at `lo` (x, y, z), [z, y, x]."""
    # The same noise everywhere, moved by a number of its own: a chunk costs a copy.
    shift = (int(lo[0]) * 31 + int(lo[1]) * 57 + int(lo[2]) * 91) % noise.size
    grey = np.roll(noise.ravel(), shift).reshape(noise.shape)
    middle, reach = lo + CHUNK / 2, CHUNK / 2 * 3**0.5 + 2
    near = [b for b in tree if distance(middle, *b[:2]) < reach + b[2]]
    if near:
        z, y, x = np.meshgrid(*(np.arange(CHUNK) + lo[k] for k in (2, 1, 0)), indexing="ij")
        voxels = np.stack([x, y, z], -1).astype(float)
        depth = np.max([r - distance(voxels, a, b) for a, b, r in near], axis=0)
        grey = grey + (INSIDE - OUTSIDE) * np.clip(0.5 + depth / 2, 0, 1)
    return grey.astype(np.uint8)


def distance(p, a, b):
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a) if t.ndim else p - a - t * (b - a), axis=-1)


def start(side):
    global TREE, NOISE_CHUNK
    TREE = branches(side)
    noise = np.random.default_rng(7).normal(OUTSIDE, NOISE, (CHUNK,) * 3)
    NOISE_CHUNK = np.clip(noise.round(), 0, 120).astype(np.uint8)


def write_chunk(job):
    folder, at = job
    samples = values(TREE, np.array(at) * float(CHUNK), NOISE_CHUNK)
    path = folder / "c" / str(at[2]) / str(at[1]) / str(at[0])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(numcodecs.Zstd(1).encode(samples))


def slab(job):
    side, z = job
    count = side // CHUNK
    out = np.empty((CHUNK, side, side), np.uint8)
    for y in range(count):
        for x in range(count):
            box = np.s_[:, y * CHUNK : (y + 1) * CHUNK, x * CHUNK : (x + 1) * CHUNK]
            out[box] = values(TREE, np.array([x, y, z]) * float(CHUNK), NOISE_CHUNK)
    return out


def zarr(side, out):
    array = {
        "zarr_format": 3, "node_type": "array", "shape": [side] * 3, "data_type": "uint8",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [CHUNK] * 3}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0, "attributes": {},
        "codecs": [
            {"name": "bytes"},
            {"name": "zstd", "configuration": {"level": 1, "checksum": False}},
        ],
    }
    axes = [{"name": n, "type": "space", "unit": "millimeter"} for n in "zyx"]
    scale = {"type": "scale", "scale": [SPACING_MM] * 3}
    scales = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": [scale]}]}
    ome = {"version": "0.5", "multiscales": [scales]}
    group = {"zarr_format": 3, "node_type": "group", "attributes": {"ome": ome}}
    folder = out / "0"
    folder.mkdir(parents=True)
    (out / "zarr.json").write_text(json.dumps(group))
    (folder / "zarr.json").write_text(json.dumps(array))
    n = side // CHUNK
    jobs = [(folder, (x, y, z)) for z in range(n) for y in range(n) for x in range(n)]
    with multiprocessing.Pool(2, start, (side,)) as pool:
        for _ in pool.imap_unordered(write_chunk, jobs, 64):
            pass


def raw(side, out):
    start(side)
    step = " ".join(f"({','.join(str(SPACING_MM * (i == k)) for i in range(3))})" for k in range(3))
    data = out.with_suffix(".raw")
    out.write_text(
        f"NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {side} {side} {side}\nspace directions: {step}\nencoding: raw\n"
        f"data file: {data.name}\n\n"
    )
    with open(data, "wb") as file:
        for z in range(side // CHUNK):
            file.write(slab((side, z)).tobytes())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("side", type=int, help="voxels a side, a multiple of 64")
    parser.add_argument("out", type=pathlib.Path, help="folder .zarr, or header .nhdr")
    args = parser.parse_args()
    (raw if args.out.suffix == ".nhdr" else zarr)(args.side, args.out)


if __name__ == "__main__":
    main()
