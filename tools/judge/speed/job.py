"""One peer on one case, in a process of its own: prepares, calls, and prints a JSON object.

    job.py MODULE:FUNCTION ARGUMENTS CASE_FOLDER CASE OUTPUT

FUNCTION of peers/MODULE.py takes a Case and ARGUMENTS (a JSON list) and returns the call to be timed, alone or with a
function that turns its result into arrays. A call with an attribute `fresh` gets what `fresh()` returns, made off the
clock before every call.

The call is timed from input in memory to output in memory. A first call warms up; where it takes SLOW seconds or more
it is the sample itself. OUTPUT gets the result as arrays, unless it is `-`."""

import importlib
import json
import os
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]

SLOW_S = 5.0  # calls this long are not repeated within a process
CALLS = 3     # timed calls in a process that is warm, of quick ones


def _status_mb(key):
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024 / 1e6
    return None


def peak_mb():
    """The most memory this process has held, MB; none where the system does not say."""
    return _status_mb("VmHWM") if os.path.exists("/proc/self/status") else None


def plain(result):
    """A peer's own kind of result as arrays."""
    import numpy as np
    kind = type(result).__module__
    if "SimpleITK" in kind:
        import SimpleITK as sitk
        return sitk.GetArrayFromImage(result)
    if "vtk" in kind:
        from vtk_data import from_poly
        return from_poly(result)
    return np.asarray(result)


def save(path, result):
    """Arrays as NAME.npz: `a`, or vertices, faces and normals as `v`, `f`, `n`."""
    import numpy as np
    if isinstance(result, tuple):
        vertices, faces, normals = result
        np.savez(path, v=vertices, f=faces, **({} if normals is None else {"n": normals}))
    else:
        np.savez(path, a=result)


def load(path):
    """What `save` wrote: an array, or (vertices, faces, normals or None)."""
    import numpy as np
    with np.load(path) as found:
        return found["a"] if "a" in found else (found["v"], found["f"], found.get("n"))


def main(place, arguments, folder, name, output):
    from inputs import Case
    module, function = place.split(":")
    make = getattr(importlib.import_module(f"peers.{module}"), function)
    prepared = make(Case(Path(folder), name), *json.loads(arguments))
    call, finish = prepared if isinstance(prepared, tuple) else (prepared, plain)
    before, times = peak_mb(), []
    result, first = None, 0.0
    while len(times) < (1 if first >= 1.0 else CALLS):
        result = None  # the last one's memory is not the next one's
        given = [call.fresh()] if hasattr(call, "fresh") else []
        start = time.perf_counter()
        result = call(*given)
        took = time.perf_counter() - start
        if first or took >= SLOW_S:
            times.append(took)
        first = first or took
    found = {"times": times, "peak_mb": peak_mb(), "also": {"before_mb": before}}
    if output != "-":
        save(output, finish(result))
    print("\n" + json.dumps(found), flush=True)
    os._exit(0)  # VTK and ITK threads do not always end in peace


if __name__ == "__main__":
    main(*sys.argv[1:])
