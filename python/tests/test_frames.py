"""Arrays are those of the files of the command line; errors, threads, processes and memory."""

from __future__ import annotations

import gc
import io
import json
import pickle
import re
import threading
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import regolith_render as rr
from conftest import ADAPTER, program, python

SETTINGS: dict[str, dict[str, Any]] = {
    "nominal stage": {},
    "lens, Bayer sensor, edges": {"preset": "train_full", "set": {"camera.k1": -0.1, "sensor.kind": "bayer"}, "edges": "ignore:2"},
    "surface preset, compute passes": {"preset": "surface_train_full", "raster": "compute"},
    "surface stage, lens, sensor, one sample, device": {
        "stage": "surface",
        "samples": 1,
        "raster": "device",
        "set": {"camera.k1": -0.15, "camera.p1": 0.01, "sensor.kind": "mono"},
    },
}
"""Both stages, lenses, sensors, edges, samples, and every raster backend."""
FRAMES = 5
"""Of each: 20 seeds in all."""


def words(settings: dict[str, Any]) -> list[str]:
    """The options of the command line for these settings."""
    options: list[str] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            for knob, setting in value.items():
                options += ["--set", f"{knob}={setting}"]
        else:
            options += [f"--{name}", str(value)]
    return options


def stored(file: Path) -> np.ndarray:
    """The array of a file."""
    if file.suffix == ".npy":
        return np.load(file)
    if file.suffix == ".exr":
        openexr = pytest.importorskip("OpenEXR", reason="there is nothing to read the file with")
        with openexr.File(str(file)) as opened:
            return np.asarray(opened.channels()["RGB"].pixels)
    return np.asarray(Image.open(file))


def assert_same(array: np.ndarray, expected: np.ndarray, what: str) -> None:
    assert array.dtype == expected.dtype and array.shape == expected.shape, what
    assert array.tobytes() == expected.tobytes(), what


def owner(array: np.ndarray) -> object:
    """What keeps the memory of an array."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array.base


@pytest.mark.parametrize("name", SETTINGS)
def test_arrays_are_those_of_the_files(name: str, tmp_path: Path) -> None:
    """Every output; a dataset's frames are those of their seeds, and so are the files of the command for one frame."""
    settings, base_seed = SETTINGS[name], 40 + list(SETTINGS).index(name)
    options = ["--size", "64x48", "--outputs", "all", *words(settings)]
    made = program("dataset", "--count", str(FRAMES), "--seed", str(base_seed), *options, "--out", str(tmp_path / "d"))
    assert made.returncode == 0, made.stderr
    records = [json.loads(line) for line in (tmp_path / "d" / "frames.jsonl").read_text().splitlines()]
    assert len({record["seed"] for record in records}) == FRAMES
    with rr.Renderer(size=(64, 48), outputs=rr.outputs(), adapter=ADAPTER, **settings) as renderer:
        for record in records:
            frame = renderer.render(record["seed"])
            files = {file.stem.rsplit("_", 1)[0]: file for file in (tmp_path / "d").glob(f"*/*_{record['index']:05}.*")}
            assert set(frame) - {"preview"} == {stem for stem, file in files.items() if file.suffix != ".json"} - {"preview"}
            for array_name, array in frame.items():
                if array_name == "preview":  # few frames of a dataset have one
                    continue
                assert_same(array, stored(files[array_name]), f"{array_name} of seed {record['seed']}")
                assert array.flags.c_contiguous and array.flags.writeable
                assert owner(array) not in (owner(other) for key, other in frame.items() if key != array_name)
            assert {key: frame.meta[key] for key in ("seed", "knobs", "camera", "sun", "geometry_hash")} == {
                key: record[key] for key in ("seed", "knobs", "camera", "sun", "geometry_hash")
            }
            mapping = json.loads(files["instance_segmentation_mapping"].read_text())
            assert frame.rocks == {int(instance): rock for instance, rock in mapping.items()}

        seed = records[0]["seed"]
        ran = program("--seed", str(seed), *options, "--out", str(tmp_path / "one"))
        assert ran.returncode == 0, ran.stderr
        frame = renderer.render(seed)
        for array_name, array in frame.items():
            stem = "semantic_segmentation" if array_name == "mask" else array_name
            (file,) = (file for file in (tmp_path / "one").glob(f"{stem}_0000.*") if file.suffix != ".json")
            assert_same(array, stored(file), f"{array_name} of seed {seed}, alone")
        meta, record = dict(frame.meta), json.loads((tmp_path / "one" / "frame_0000.json").read_text())
        assert meta.pop("ms") and record.pop("ms") and meta == record


def test_arrays_say_what_they_are() -> None:
    """The table of the documentation is that of the library, and shapes are known before a device is opened."""
    page = (Path(__file__).parents[2] / "docs" / "python.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", page, flags=re.MULTILINE))
    for output in rr.outputs():
        described = rr.Renderer(size=(6, 4), outputs=output).arrays()
        assert output in rows and all(f"`{name}`" in rows[output] for name in described), output
        for name, (shape, dtype) in described.items():
            channels = f", {shape[2]}" if len(shape) == 3 else ""
            assert f"(H, W{channels}) {dtype}" in rr.Frame.__doc__.split(f"- `{output}`:")[1].split("\n    - ")[0], name
            assert shape[:2] == (4, 6)


def test_arrays_are_shared_without_a_copy(renderer: rr.Renderer) -> None:
    frame = renderer.render(3)
    for array in frame.values():
        assert array.__dlpack_device__() == (1, 0)
        shared = np.from_dlpack(array)
        assert shared.__array_interface__["data"][0] == array.__array_interface__["data"][0]
        array[0] = 7
        assert (shared[0] == 7).all()


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
    before = {name: array.__array_interface__["data"][0] for name, array in batch.items()}
    same = renderer.batch([5, 5, 5], out=batch)
    assert same is batch and np.array_equal(batch["rgb"][0], frames[4]["rgb"])
    assert before == {name: array.__array_interface__["data"][0] for name, array in batch.items()}
    assert list(renderer.frames([])) == [] and renderer.batch([])["mask"].shape == (0, 64, 64)


def test_seeds_may_have_no_end(renderer: rr.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("regolith_render._renderer.SEEDS_AHEAD", 3)
    read: list[int] = []
    endless = renderer.frames(read.append(seed) or seed for seed in count(5))
    assert [next(endless).meta["seed"] for _ in range(8)] == list(range(5, 13))
    endless.close()
    assert read[:8] == list(range(5, 13)) and len(read) < 16
    assert [frame.meta["seed"] for frame in renderer.frames(np.arange(4))] == [0, 1, 2, 3]


@pytest.mark.parametrize("preset", ["train_dr", "surface_train_full", "pcam"])
def test_a_record_repeats_its_frame(preset: str) -> None:
    """With both azimuths of the sun, of which one is computed."""
    for seed, sun in ((5, {}), (6, {"sun.azimuth_deg": 300.7}), (7, {"sun.relative_azimuth_deg": -100})):
        frame = rr.Renderer(preset, size=32, adapter=ADAPTER, set=sun).render(seed)
        again = rr.Renderer(size=32, adapter=ADAPTER, set=frame.meta["knobs"]).render(seed)
        assert again == frame and again.meta["knobs"] == frame.meta["knobs"], seed


def test_a_stream_reads_few_seeds_before_its_first_frame(renderer: rr.Renderer) -> None:
    read: list[int] = []
    endless = renderer.frames(read.append(seed) or seed for seed in count())
    assert len(read) == 16 and next(endless).meta["seed"] == 0
    assert [next(endless).meta["seed"] for _ in range(20)] == list(range(1, 21)) and len(read) == 48
    endless.close()


def test_a_stream_gives_free_memory_back(renderer: rr.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every so many frames and at its end, also across the streams that follow one another beneath it."""
    taken, released = 0, []
    monkeypatch.setattr("regolith_render._renderer.SEEDS_AHEAD", 4)
    monkeypatch.setattr("regolith_render._stream.FRAMES_BETWEEN_RELEASES", 3)
    monkeypatch.setattr("regolith_render._stream.release_memory", lambda: released.append(taken))
    for _ in renderer.frames(range(8)):
        taken += 1
    assert released == [3, 6, 8]


def test_frames_are_values(renderer: rr.Renderer) -> None:
    frame = renderer.render(4)
    copy = pickle.loads(pickle.dumps(frame))
    assert copy == frame and copy.meta == frame.meta and copy["rgb"].flags.writeable
    assert frame != renderer.render(5) and frame != 3
    copy["mask"][0, 0] ^= 1
    assert copy != frame
    assert "seed=4" in repr(frame) and "rgb uint8[64, 64, 3]" in repr(frame)
    assert repr(renderer).startswith("Renderer(preset='train_dr', size=(64, 64)")


def test_a_renderer_shows_its_settings(tmp_path: Path) -> None:
    """As the call that makes it again."""
    assert repr(rr.Renderer()) == "Renderer(preset=None, size=(512, 512), outputs='rgb,mask', samples=4)"
    file = tmp_path / "knobs.toml"
    file.write_text("rocks.count = 3")
    knobs = {"sun.elevation_deg": {"uniform": (np.float32(5), 40)}, "camera.k1": np.int64(0), "sensor.kind": "mono"}
    made = rr.Renderer(["train_full", "sun_polar"], config=file, set=knobs, size=(4, 3), edges="ignore:1", raster="host", threads=2)
    shown = repr(made)
    assert "set={'sun.elevation_deg': {'uniform': [5.0, 40]}, 'camera.k1': 0, 'sensor.kind': 'mono'}" in shown
    assert repr(eval(shown, {"Renderer": rr.Renderer})) == shown == repr(pickle.loads(pickle.dumps(made)))
    for setting in ("preset='train_full,sun_polar'", f"config={str(file)!r}", "edges='ignore:1'", "raster='host'", "threads=2"):
        assert setting in shown
    assert repr(rr.Renderer(stage="surface", adapter="cpu")).endswith("stage='surface', adapter='cpu')")


def test_an_export_is_a_whole_file_or_leaves_the_one_before(tmp_path: Path) -> None:
    ran = python(
        f"""
        import os, resource, sys, regolith_render as rr
        os.chdir(sys.argv[1])
        scene = rr.Renderer(size=16, adapter={ADAPTER!r}).scene(3)
        scene.export(b"new/moon.npz")
        before = open("new/moon.npz", "rb").read()
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, resource.RLIM_INFINITY))
        try:
            scene.export("new/moon.npz", drawn=True)
        except OSError as error:
            assert "new/moon.npz" in str(error) and "--" not in str(error), error
        else:
            raise AssertionError("it was written")
        assert open("new/moon.npz", "rb").read() == before and os.listdir("new") == ["moon.npz"]
        """,
        str(tmp_path),
    )
    assert ran.returncode == 0, ran.stderr
    with np.load(tmp_path / "new" / "moon.npz") as arrays:
        assert "vertices" in arrays


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
        assert abs(scene.ground_height(5e5, 0.0) - scene.ground_height(9e5, 0.0)) < 0.01  # of the border
        mesh = scene.mesh()
        assert mesh["triangles"].max() < len(mesh["vertices"]) and mesh["vertices"].dtype == np.float32


@pytest.mark.parametrize("raster", ["host", "compute"])
@pytest.mark.parametrize("stage", ["nominal", "surface"])
def test_frames_of_poses_equal_single_ones(stage: str, raster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Across the streams that follow one another beneath them; cameras move, suns alone move, and nothing does."""
    monkeypatch.setattr("regolith_render._scene.POSES_AHEAD", 4)
    renderer = rr.Renderer(stage=stage, size=(56, 40), outputs=["rgb", "mask", "depth"], raster=raster, adapter=ADAPTER)
    scene = renderer.scene(7)
    eyes = [(x, -85.0, scene.ground_height(x, -85.0) + 1.6) for x in (0.0, 2.0, 4.0)]
    poses: list[Any] = [(rr.Camera(eye, yaw_deg=5.0 * turn), None) for turn, eye in enumerate(eyes)]
    poses += [rr.Camera(pitch_deg=-15), (None, rr.Sun(azimuth_deg=300)), (None, None), (rr.Camera(eyes[1]), rr.Sun(elevation_deg=9))]
    frames = list(scene.frames(iter(poses), prefetch=3))
    assert len(frames) == len(poses)
    for pose, frame in zip(poses, frames, strict=True):
        alone = scene.render(pose) if isinstance(pose, rr.Camera) else scene.render(*pose)
        for name in alone:
            assert_same(frame[name], alone[name], f"{name} of {pose}")
        meta, expected = dict(frame.meta), dict(alone.meta)
        assert meta.pop("ms") and expected.pop("ms") and meta == expected
    assert list(scene.frames([])) == []


def test_a_wrong_pose_is_refused_when_it_is_read() -> None:
    scene = rr.Renderer(size=32, adapter=ADAPTER).scene(3)
    for wrong, message in [(3, "poses"), ([rr.Sun()], "pose"), ([(rr.Camera(), 3)], "sun"), ([rr.Camera(fov_deg=900)], "camera.fov_deg")]:
        with pytest.raises(rr.ConfigError, match=message):
            scene.frames(wrong)  # type: ignore[arg-type]
    endless = scene.frames(rr.Camera(yaw_deg=float(turn % 360)) for turn in count())
    assert next(endless)["mask"].shape == (32, 32)
    endless.close()


def test_tables() -> None:
    assert any("llvmpipe" in adapter.name or adapter.kind for adapter in rr.adapters())
    by_name = {knob.name: knob for knob in rr.knobs("surface")}
    assert by_name["rocks.coverage"].low == 0.0 and by_name["sun.elevation_deg"].unit == "deg"
    assert "hapke" in by_name["photometry.law"].allowed
    assert "train_dr" in {preset.name for preset in rr.presets()}
