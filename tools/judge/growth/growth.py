"""Growth of time with the size of the lumen, and with the size of the volume around it."""

import gzip
import math
from statistics import median

from runs import AIR, chain

MAX_GROWTH, MAX_BOX = 1.1, 1.2


def measure(intima, args, check):
    """The colon phantom at four sizes, in turns; the exponent is the slope of log time over log voxels."""
    found = {size: [] for size in args.sizes}
    voxels = {}
    for _ in range(intima.rounds):
        for size, rounds in found.items():
            volume, seed = intima.phantom(size)
            ms, voxels[size] = chain(intima, volume, ["--threshold", AIR, "--seed-mm", seed], args.device)
            rounds.append(ms | {"sum": sum(ms.values())})
    for stage in found[args.sizes[0]][0]:
        ms = [median(r[stage] for r in found[size]) for size in args.sizes]
        shown = ", ".join(f"{m:.2f}" for m in ms)
        check(f"{stage}: exponent over lumen voxels", slope([voxels[s] for s in args.sizes], ms), "<=", MAX_GROWTH,
              f"{shown} ms at {', '.join(f'{voxels[s]:,}' for s in args.sizes)} voxels")


def slope(x, y):
    """Least-squares slope of log y over log x."""
    x, y = [math.log(v) for v in x], [math.log(max(v, 1e-9)) for v in y]
    mx, my = sum(x) / len(x), sum(y) / len(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y)) / sum((a - mx) ** 2 for a in x)


def measure_box(intima, args, check):
    """The same lumen in eight times the volume: grown from a seed, and as the largest component."""
    small, seed = intima.phantom(args.size)
    large = intima.file(f"padded_{args.size}.nrrd")
    if not large.exists():
        pad(small, large)
    for way, chosen, limit in (("seed", ["--seed-mm", seed], MAX_BOX), ("largest component", [], None)):
        rounds = []
        for _ in range(intima.rounds):
            pair = [chain(intima, v, ["--threshold", AIR, *chosen], args.device) for v in (small, large)]
            if pair[0][1] != pair[1][1]:
                raise RuntimeError(f"padding changed the lumen: {pair[0][1]} and {pair[1][1]} voxels")
            rounds.append([p[0] for p in pair])
        for stage in [*rounds[0][0], "sum"]:
            ms = [median(sum(r[i].values()) if stage == "sum" else r[i][stage] for r in rounds) for i in (0, 1)]
            check(f"{way}, {stage}: 8 x the volume", ms[1] / ms[0], "<=", limit if stage == "sum" else None,
                  f"{ms[0]:.2f} ms -> {ms[1]:.2f} ms")


def pad(small, large):
    """Pads a volume to twice its size along each axis with wall values, the old one in the middle."""
    header, _, data = small.read_bytes().partition(b"\n\n")
    fields = dict(line.split(b": ", 1) for line in header.splitlines() if b": " in line)
    nx, ny, nz = map(int, fields[b"sizes"].split())
    steps = [float(v.strip(b"()").split(b",")[i]) for i, v in enumerate(fields[b"space directions"].split())]
    samples = gzip.decompress(data) if fields[b"encoding"] == b"gzip" else data
    # Whole bricks and words of bits, so that the lumen is cut into the same ones.
    off = [n // 2 // 64 * 64 for n in (nx, ny, nz)]
    wall = (40).to_bytes(2, "little", signed=True)
    origin = ",".join(f"{-o * h:g}" for o, h in zip(off, steps))
    header = header.replace(b"sizes: " + fields[b"sizes"], f"sizes: {2 * nx} {2 * ny} {2 * nz}".encode())
    header = header.replace(b"space origin: " + fields[b"space origin"], f"space origin: ({origin})".encode())
    header = header.replace(b"encoding: " + fields[b"encoding"], b"encoding: gzip")
    row, slice_ = wall * (2 * nx), wall * (4 * nx * ny)
    with open(large, "wb") as file:
        file.write(header + b"\n\n")
        with gzip.GzipFile(fileobj=file, mode="wb", compresslevel=1) as out:
            for z in range(2 * nz):
                if not 0 <= z - off[2] < nz:
                    out.write(slice_)
                    continue
                for y in range(2 * ny):
                    at = 2 * nx * ((z - off[2]) * ny + y - off[1])
                    held = 0 <= y - off[1] < ny
                    out.write(wall * off[0] + samples[at:at + 2 * nx] + wall * (nx - off[0]) if held else row)
