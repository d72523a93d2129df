"""Runs intima as its user would."""

import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

TIMEOUT_S = 300


class Failed(Exception):
    """What intima said when it failed."""


@dataclass(frozen=True)
class Program:
    """A build of intima, and how its walls are asked for."""

    name: str
    path: Path
    wall: str | None = None

    def run(self, command, *args):
        """`intima COMMAND ARGS`, quietly -> seconds it took."""
        line = [str(self.path), command, *map(str, args), "--quiet"]
        start = time.monotonic()
        try:
            done = subprocess.run(line, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired as e:
            raise Failed(f"longer than {TIMEOUT_S} s") from e
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["nothing"])[0]
            raise Failed(f"exit code {done.returncode}: {said[:200]}")
        return time.monotonic() - start

    def surface(self, out, *args):
        """`intima surface ARGS -o OUT`, with the wall asked for -> seconds."""
        wall = ["--wall", self.wall] if self.wall else []
        return self.run("surface", *args, *wall, "-o", out)


def programs(intima, walls, before):
    """One for each kind of wall asked for, and the other build."""
    found = [Program(f"intima --wall {w}", intima, w) for w in walls] or [Program("intima", intima)]
    return found + ([Program("intima before", before)] if before else [])
