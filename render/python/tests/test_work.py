"""Long work: progress, interruption, threads, processes."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import render_gradients as rg

#: Hours of work.
ENDLESS = 1 << 24


def jobs(scene: rg.Scene):
    adjoint = np.ones((*scene.size, 3))
    key = "left.reflectance.value"
    return {
        "render": lambda **how: scene.render(spp=ENDLESS, **how),
        "double": lambda **how: scene.render(spp=ENDLESS, double=True, **how),
        "backward": lambda **how: scene.backward(adjoint, key, spp=ENDLESS, **how),
        "auto": lambda **how: scene.backward(adjoint, key, estimator="auto", spp=ENDLESS, **how),
        "forward": lambda **how: scene.forward(key, spp=ENDLESS, **how),
        "check": lambda **how: scene.check(key, spp=ENDLESS, **how),
    }


def ends_with_ctrl_c(job) -> None:
    # What is started in the background ignores it, and so do its children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sent = []

    def press() -> None:
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.3, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        job()
    assert time.monotonic() - sent[0] < 1.0
    timer.join()


@pytest.mark.parametrize("name", ["render", "double", "backward", "auto", "forward", "check"])
def test_ctrl_c_ends_work_within_a_second(room: rg.Scene, name: str) -> None:
    before = room["left.reflectance.value"]
    ends_with_ctrl_c(jobs(room)[name])
    # Nothing is left behind.
    np.testing.assert_array_equal(room["left.reflectance.value"], before)
    assert room.render(spp=1).shape == (12, 16, 3)


def test_ctrl_c_does_not_wait_for_files(tmp_path) -> None:
    n = 150
    y, x = np.mgrid[:n, :n]
    i = (y * n + x)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    lines = [f"{a} {b} {a * b % 7}" for a, b in zip(x.ravel(), y.ravel())] + [f"3 {a} {b} {c}" for a, b, c in faces]
    header = f"""ply
format ascii 1.0
element vertex {n * n}
property float x
property float y
property float z
element face {len(faces)}
property list uchar int vertex_indices
end_header
"""
    (tmp_path / "grid.ply").write_text(header + "\n".join(lines) + "\n")
    shape = '<shape type="ply"><string name="filename" value="grid.ply"/></shape>'
    text = f'<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"/>{shape * 200}</scene>'
    (tmp_path / "scene.xml").write_text(text)
    for load in (lambda: rg.load(tmp_path / "scene.xml"), lambda: rg.load_string(text, base=tmp_path)):
        ends_with_ctrl_c(load)


def test_progress_is_told_and_may_stop(room: rg.Scene) -> None:
    parts: list[float] = []
    room.render(spp=2048, progress=parts.append)
    assert parts == sorted(parts) and parts[-1] == 1.0 and 0.0 <= parts[0]

    class Enough(Exception):
        pass

    def stop(part: float) -> None:
        raise Enough

    start = time.monotonic()
    with pytest.raises(Enough):
        room.render(spp=ENDLESS, progress=stop)
    assert time.monotonic() - start < 1.0
    with pytest.raises(TypeError):
        room.render(spp=2048, progress=3)


def test_other_threads_run_meanwhile(room: rg.Scene) -> None:
    ticks = []

    def tick() -> None:
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.01)

    done = threading.Event()
    ticker = threading.Thread(target=tick)
    ticker.start()
    errors = []

    def change() -> None:
        time.sleep(0.2)
        try:
            room["left.reflectance.value"] = 0.1
        except RuntimeError as e:
            errors.append(str(e))

    changer = threading.Thread(target=change)
    changer.start()
    start = time.monotonic()

    def until(part: float) -> None:
        # Reading is allowed meanwhile.
        assert len(room["left.reflectance.value"]) == 3
        if time.monotonic() - start > 0.6:
            raise TimeoutError

    with pytest.raises(TimeoutError):
        room.render(spp=ENDLESS, progress=until)
    done.set()
    ticker.join()
    changer.join()
    assert len(ticks) > 20
    assert errors == ["the scene is being rendered, and cannot be changed meanwhile"]


def test_threads_may_render_at_the_same_time(room: rg.Scene) -> None:
    expected = room.render(spp=4, seed=7)
    found = []
    threads = [threading.Thread(target=lambda: found.append(room.render(spp=4, seed=7))) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(found) == 4
    for image in found:
        np.testing.assert_array_equal(image, expected)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes are forked here")
def test_forked_processes_say_so_instead_of_waiting(tmp_path) -> None:
    code = """
import os, sys, warnings
warnings.simplefilter("ignore")
import render_gradients as rg
scene = rg.room(8, 8)
scene.render(spp=1)
child = os.fork()
if child == 0:
    try:
        scene.render(spp=1)
    except RuntimeError as e:
        os._exit(0 if "forked" in str(e) else 1)
    os._exit(2)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", code], timeout=60, check=False)
    assert done.returncode == 0


def test_the_number_of_threads_changes_no_bit() -> None:
    code = """
import sys, numpy as np, render_gradients as rg
scene = rg.room(24, 24)
image = scene.render(spp=8)
gradient = scene.backward(image, spp=8)
sys.stdout.buffer.write(image.tobytes() + b"".join(np.asarray(gradient[k]).tobytes() for k in sorted(gradient)))
"""

    def output(threads: int) -> bytes:
        env = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
        return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=True).stdout

    assert output(1) == output(3) != b""
