"""Stubs and annotations."""

import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).parents[1]


def run(*command):
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_stub_says_what_the_native_module_has():
    run("mypy.stubtest", "intima._intima")


def test_annotations_are_sound():
    run("mypy", "python/intima")
