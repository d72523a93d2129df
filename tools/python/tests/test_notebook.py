"""The notebook, run as it stands."""

import pathlib
import shutil

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = pathlib.Path(__file__).parents[1] / "ct_to_video.ipynb"


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="a video needs ffmpeg")
def test_the_notebook_goes_from_a_ct_to_a_video(tmp_path, monkeypatch, vulkan):
    for name in ("INTIMA_CT", "INTIMA_ORGAN"):
        monkeypatch.delenv(name, raising=False)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    text = "".join(o.get("text", "") for cell in notebook.cells for o in cell.get("outputs", []))
    assert "60 frames, Flight(60 poses" in text and "1 branch," in text
    video = (tmp_path / "flight.mp4").read_bytes()
    assert video[4:8] == b"ftyp" and len(video) > 20_000
