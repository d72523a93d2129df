"""Vulkan: start-up time, submissions, and the memory rate of each kernel relative to a copy."""

from statistics import median

from runs import Failed

START_MS = 150


def measure(intima, args, check):
    """`intima bench` on the Vulkan device, each round a process of its own; the first one warms the caches."""
    try:
        cold = intima.run("bench", "--device", "gpu", "--size", 64, "--runs", 1).report["devices"][0]
    except Failed as e:
        return check(f"Vulkan: {e}", None, "", None, "")
    rounds = [intima.run("bench", "--device", "gpu", "--size", args.size, "--runs", 5).report
              for _ in range(intima.rounds)]
    devices = [r["devices"][0] for r in rounds]
    small = [intima.run("bench", "--device", "gpu", "--size", 64, "--runs", 1).report["devices"][0]
             for _ in range(intima.rounds)]
    start = [d["first_dispatch_ms"] for d in small]
    check("instance to first dispatch, ms", median(start), "<=", START_MS,
          f"{min(start):.0f} to {max(start):.0f}; the first process {cold['first_dispatch_ms']:.0f}")
    plans, submissions = devices[0]["plans"], devices[0]["submissions"]
    check("submissions a plan", submissions / plans, "<=", 1, f"{submissions} for {plans} plans")
    rows(rounds, devices, check)
    cpu = [intima.run("bench", "--device", "cpu", "--size", args.size, "--runs", 5).report for _ in range(intima.rounds)]
    rows(cpu, [r["devices"][0] for r in cpu], check)


def rows(rounds, devices, check):
    """Kernels of one device."""
    name = devices[0]["device"].split(" ")[0]
    copy = median(d["copy"]["gb_per_s"] for d in devices)
    check(f"{name} copy, GB/s", copy, "", None, f"{devices[0]['copy']['bytes'] / 1e6:.0f} MB from buffer to buffer")
    timed = [[r for r in report["rows"] if r["kind"] == "kernel"] for report in rounds]
    lacking = [r["name"] for r in timed[0] if r["median_ms"] <= 0]
    check(f"{name} kernels without a time", len(lacking), "<=", 0, ", ".join(lacking) or f"of {len(timed[0])}")
    for i, row in enumerate(timed[0]):
        rate = median(rows[i]["gb_per_s"] for rows in timed)
        ms = median(rows[i]["median_ms"] for rows in timed)
        check(f"{name} {row['name']}: share of the copy's rate", rate / copy, "", None,
              f"{rate:.2f} GB/s, {ms:.3f} ms, {row['launches']} launches")
