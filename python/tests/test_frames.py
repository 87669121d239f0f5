"""Arrays are those of the files of the command line; errors, threads, processes and memory."""

from __future__ import annotations

import gc
import io
import pickle
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import regolith_render as rr
from conftest import ADAPTER, program

SETTINGS: list[dict[str, object]] = [
    {},
    {"preset": "surface_train_full"},
    {"preset": "train_full", "set": {"camera.k1": -0.1, "sensor.kind": "bayer"}, "edges": "ignore:2"},
    {"stage": "surface", "samples": 1, "raster": "device"},
]
"""Both stages, a lens, sensors, edges, samples, and both raster backends."""


def words(settings: dict[str, object]) -> list[str]:
    """The options of the command line for these settings."""
    options: list[str] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            for knob, setting in value.items():
                options += ["--set", f"{knob}={setting}"]
        else:
            options += [f"--{name}", str(value)]
    return options


def stored(folder: Path, name: str) -> np.ndarray:
    """An array as its file of a single frame holds it."""
    stem = "semantic_segmentation" if name == "mask" else name
    (file,) = folder.glob(f"{stem}_0000.*")
    return np.load(file) if file.suffix == ".npy" else np.asarray(Image.open(file))


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: " ".join(words(settings)) or "nominal")
def test_arrays_are_those_of_the_files(settings: dict[str, object], tmp_path: Path) -> None:
    outputs = [name for name in rr.outputs() if name not in ("meta", "hdr")]
    with rr.Renderer(size=(72, 56), outputs=outputs, adapter=ADAPTER, **settings) as renderer:  # type: ignore[arg-type]
        for seed in range(1, 6):
            frame = renderer.render(seed)
            out = tmp_path / str(seed)
            listed = ",".join([*outputs, "meta"])
            ran = program("--seed", str(seed), "--size", "72x56", "--outputs", listed, "--out", str(out), *words(settings))
            assert ran.returncode == 0, ran.stderr
            for name, array in frame.items():
                expected = stored(out, name)
                assert array.dtype == expected.dtype and array.shape == expected.shape, name
                assert array.tobytes() == expected.tobytes(), f"{name} of seed {seed}"
                assert array.flags.c_contiguous and array.flags.writeable
            record = rr._frame.json.loads((out / "frame_0000.json").read_text())
            meta = frame.meta
            meta.pop("ms"), record.pop("ms")
            assert meta == record


def test_radiance_is_that_of_the_file(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR", reason="there is nothing to read the file with")
    frame = rr.Renderer(size=32, outputs=["hdr"], adapter=ADAPTER).render(3)
    assert program("--seed", "3", "--size", "32", "--outputs", "hdr", "--out", str(tmp_path)).returncode == 0
    with openexr.File(str(tmp_path / "hdr_0000.exr")) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, frame["hdr"])


def test_a_frame_names_what_it_has(renderer: rr.Renderer) -> None:
    frame = renderer.render(4, set={"sun.elevation_deg": 12})
    assert list(frame) == ["rgb", "mask"] == list(renderer.arrays())
    assert frame.meta["seed"] == 4 and frame.meta["sun"]["elevation_deg"] == 12
    assert set(np.unique(frame["mask"])) <= {*rr.CLASSES.values(), rr.IGNORE}
    with pytest.raises(KeyError, match="outputs"):
        frame["depth"]
    html = frame._repr_html_()
    assert html.count("data:image/png;base64,") == 2 and "rock" in html
    assert np.asarray(Image.open(io.BytesIO(rr._frame._png(frame["rgb"])))).tobytes() == frame["rgb"].tobytes()
    deep = rr.Renderer(size=32, outputs="depth,instances", adapter=ADAPTER).render(2)
    assert deep["depth"] is deep["distance_to_image_plane"] and deep["instances"].dtype == np.uint16
    assert deep.rocks and all(rock["visible_px"] > 0 for rock in deep.rocks.values())


def test_frames_come_in_order_and_equal_single_ones(renderer: rr.Renderer) -> None:
    seeds = [9, 2, 2, 2**64 - 1, 5]
    frames = list(renderer.frames(seeds, prefetch=3))
    assert [frame.meta["seed"] for frame in frames] == seeds
    for frame in frames:
        alone = renderer.render(frame.meta["seed"])
        assert np.array_equal(frame["rgb"], alone["rgb"]) and np.array_equal(frame["mask"], alone["mask"])
    batch = renderer.batch(seeds[:3])
    assert batch["rgb"].shape == (3, 64, 64, 3) and np.array_equal(batch["mask"][1], frames[1]["mask"])
    same = renderer.batch([5, 5, 5], out=batch)
    assert same is batch and np.array_equal(batch["rgb"][0], frames[4]["rgb"])


def test_frames_of_a_dataset_are_its_frames(tmp_path: Path) -> None:
    out = tmp_path / "d"
    made = program("dataset", "--preset", "train_full", "--size", "48", "--count", "5", "--seed", "8", "--out", str(out))
    assert made.returncode == 0, made.stderr
    renderer = rr.Renderer(preset="train_full", size=48, adapter=ADAPTER)
    for index, frame in enumerate(renderer.dataset_frames(8, end=5)):
        assert frame.meta["index"] == index
        for name in ("rgb", "mask"):
            assert np.array_equal(frame[name], np.asarray(Image.open(out / name / f"{name}_{index:05}.png")))
    every_other = [frame.meta["index"] for frame in renderer.dataset_frames(8, first=1, step=2, end=5)]
    assert every_other == [1, 3]


def test_the_package_runs_the_command_line() -> None:
    version = program("--version")
    assert version.returncode == 0 and rr.__version__ in version.stdout
    wrong = program("--preset", "train_drr")
    assert wrong.returncode == 2 and "train_dr" in wrong.stderr and "Traceback" not in wrong.stderr
    assert program("presets" if "presets" in program("--help").stdout else "adapters").returncode == 0


def test_a_scene_is_rendered_from_poses() -> None:
    for stage in ("nominal", "surface"):
        renderer = rr.Renderer(stage=stage, size=48, outputs=["rgb", "depth"], adapter=ADAPTER)
        scene = renderer.scene(7)
        assert np.array_equal(scene.render()["rgb"], renderer.render(7)["rgb"])
        x, y = 3.0, -80.0
        position = (x, y, scene.ground_height(x, y) + 1.5)
        posed = scene.render(rr.Camera(position, yaw_deg=30, pitch_deg=-20, fov_deg=50), rr.Sun(azimuth_deg=200))
        camera = posed.meta["camera"]
        assert np.allclose(np.array(camera["world_from_camera"])[:3, 3], position, atol=1e-4)
        assert abs(camera["fov_deg"] - 50) < 1e-4 and posed.meta["sun"]["azimuth_deg"] == 200
        mesh = scene.mesh()
        assert mesh["triangles"].max() < len(mesh["vertices"]) and mesh["vertices"].dtype == np.float32


def test_errors_name_knob_value_and_what_is_allowed() -> None:
    with pytest.raises(rr.ConfigError, match=r"sun\.elevation_deg.*95") as caught:
        rr.Renderer(set={"sun.elevation_deg": 95})
    assert caught.value.knob == "sun.elevation_deg" and caught.value.value == "95" and "90" in (caught.value.allowed or "")
    with pytest.raises(rr.ConfigError, match="did you mean") as caught:
        rr.Renderer(set={"sun.elevaton_deg": 5})
    assert caught.value.nearest == "sun.elevation_deg"
    for wrong in ({"preset": "trian_dr"}, {"outputs": ["rgbd"]}, {"size": 0}, {"samples": 3}, {"edges": "soft"}):
        with pytest.raises(ValueError):
            rr.Renderer(**wrong)  # type: ignore[arg-type]
    with pytest.raises(rr.ConfigError, match="no value of a knob"):
        rr.Renderer(set={"sun.elevation_deg": object()})
    with pytest.raises(rr.NoAdapterError, match="Voodoo"):
        rr.Renderer(adapter="Voodoo").render(1)
    with pytest.raises(OverflowError):
        rr.Renderer(size=32, adapter=ADAPTER).render(-1)


def test_tables() -> None:
    assert any("llvmpipe" in adapter.name or adapter.kind for adapter in rr.adapters())
    by_name = {knob.name: knob for knob in rr.knobs("surface")}
    assert by_name["rocks.coverage"].low == 0.0 and by_name["sun.elevation_deg"].unit == "deg"
    assert "hapke" in by_name["photometry.law"].allowed
    assert "train_dr" in {preset.name for preset in rr.presets()}


def test_objects_are_dropped_in_any_order_and_used_from_threads() -> None:
    first, second = (rr.Renderer(size=32, adapter=ADAPTER) for _ in range(2))
    expected = first.render(3)["rgb"]
    scene, frames = first.scene(3), first.frames(range(100))
    next(frames)
    first.close()
    del first
    gc.collect()
    next(frames)
    del frames
    assert np.array_equal(scene.render()["rgb"], expected)
    found: list[np.ndarray] = []
    threads = [threading.Thread(target=lambda: found.append(second.render(3)["rgb"])) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and all(np.array_equal(rgb, expected) for rgb in found)
    array = second.render(5)["mask"]
    del second
    gc.collect()
    assert array.max() <= 255


def test_a_renderer_pickles_as_its_settings() -> None:
    renderer = rr.Renderer(preset="train_dr", size=32, adapter=ADAPTER, set={"rocks.count": 20})
    before = renderer.render(6)
    assert before.meta["knobs"]["rocks.count"] == 20
    copy = pickle.loads(pickle.dumps(renderer))
    assert np.array_equal(copy.render(6)["rgb"], before["rgb"])


def python(text: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(text)]
    return subprocess.run(command, env={**rr._renderer.os.environ, **environment}, capture_output=True, text=True, timeout=120)


def test_a_fork_never_hangs() -> None:
    ran = python(
        f"""
        import multiprocessing, numpy, regolith_render as rr
        context = multiprocessing.get_context("fork")
        fresh = rr.Renderer(size=32, adapter={ADAPTER!r})
        def mean(renderer):
            try:
                return float(renderer.render(4)["rgb"].mean())
            except rr.DeviceError as error:
                return str(error)
        def child(renderer, pipe):
            pipe.send(mean(renderer))
        def in_child(renderer):
            mine, theirs = context.Pipe()
            process = context.Process(target=child, args=(renderer, theirs))
            process.start()
            answer = mine.recv()
            process.join(30)
            assert process.exitcode == 0, process.exitcode
            return answer
        of_child = in_child(fresh)
        assert isinstance(of_child, float), of_child
        assert mean(fresh) == of_child
        refused = in_child(fresh)
        assert "forked" in refused, refused
        """
    )
    assert ran.returncode == 0, ran.stderr


def test_without_a_driver_the_import_works_and_the_first_use_says_what_to_install() -> None:
    ran = python(
        """
        import regolith_render as rr
        try:
            rr.Renderer().render(1)
        except rr.NoAdapterError as error:
            print(error)
        """,
        VK_DRIVER_FILES="/nowhere.json",
        VK_ICD_FILENAMES="/nowhere.json",
        WGPU_BACKEND="vulkan",
    )
    assert ran.returncode == 0 and "mesa-vulkan-drivers" in ran.stdout, ran.stdout + ran.stderr


def test_memory_is_flat() -> None:
    ran = python(
        f"""
        import regolith_render as rr
        def resident_mib():
            with open("/proc/self/status") as status:
                return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024
        renderer = rr.Renderer(preset="train_dr", size=256, adapter={ADAPTER!r})
        after = []
        for number, frame in enumerate(renderer.frames([number % 50 for number in range(400)])):
            kept_mib = sum(array.nbytes for array in frame.values()) / 2**20
            if number % 100 == 99:
                after.append(resident_mib())
        print(after, kept_mib)
        # Each thread's allocator keeps the largest scenes it met, some 20 MiB in all. If a third of the frames stayed, it would be more.
        assert after[3] - after[0] < 300 * kept_mib / 3, (after, kept_mib)
        """
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
