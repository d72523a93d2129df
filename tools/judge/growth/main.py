"""Scaling of intima: threads, growth, memory and the device, each with its limit.

Started by `cargo xtask judge growth`, which builds intima. Needs nothing but Python. README.md says how to read the
result."""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import device  # noqa: E402
import growth  # noqa: E402
import memory  # noqa: E402
import threads  # noqa: E402
from runs import Intima  # noqa: E402

PARTS = {
    "threads": threads.measure,
    "growth": growth.measure,
    "box": growth.measure_box,
    "memory": memory.measure,
    "device": device.measure,
}


def arguments():
    """The command line, as `cargo xtask judge growth` passes it on."""
    parser = argparse.ArgumentParser(prog="cargo xtask judge growth", description=__doc__)
    parser.add_argument("--intima", required=True, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="what is compared takes turns N times (default 5)")
    parser.add_argument("--sizes", default="160,216,296,400", help="sides of the phantom whose growth is fitted")
    parser.add_argument("--size", type=int, default=256, help="side of the phantom of threads, box and device")
    parser.add_argument("--large", type=int, default=512, help="side of the phantom whose memory is measured")
    parser.add_argument("--memory-rounds", type=int, default=1, metavar="N", help="(default 1: peaks hardly vary)")
    parser.add_argument("--device", default="cpu", help="of growth, box and memory (default cpu)")
    parser.add_argument("--out", type=Path, default=Path("out/growth"), metavar="DIR")
    args = parser.parse_args()
    unknown = set(args.parts.split(",")) - set(PARTS)
    if unknown or args.rounds < 1 or args.memory_rounds < 1:
        parser.error(f"no such part: {', '.join(sorted(unknown))}" if unknown else "rounds are at least 1")
    args.sizes = [int(s) for s in args.sizes.split(",")]
    args.device = ["--device", args.device]
    return args


def machine(intima):
    """What the figures depend on."""
    def report(*command):
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    info = Path("/proc/cpuinfo")
    cpu = [s.split(":", 1)[1].strip() for s in info.read_text().splitlines() if s.startswith("model name")] if info.exists() else []
    return {"date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"), "intima": report(str(intima), "-V"),
            "commit": report("git", "-C", str(Path(__file__).resolve().parent), "rev-parse", "--short", "HEAD"),
            "cpu": (cpu or [platform.machine()])[0], "cores": os.cpu_count(), "load_start": os.getloadavg()[0]}


def main():
    args = arguments()
    intima = Intima(args.intima.resolve(), args.out, args.rounds)
    found, checks = {"machine": machine(args.intima), "rounds": args.rounds}, []
    table = args.out / "table.md"
    for part in args.parts.split(","):
        print(f"\n== {part}", flush=True)

        def check(what, figure, sense, limit, detail, part=part):
            held = None if limit is None else figure >= limit if sense == ">=" else figure <= limit
            checks.append({"part": part, "what": what, "figure": figure, "sense": sense, "limit": limit, "held": held,
                           "detail": detail})
            print(line(checks[-1]), flush=True)

        before = busy()
        PARTS[part](intima, args, check)
        others = elsewhere(before)
        found["machine"]["load_end"] = os.getloadavg()[0]
        if others is not None:
            check("cores that other programs took", others, "", None, "not quiet: read the fastest" if others > 0.2 else "quiet")
        (args.out / "results.json").write_text(json.dumps(found | {"checks": checks}, indent=1))
        table.write_text(markdown(found, checks))
    missed = [c for c in checks if c["held"] is False]
    judged = [c for c in checks if c["held"] is not None]
    print(f"\n{len(judged) - len(missed)} of {len(judged)} limits hold; {table}")
    return 1 if missed else 0


def busy():
    """Seconds: now, of all cores at work since the start (`None` where the system does not say), of our programs."""
    stat = Path("/proc/stat")
    spent = stat.read_text().split("\n", 1)[0].split()[1:] if stat.exists() else []
    own = sum(os.times()[:4])
    ticks = sum(map(int, spent[:8])) - sum(map(int, spent[3:5]))  # all but idle and waiting
    return time.monotonic(), ticks / os.sysconf("SC_CLK_TCK") if spent else None, own


def elsewhere(before):
    """Cores that other programs took since then, on average."""
    now = busy()
    if now[1] is None:
        return None
    wall, all_cores, own = (b - a for a, b in zip(before, now))
    return max(0.0, (all_cores - own) / wall)


VERDICT = {True: "holds", False: "MISSED", None: ""}


def cells(c):
    """What a check shows: figure, limit, verdict."""
    figure = "" if c["figure"] is None else f"{c['figure']:.3g}"
    return figure, "" if c["limit"] is None else f"{c['sense']} {c['limit']:g}", VERDICT[c["held"]]


def line(c):
    """A check while it is measured."""
    figure, limit, verdict = cells(c)
    return f"{c['what']:<46} {figure:>8} {limit:>8} {verdict:<7} {c['detail']}"


def markdown(found, checks):
    """All checks, for people."""
    m = found["machine"]
    out = ["# How intima scales", "",
           f"{m['date']}, {m['intima']} ({m['commit']}), {m['cpu']}, {m['cores']} cores; rounds: {found['rounds']}; load when "
           f"it began {m['load_start']:.1f}, at the end {m['load_end']:.1f}.", "",
           "| part | what | figure | limit | | measured |", "|---|---|---|---|---|---|"]
    out += [f"| {' | '.join([c['part'], c['what'], *cells(c), c['detail']])} |" for c in checks]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    sys.exit(main())
