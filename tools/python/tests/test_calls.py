"""Interrupts, threads, processes and errors."""

import multiprocessing
import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest

import intima


def noise(n, share=0.5):
    """A mask whose centerline takes long."""
    return np.random.default_rng(3).random((n, n, n)) < share


def test_ctrl_c_stops_the_work_at_once_and_the_session_goes_on():
    session = intima.Session(mask=noise(160), tree=True, device="cpu")
    sent = []

    def interrupt():
        time.sleep(0.5)
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        session.centerline()
    assert time.monotonic() - sent[0] < 2.0
    assert session.lumen().mask.any()


def test_other_threads_run_while_the_engine_works():
    counted, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0.001)

    session = intima.Session(mask=noise(64, 0.6), device="cpu", threads=1)
    thread = threading.Thread(target=count)
    thread.start()
    began = time.monotonic()
    session.centerline()
    seconds = time.monotonic() - began
    stop.set()
    thread.join()
    assert counted[0] > 50 * seconds, f"{counted[0]} turns in {seconds:.1f} s"


def test_a_thread_can_watch_and_cancel_the_work_of_another():
    session = intima.Session(mask=noise(160), tree=True, device="cpu")
    stages = set()

    def watch():
        for _ in range(10):
            time.sleep(0.05)
            stages.add(session.progress().stage)
        session.cancel()

    thread = threading.Thread(target=watch)
    thread.start()
    with pytest.raises(intima.Cancelled):
        session.centerline()
    thread.join()
    assert stages - {""}
    session.resume()
    assert session.lumen().mask.any()


def in_child(session, queue):
    """A session of the parent, then one of its own."""
    try:
        session.distance()
    except intima.Error as e:
        queue.put(str(e))
    queue.put(float(intima.distance(np.ones((5, 5, 5), bool)).max()))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_is_told_instead_of_hanging():
    session = intima.Session(mask=np.ones((5, 5, 5), bool), device="cpu")
    session.distance()
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=in_child, args=(session, queue))
    child.start()
    try:
        assert "forked process has none of its threads" in queue.get(timeout=60)
        assert queue.get(timeout=60) == 3.0
    finally:
        child.kill()


def test_results_go_through_pickle(bend):
    mask, spacing, _ = bend
    line = intima.centerline(mask, spacing)
    again = pickle.loads(pickle.dumps(line))
    np.testing.assert_array_equal(again.points, line.points)
    assert repr(again) == repr(line)


def test_errors_are_values_of_one_family(tmp_path):
    with pytest.raises(ValueError, match="no setting `treshold`"):
        intima.segment(np.ones((4, 4, 4)), treshold=(0, 1))
    with pytest.raises(intima.InputError, match="empty lumen: no voxel is in"):
        intima.segment(np.zeros((4, 4, 4), np.int16), threshold=(5, None))
    with pytest.raises(intima.ArgumentError, match="the lumen must be chosen"):
        intima.segment(np.random.default_rng(1).random((9, 9, 9)))
    with pytest.raises(intima.MemoryLimitError, match="more than the 1 MB allowed"):
        intima.distance(np.ones((64, 64, 64), bool), max_memory=1)
    with pytest.raises(MemoryError):
        intima.distance(np.ones((64, 64, 64), bool), max_memory=1)
    with pytest.raises(intima.Error, match="nothing.nrrd"):
        intima.Volume.read(tmp_path / "nothing.nrrd")
    (tmp_path / "broken.nrrd").write_text("NRRD0004\ntype: what\n")
    with pytest.raises(intima.InputError, match="broken.nrrd"):
        intima.Volume.read(tmp_path / "broken.nrrd")


@pytest.mark.parametrize(
    "settings, what",
    [
        ({"organ": "heart"}, "one of `airway`, `colon`, `vessel`"),
        ({"organ": "colon", "threshold": (0, 1)}, "organ=colon: chooses"),
        ({"tagged": True}, "organ=\"colon\""),
        ({"threshold": (2, 1)}, "the lower end"),
        ({"threshold": 3}, "threshold"),
        ({"seed": (1, 2, 3), "seed_mm": (1, 2, 3)}, "two choices"),
        ({"leak_control": True}, "needs a seed"),
        ({"threads": 0}, "threads"),
        ({"device": "cuda"}, "auto, cpu, gpu"),
        ({"size": (8, 8)}, "16 to 8192"),
        ({"fov": 0.0}, "degrees"),
        ({"frames": 3, "speed": 4.0}, "two choices"),
        ({"route": "leaf:x"}, "leaf:N"),
        ({"smooth": -1}, "smooth"),
    ],
)
def test_settings_that_cannot_be_are_named(settings, what):
    with pytest.raises(intima.ArgumentError, match=what):
        intima.Session(np.ones((4, 4, 4), np.uint8), **settings)
