"""Speed-up of CPU stages and kernels from one thread to two."""

from statistics import median

STAGES = ("distance", "hessian", "fair", "visibility", "surface")
LEAST = 1.7


def measure(intima, args, check):
    """`intima bench` with one thread and with two, in turns."""
    runs = {1: [], 2: []}
    for _ in range(intima.rounds):
        for threads, found in runs.items():
            report = intima.run("bench", "--device", "cpu", "--threads", threads, "--size", args.size, "--runs", 5).report
            found.append({r["name"]: (r["median_ms"], r["min_ms"]) for r in report["rows"] if r["device"] == "cpu"})
    for name in [*STAGES, *sorted(set(runs[1][0]) - set(STAGES))]:
        one, two = ([r[name] for r in runs[t]] for t in (1, 2))
        ms = [median(r[0] for r in each) for each in (one, two)]
        least = min(r[1] for r in one) / min(r[1] for r in two)
        check(f"{name}: 2 threads over 1", ms[0] / ms[1], ">=", LEAST if name in STAGES else None,
              f"{ms[0]:.2f} ms -> {ms[1]:.2f} ms, of the fastest {least:.2f}")
