"""Peak memory of each command, with its limit."""

import shutil
import statistics

from runs import AIR, folder

BASE_MB, OF_VOLUME, PER_SLOT = 200, 1.3, 24
BRICK = 512


def measure(intima, args, check):
    """Every command on one large volume; mesh commands on its surface."""
    volume, seed = intima.phantom(args.large)
    lumen = ["--threshold", AIR, "--seed-mm", seed]
    out = intima.file
    segment = intima.run("segment", volume, *lumen, "-o", out("o.nrrd"))
    surface = intima.run("surface", volume, *lumen, "-o", out("large.ply")).report["surface"]
    mesh = (24 * surface["vertices"] + 12 * surface["faces"]) / 1e6
    stored = 2 * args.large**3 / 1e6
    slots = PER_SLOT * BRICK * segment.report["lumen"]["bricks"] / 1e6
    frames = ["--frames", 8, "--out"]
    tenth = surface["faces"] // 10
    commands = {
        "info": ([volume], stored),
        "convert": ([volume, "-o", out("o.nii")], stored),
        "phantom": (["colon", "--size", args.large, "-o", out("p.nrrd")], stored),
        "segment": ([volume, *lumen, "-o", out("o.nrrd")], stored, slots),
        "distance": ([volume, *lumen, "-o", out("o.nrrd")], stored, slots),
        "hessian": ([volume, *lumen, "-o", out("o.nrrd")], stored, slots),
        "centerline": ([volume, *lumen, "-o", out("o.csv")], stored, slots),
        "surface": ([volume, *lumen, "-o", out("o.ply")], stored, slots, mesh),
        "record": ([volume, *lumen, *frames, folder(out("record"))], stored, slots, mesh),
        "run": ([volume, *lumen, *frames, folder(out("run"))], stored, slots, mesh),
        "fair": ([out("large.ply"), "-o", out("o.ply")], 0.0, 0.0, mesh),
        "simplify": ([out("large.ply"), "--faces", tenth, "-o", out("o.ply")], 0.0, 0.0, mesh),
    }
    for name, (flags, *sizes) in commands.items():
        of_volume, of_slots, of_mesh = (*sizes, 0.0, 0.0)[:3]
        most = BASE_MB + OF_VOLUME * of_volume + of_slots + of_mesh
        peak = statistics.median(cold(intima, name, flags, args) for _ in range(args.memory_rounds))
        check(f"{name}: peak MB over what it may hold", peak / most, "<=", 1.0,
              f"{peak:.0f} MB of {most:.0f}: {BASE_MB} + {OF_VOLUME} x {of_volume:.0f} stored + {of_slots:.0f} in bricks "
              f"+ {of_mesh:.0f} mesh")


def cold(intima, name, flags, args):
    """Peak memory of a command with an empty cache, so that building the cached data counts."""
    cache = folder(intima.file("cache"))
    try:
        return intima.run(name, *flags, *args.device, cache=cache).peak_mb
    finally:
        shutil.rmtree(cache)
