"""Lifetimes, threads, processes, signals and memory: no crash, no hang, no leak."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
import sysconfig
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import regolith_render as rr
from conftest import ADAPTER, python


def test_objects_are_dropped_in_any_order() -> None:
    first, second = (rr.Renderer(size=32, adapter=ADAPTER) for _ in range(2))
    expected = first.render(3)["rgb"]
    scene, frames, unused = first.scene(3), first.frames(range(100)), first.frames(range(100))
    next(frames)
    first.close()
    del first, unused
    gc.collect()
    next(frames)
    del frames
    assert np.array_equal(scene.render()["rgb"], expected)
    array = second.render(5)["mask"]
    with second:
        begun = second.frames(range(50))
        next(begun)
    assert next(begun).meta["seed"] == 1
    assert second.render(3)["rgb"].tobytes() == expected.tobytes()
    del second, begun
    gc.collect()
    assert array.max() <= rr.IGNORE


def test_two_renderers_and_their_streams_take_turns() -> None:
    renderers = [rr.Renderer(preset, size=32, adapter=ADAPTER) for preset in ("train_dr", "surface_train_full")]
    alone = [[renderer.render(seed) for seed in range(4)] for renderer in renderers]
    streams = [renderer.frames(range(4)) for renderer in renderers for _ in range(2)]
    for seed, frames in enumerate(zip(*streams, strict=True)):
        assert all(frame == alone[number // 2][seed] for number, frame in enumerate(frames))


def test_threads_may_share_a_renderer() -> None:
    """A thread of the pool that waited for a part of its frame once took up another call's, and then waited for itself."""
    ran = python(
        f"""
        import threading, numpy as np, regolith_render as rr
        renderer = rr.Renderer(stage="surface", size=96, samples=1, threads=2, adapter={ADAPTER!r})
        found = {{}}
        def render(number):
            for seed in range(5):
                found[number, seed] = renderer.render(seed)["rgb"]
        def stream():
            for seed, frame in enumerate(renderer.frames(range(5))):
                found["stream", seed] = frame["rgb"]
        threads = [threading.Thread(target=render, args=(number,)) for number in range(6)] + [threading.Thread(target=stream)]
        for thread in threads: thread.start()
        for thread in threads: thread.join()
        assert len(found) == 35
        assert all(np.array_equal(rgb, found["stream", seed]) for (_, seed), rgb in found.items())
        """
    )
    assert ran.returncode == 0, ran.stderr


def test_a_pickled_renderer_has_the_file_of_knobs_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "knobs.toml"
    file.write_text("sun.elevation_deg = 11")
    renderer = rr.Renderer(config=file, size=32, adapter=ADAPTER)
    pickled = pickle.dumps(renderer)
    file.unlink()
    copy = pickle.loads(pickled)
    assert copy.render(1).meta["knobs"]["sun.elevation_deg"] == 11
    nested = {"camera.fov_deg": {"uniform": [20, 30]}}
    scene = renderer.scene(1, set=nested)
    nested["camera.fov_deg"]["uniform"][1] = 90
    assert np.array_equal(pickle.loads(pickle.dumps(scene)).render()["rgb"], scene.render()["rgb"])


def test_a_renderer_and_its_scenes_pickle_as_their_settings() -> None:
    renderer = rr.Renderer(preset="train_dr", size=32, adapter=ADAPTER, set={"rocks.count": 20})
    before, scene = renderer.render(6), renderer.scene(6, set={"sun.azimuth_deg": 100})
    assert before.meta["knobs"]["rocks.count"] == 20
    pickled = pickle.dumps((renderer, scene))
    assert len(pickled) < 2000
    copy, same_scene = pickle.loads(pickled)
    assert copy.render(6) == before and repr(copy) == repr(renderer)
    assert same_scene.render() == scene.render() and same_scene.seed == 6
    with pytest.raises(TypeError, match="generator"):
        pickle.dumps(renderer.frames([1]))


FORKS = """
    import multiprocessing, threading, regolith_render as rr
    ADAPTER = {adapter!r}
    def mean(renderer):
        try:
            return float(renderer.render(4)["rgb"].mean())
        except rr.DeviceError as error:
            return str(error)
    def vertices(renderer):
        return len(renderer.scene(4).mesh()["vertices"])
    def adapters(_):
        return len(rr.adapters())
    def child(renderer, pipe, work):
        pipe.send(work(renderer))
    def in_child(method, renderer, work=mean):
        context = multiprocessing.get_context(method)
        mine, theirs = context.Pipe()
        process = context.Process(target=child, args=(renderer, theirs, work))
        process.start()
        assert mine.poll(60), "the child hangs"
        answer = mine.recv()
        process.join(30)
        assert process.exitcode == 0, process.exitcode
        return answer
    if __name__ == "__main__":
        fresh = rr.Renderer(size=32, adapter=ADAPTER)
        of_child = in_child("fork", fresh)
        assert isinstance(of_child, float), of_child
        assert mean(fresh) == of_child
        for method in ("spawn", "forkserver"):
            assert in_child(method, fresh) == of_child, method
        count = vertices(fresh)
        assert in_child("fork", rr.Renderer(size=32, adapter=ADAPTER), vertices) == count
        stop = threading.Event()
        def look():
            while not stop.is_set(): rr.adapters()
        looking = threading.Thread(target=look)
        looking.start()
        for _ in range(4):  # while a thread of the parent opens drivers
            assert in_child("fork", fresh, adapters) >= 1
        stop.set()
        looking.join()
        frames = fresh.frames(range(1000))
        next(frames)
        def take():
            for frame in frames: pass
        threading.Thread(target=take, daemon=True).start()
        for _ in range(4):  # while a thread of the parent renders
            refused = in_child("fork", fresh)
            assert "forked" in refused and "spawn" in refused, refused
            assert in_child("fork", rr.Renderer(size=32, adapter=ADAPTER)) == of_child
"""


def test_a_forked_child_opens_its_own_device_or_says_why_not(tmp_path: Path) -> None:
    script = tmp_path / "forks.py"
    script.write_text(textwrap.dedent(FORKS.format(adapter=ADAPTER)))
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr


def test_a_program_may_end_while_frames_are_rendered() -> None:
    """With a generator that was begun, one that was not, and threads that wait for a frame, render and open devices: when the graphics
    driver ends after the interpreter, none of them works with it any more. What is called at exit may render."""
    ran = python(
        f"""
        import atexit, threading, time
        from pathlib import Path
        done = [0, 0]
        @atexit.register
        def is_still():
            # Called after what was registered later, by the import below. What was done before may still be counted.
            time.sleep(0.2)
            before = list(done)
            time.sleep(1)
            names = [(thread / "comm").read_text().strip() for thread in Path("/proc/self/task").iterdir()]
            print(done == before, names.count("frames"))
            print(renderer.render(5)["mask"].shape, renderer.batch([5])["mask"].shape)

        import regolith_render as rr
        renderer = rr.Renderer(size=32, adapter={ADAPTER!r})
        begun, unused, other = renderer.frames(range(10**6)), renderer.frames(range(100)), renderer.frames(range(10**6))
        next(begun)
        def take():
            for frame in other: pass
        def render():
            while True:
                renderer.render(5)
                done[0] += 1
        def open():
            while True:
                rr.Renderer(size=32, adapter={ADAPTER!r}).render(5)
                done[1] += 1
        for work in (take, render, open):
            threading.Thread(target=work, daemon=True).start()
        time.sleep(1)
        print("end")
        """
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "end\nTrue 0\n(32, 32) (1, 32, 32)\n", "")


@pytest.mark.parametrize("what", ["stream", "renders", "batch", "command"])
def test_ctrl_c_ends_it(what: str) -> None:
    texts = {
        "stream": "for frame in renderer.frames(range(10**6)): pass",
        "renders": "while True: renderer.render(5)",
        "batch": "renderer.batch(range(10**4))",
    }
    text = f"import regolith_render as rr\nrenderer = rr.Renderer(size=64, adapter={ADAPTER!r})\nrenderer.render(1)\n"
    text += f"print('ready', flush=True)\n{texts.get(what)}"
    command = [sys.executable, "-c", text]
    if what == "command":
        command = [sys.executable, "-m", "regolith_render", "bench", "--frames=100000", "--cases=camera", "--size=64"]
    stderr = subprocess.STDOUT if what == "command" else subprocess.PIPE
    environment = {**os.environ, "WGPU_ADAPTER_NAME": ADAPTER}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True, env=environment)
    try:
        assert process.stdout is not None and process.stdout.readline()
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    finally:
        process.kill()
    if what == "command":
        assert process.returncode in (130, -signal.SIGINT)
    else:
        assert "KeyboardInterrupt" in errors and "panic" not in errors, errors


def test_a_wait_for_a_slow_frame_ends_by_ctrl_c() -> None:
    """A single large frame takes longer than anyone waits: the signal ends the wait for it."""
    ran = python(
        f"""
        import os, signal, threading, time, regolith_render as rr
        renderer = rr.Renderer(stage="surface", size=700, samples=16, adapter={ADAPTER!r})
        frames = renderer.frames(range(1000))
        at = []
        def interrupt():
            at.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)
        threading.Timer(0.2, interrupt).start()
        native = frames.gi_frame.f_locals["frames"]
        try:
            while True: native.next()
        except KeyboardInterrupt:
            assert time.monotonic() - at[0] < 1.0, time.monotonic() - at[0]
            os._exit(7)
        """
    )
    assert ran.returncode == 7, ran.stderr


def test_ctrl_c_ends_a_first_frame() -> None:
    """The signal waits when the first array of the process is made."""
    ran = python(
        f"""
        import os, signal, threading, regolith_render as rr
        renderer = rr.Renderer(stage="surface", size=700, samples=16, adapter={ADAPTER!r})
        renderer.adapter
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            renderer.render(1)
        except KeyboardInterrupt:
            os._exit(7)
        """
    )
    assert ran.returncode == 7 and "panic" not in ran.stderr.lower(), ran.stderr


def test_processes_of_a_command_import_nothing_from_the_folder_where_it_runs(tmp_path: Path) -> None:
    """`doctor` asks one for the adapters, whose names it then knows."""
    (tmp_path / "random.py").write_text("raise SystemExit(0)\n")
    script = Path(sysconfig.get_path("scripts")) / "regolith-render"
    command = [sys.executable, str(script), "doctor", "--adapter", "Voodoo"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 2 and "no adapter matches `Voodoo`" in ran.stderr, ran.stdout + ran.stderr


USAGE = """
    import gc, os
    def usage():
        "Resident memory, MiB, open files, threads."
        gc.collect()
        with open("/proc/self/status") as status:
            fields = dict(line.split(":", 1) for line in status)
        return int(fields["VmRSS"].split()[0]) / 1024, len(os.listdir("/proc/self/fd")), int(fields["Threads"])
"""


def test_memory_is_flat() -> None:
    ran = python(
        textwrap.dedent(USAGE)
        + textwrap.dedent(
            f"""
            import regolith_render as rr
            renderer = rr.Renderer(preset="train_dr", size=256, outputs="all", adapter={ADAPTER!r})
            after = []
            for number, frame in enumerate(renderer.frames([number % 50 for number in range(400)])):
                kept_mib = sum(array.nbytes for array in frame.values()) / 2**20
                if number % 90 == 89:  # the threads of the stream end with its last frames
                    after.append(usage())
            print(after, kept_mib)
            # Each thread's allocator keeps the largest scenes it met, up to 30 MiB in all. If a tenth of the frames stayed, it would be 115.
            assert after[3][0] - after[0][0] < 270 * kept_mib / 10, (after, kept_mib)
            assert after[3][1:] == after[0][1:], after
            """
        )
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_renderers_streams_and_scenes_leave_nothing_behind() -> None:
    ran = python(
        textwrap.dedent(USAGE)
        + textwrap.dedent(
            f"""
            import regolith_render as rr
            after = []
            for number in range(12):
                with rr.Renderer(size=64, outputs="all", adapter={ADAPTER!r}) as renderer:
                    renderer.render(number), renderer.scene(number).render()
                    frames = renderer.frames(range(20))
                    next(frames), renderer.frames(range(20))
                    del frames
                del renderer
                after.append(usage())
            print(after)
            assert after[11][1:] == after[5][1:], after
            assert after[11][0] - after[5][0] < 30, after
            """
        )
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_lock_of_python_is_free_while_frames_are_rendered() -> None:
    """Another thread makes steps meanwhile: far more than it could in the switches between threads."""
    renderer = rr.Renderer(stage="surface", size=160, adapter=ADAPTER)
    renderer.render(1)
    steps, running = 0, True

    def step() -> None:
        nonlocal steps
        while running:
            steps += 1
            time.sleep(0.001)

    thread = threading.Thread(target=step)
    thread.start()
    began, before = time.monotonic(), steps
    for seed in range(3):
        renderer.render(seed)
    took_s, made = time.monotonic() - began, steps - before
    running = False
    thread.join()
    assert made > 50 * took_s, (made, took_s)
