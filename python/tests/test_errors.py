"""Errors name what is wrong and what is allowed; none is a panic, and none takes the process with it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import regolith_render as rr
from conftest import ADAPTER, program, python

ENDLESS: list[Any] = []
ENDLESS.append(ENDLESS)
SETTINGS: list[tuple[dict[str, Any], str]] = [
    ({"preset": "trian_dr"}, r"unknown preset `trian_dr` \(did you mean `train_dr`\?\)"),
    ({"preset": 3}, "preset = 3"),
    ({"preset": "train_dr", "stage": "surface"}, "stage"),
    ({"stage": "mars"}, "mars.*nominal, surface"),
    ({"stage": 3}, "stage = 3"),
    ({"outputs": ["rgbd"]}, r"outputs: unknown output `rgbd` \(did you mean `rgb`\?\)"),
    ({"outputs": []}, r"outputs = \[\]: at least one name is expected, of rgb, mask"),
    ({"outputs": " , "}, "outputs = ' , '"),
    ({"outputs": None}, "outputs = None"),
    ({"outputs": [3]}, r"outputs = \[3\]"),
    ({"size": 0}, "size = 0"),
    ({"size": (64, -1)}, "size = -1"),
    ({"size": 64.5}, "size = 64.5"),
    ({"size": "64x64"}, "size = '64x64'"),
    ({"size": (1, 2, 3)}, "width, height"),
    ({"size": 2**40}, "size"),
    ({"samples": 3}, "samples = 3: 1, 4 or 16 is expected"),
    ({"samples": -4}, "samples = -4"),
    ({"samples": None}, "samples = None"),
    ({"edges": "soft"}, "edges = soft: allowed are hard, and ignore:N with N from 1 to 64"),
    ({"edges": None}, "edges = None: a text is expected"),
    ({"raster": "gpu"}, "raster = gpu: allowed are auto, device, compute, host"),
    ({"threads": 0}, "threads = 0"),
    ({"threads": 10**6}, "threads = 1000000"),
    ({"adapter": 0}, "adapter = 0"),
    ({"set": {"sun.elevation_deg": object()}}, "no value of a knob"),
    ({"set": {"sun.elevation_deg": None}}, "no value of a knob"),
    ({"set": {"sun.elevation_deg": float("nan")}}, "sun.elevation_deg"),
    ({"set": {"sun.elevation_deg": "high"}}, "sun.elevation_deg"),
    ({"set": {"sun.elevation_deg": {"unifrom": [5, 40]}}}, "sun.elevation_deg"),
    ({"set": {"rocks.count": 2**63}}, "rocks.count = 9.22.* is out of range|rocks.count = 9.22.* whole number"),
    ({"set": {"rocks.count": -(10**30)}}, "rocks.count = -1e30"),
    ({"set": {"rocks.count": 10**400}}, "rocks.count = 10000.*: a number within the range of the knob"),
    ({"set": {"a b\nc": 1}}, "unknown knob"),
    ({"set": ["sun.elevation_deg"]}, "mapping of knobs"),
    ({"set": {"photometry.law": "\U0001f600"}}, "photometry.law.*\U0001f600.*lambert"),
    ({"set": {"photometry.law": "hap\x7fke"}}, "photometry.law"),
    ({"set": {"photometry.law": "\ud800"}}, "lone surrogates"),
    ({"preset": "\ud800"}, "preset = .* lone surrogates"),
    ({"stage": "\ud800"}, "stage = .* lone surrogates"),
    ({"outputs": ["rgb", "\ud800"]}, "outputs = .* lone surrogates"),
    ({"edges": "\ud800"}, "edges = .* lone surrogates"),
    ({"raster": "\ud800"}, "raster = .* lone surrogates"),
    ({"adapter": "\ud800"}, "adapter = .* lone surrogates"),
    ({"config": "\ud800"}, "config = "),
    ({"set": {"rocks.scale_m": [[1], [2, 3]]}}, "rocks.scale_m"),
    ({"set": {"rocks.scale_m": ENDLESS}}, "finite depth"),
    ({"size": [[1], [2, 3]]}, r"size = \[1\]"),
    ({"size": True}, "size = True"),
    ({"set": {"sun.azimuth_deg": 3.0, "sun.relative_azimuth_deg": 5.0, "camera.yaw_deg": 1.0}}, "contradict"),
    ({"size": {128, 64}}, "size = {"),
    ({"adapter": ""}, "adapter = '': a part of a name"),
    ({"samples": True}, "samples = True"),
    ({"config": 3}, "config = 3"),
    ({"config": b"/x"}, "config = b'/x'"),
]


@pytest.mark.parametrize(("settings", "says"), SETTINGS, ids=[str(row[0]) for row in SETTINGS])
def test_wrong_settings_are_named_before_a_device_is_opened(settings: dict[str, Any], says: str) -> None:
    with pytest.raises(rr.ConfigError, match=says) as caught:
        rr.Renderer(**settings)
    assert not str(caught.value).startswith("--")
    assert all(hasattr(caught.value, name) for name in ("knob", "value", "allowed", "nearest"))


def test_an_error_names_the_nearest_word() -> None:
    for settings, knob, nearest in [
        ({"set": {"photometry.law": "hapk"}}, "photometry.law", "hapke"),
        ({"stage": "surfac"}, "stage.name", "surface"),
        ({"set": {"snu": 3}}, "snu", "sun"),
        ({"edges": "hrad"}, None, "hard"),
        ({"raster": "comput"}, None, "compute"),
    ]:
        with pytest.raises(rr.ConfigError, match=f"did you mean `{nearest}`") as caught:
            rr.Renderer(**settings)  # type: ignore[arg-type]
        assert (caught.value.knob, caught.value.nearest) == (knob, nearest)
        assert "mean" not in str(caught.value.allowed)
    with pytest.raises(rr.ConfigError, match="stage = surfac: allowed are nominal, surface .did you mean `surface`") as caught:
        rr.knobs("surfac")
    assert (caught.value.value, caught.value.nearest) == ("surfac", "surface")
    with pytest.raises(rr.ConfigError, match="lone surrogates"):
        rr.knobs("\ud800")


def test_an_argument_is_named_with_what_is_allowed() -> None:
    for settings, value, allowed in [
        ({"samples": 3}, "3", "1, 4 or 16"),
        ({"outputs": []}, "[]", "rgb, mask"),
        ({"edges": "hrad"}, "hrad", "ignore:N"),
        ({"raster": "comput"}, "comput", "auto, device, compute, host"),
    ]:
        with pytest.raises(rr.ConfigError) as caught:
            rr.Renderer(**settings)  # type: ignore[arg-type]
        assert caught.value.value == value and allowed in str(caught.value.allowed)
    with pytest.raises(rr.ConfigError, match="size = an integer of too many digits: a whole number"):
        rr.Renderer(size=10**5000)


def test_a_broken_rule_is_named_with_its_knob(tmp_path: Path) -> None:
    """The command line speaks of its folder, the package has none."""
    for rule, knob in [({"rules.lit_min": 1}, "rules.lit_min"), ({"require.rock": [0.99, 1]}, "rules.require")]:
        renderer = rr.Renderer("train_dr", size=16, samples=1, set={"rules.attempts_max": 2, **rule}, adapter=ADAPTER)
        with pytest.raises(rr.ConfigError, match="drawn 2 times .*; loosen the rule or change the knobs$") as caught:
            list(renderer.dataset_frames(1, end=1))
        assert caught.value.knob == knob and "folder" not in str(caught.value)
        assert 0 <= float(caught.value.value or "none") < 0.99 and f"{caught.value.value} " in str(caught.value)
    knobs = ["--set=rules.lit_min=1", "--set=rules.attempts_max=2"]
    ran = program("dataset", "--size=16", "--samples=1", "--count=1", *knobs, "--out", str(tmp_path / "d"))
    assert ran.returncode == 1 and "so choose another --out with the new settings" in ran.stderr, ran.stderr


def test_a_file_of_knobs_may_have_a_name_that_is_no_text(tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"knobs\xff.toml")
    file.write_text("sun.elevation_deg = 11")
    assert "knobs\ufffd.toml" in repr(rr.Renderer(config=file))
    file.write_text("sun.elevation_deg = 95")
    with pytest.raises(rr.ConfigError, match="knobs\ufffd.toml"):
        rr.Renderer(config=file)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    file = tmp_path / "knobs.toml"
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(rr.ConfigError, match="knobs.toml"):
        rr.Renderer(config=file)


def read_only(batch: dict[str, Any]) -> dict[str, Any]:
    for array in batch.values():
        array.flags.writeable = False
    return batch


CALLS: list[tuple[Callable[[rr.Renderer], object], str]] = [
    (lambda renderer: renderer.render(-1), "seed = -1"),
    (lambda renderer: renderer.render(2**64), "seed = 18446744073709551616.*0 to 18446744073709551615"),
    (lambda renderer: renderer.render("7"), "seed = '7'"),  # type: ignore[arg-type]
    (lambda renderer: renderer.render(1.0), "seed = 1.0"),  # type: ignore[arg-type]
    (lambda renderer: renderer.render(1, set={"sun.elevation_deg": 95}), "sun.elevation_deg = 95"),
    (lambda renderer: renderer.frames([3, -1]), "seed = -1"),
    (lambda renderer: renderer.frames(7), "seeds = 7"),  # type: ignore[arg-type]
    (lambda renderer: renderer.frames([1], prefetch=0), "prefetch = 0"),
    (lambda renderer: renderer.frames([1], prefetch=10**15), "prefetch = 1000000000000000"),
    (lambda renderer: renderer.dataset_frames(-1), "base_seed = -1"),
    (lambda renderer: renderer.dataset_frames(1, step=0), "step = 0"),
    (lambda renderer: renderer.dataset_frames(1, first=-1), "first = -1"),
    (lambda renderer: renderer.dataset_frames(1, end=2**40), "end"),
    (lambda renderer: renderer.batch([1, -2]), "seed = -2"),
    (lambda renderer: renderer.batch([1], out={"rgb": np.zeros((1, 64, 64, 3), np.uint8)}), "out.*mask"),
    (lambda renderer: renderer.batch([1], out=renderer.batch([1, 2])), r"out.*\(1, 64, 64"),
    (lambda renderer: renderer.batch([1], out=[]), r"out = \[\].*dictionary"),  # type: ignore[arg-type]
    (lambda renderer: renderer.batch([1], out=read_only(renderer.batch([1]))), r"out\['rgb'\].*read-only"),
    (lambda renderer: renderer.scene(-5), "seed = -5"),
    (lambda renderer: renderer.scene(5, set={"rocks.cuont": 3}), "did you mean `rocks.count`"),
    (lambda renderer: renderer.scene(5).render(camera=(1, 2, 3)), "Camera is expected"),  # type: ignore[arg-type]
    (lambda renderer: renderer.scene(5).render(camera=rr.Camera((1, 2))), "position"),  # type: ignore[arg-type]
    (lambda renderer: renderer.scene(5).render(camera=rr.Camera(pitch_deg=400)), "camera.pitch_deg = 400"),
    (lambda renderer: renderer.scene(5).render(sun=rr.Sun(elevation_deg=-100)), "sun.elevation_deg = -100"),
    (lambda renderer: renderer.scene(5).render(rr.Camera(fov_deg="50")), "camera.fov_deg = '50'"),  # type: ignore[arg-type]
    (lambda renderer: renderer.scene(5).render(rr.Camera(fov_deg=True)), "camera.fov_deg = True"),
    (lambda renderer: renderer.scene(5).render(rr.Camera(position=(1, 2, b"3"))), "position = b'3'"),  # type: ignore[arg-type]
    (lambda renderer: renderer.scene(5).render(sun=rr.Sun(azimuth_deg=10**400)), "sun.azimuth_deg = 1000"),
    (lambda renderer: renderer.scene(5).ground_height(float("nan"), 0), "x_m = nan: a number from -1e\\+06 to 1e\\+06 is expected"),
    (lambda renderer: renderer.scene(5).ground_height(0, float("inf")), "y_m = inf"),
    (lambda renderer: renderer.scene(5).ground_height(1e300, 0), "x_m = 1e\\+300"),
    (lambda renderer: renderer.scene(5).ground_height("1", 0), "x_m = '1'"),  # type: ignore[arg-type]
    (lambda renderer: renderer.scene(5).export("out/moon.obj"), r"path = out/moon.obj: allowed are names that end in .npz, .glb"),
    (lambda renderer: renderer.scene(5).export(b"out/moon"), "path = out/moon:"),
    (lambda renderer: renderer.scene(5).export(3), "path = 3"),  # type: ignore[arg-type]
    (lambda renderer: renderer.render(5).overlay(45), "opacity = 45: a number from 0 to 1 is expected"),
    (lambda renderer: renderer.render(5).overlay(float("nan")), "opacity = nan"),
]


@pytest.mark.parametrize("number", range(len(CALLS)))
def test_wrong_arguments_are_named(number: int, renderer: rr.Renderer) -> None:
    call, says = CALLS[number]
    with pytest.raises(rr.ConfigError, match=says):
        call(renderer)


def test_a_call_wins_over_the_renderer() -> None:
    with rr.Renderer(set={"sun.azimuth_deg": 10}, size=16, adapter=ADAPTER) as fixed:
        record = fixed.render(7, set={"sun.relative_azimuth_deg": 90}).meta
    assert record["knobs"]["sun.relative_azimuth_deg"] == 90
    assert rr.Knob._fields[:6] == ("name", "unit", "low", "high", "default", "help")


def test_a_knob_is_named_with_value_range_and_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(rr.ConfigError, match=r"sun\.elevation_deg.*95") as caught:
        rr.Renderer(set={"sun.elevation_deg": 95})
    assert caught.value.knob == "sun.elevation_deg" and caught.value.value == "95" and "90" in (caught.value.allowed or "")
    with pytest.raises(rr.ConfigError, match="did you mean") as caught:
        rr.Renderer(set={"sun.elevaton_deg": 5})
    assert caught.value.knob == "sun.elevaton_deg" and caught.value.nearest == "sun.elevation_deg"
    with pytest.raises(rr.ConfigError) as caught:
        rr.Renderer(outputs="rgbd")
    assert caught.value.value == "rgbd" and caught.value.nearest == "rgb" and "normals" in (caught.value.allowed or "")
    with pytest.raises(FileNotFoundError, match="missing.toml"):
        rr.Renderer(config=tmp_path / "missing.toml")
    with pytest.raises(rr.ConfigError, match="stage"):
        rr.knobs("mars")
    assert issubclass(rr.ConfigError, ValueError) and issubclass(rr.DeviceError, RuntimeError)
    assert issubclass(rr.NoAdapterError, rr.DeviceError)


def test_an_unknown_adapter_is_named_with_those_there_are() -> None:
    with pytest.raises(rr.NoAdapterError, match=r"(?s)no adapter matches `Voodoo`; the adapters are:\n\w+"):
        rr.Renderer(adapter="Voodoo").render(1)
    with pytest.raises(rr.ConfigError, match="size 60000x4 .* is too large .* the limit is"):
        rr.Renderer(size=(60000, 4), samples=16, adapter=ADAPTER).render(1)


NO_DEVICE = """
    import regolith_render as rr
    renderer = rr.Renderer()
    try:
        renderer.render(1)
    except rr.NoAdapterError as error:
        print(error)
"""


def test_without_a_driver_the_import_works_and_the_first_use_says_what_to_install() -> None:
    ran = python(NO_DEVICE, VK_DRIVER_FILES="/nowhere.json", VK_ICD_FILENAMES="/nowhere.json", WGPU_BACKEND="vulkan")
    assert ran.returncode == 0 and "mesa-vulkan-drivers" in ran.stdout, ran.stdout + ran.stderr


def test_without_vulkan_at_all_the_import_works_too(tmp_path: Path) -> None:
    """Files that are no libraries stand before those of the system."""
    for name in ("libvulkan.so", "libvulkan.so.1", "libEGL.so", "libEGL.so.1"):
        (tmp_path / name).write_text("no library")
    ran = python(NO_DEVICE, LD_LIBRARY_PATH=str(tmp_path))
    assert ran.returncode == 0 and "mesa-vulkan-drivers" in ran.stdout, ran.stdout + ran.stderr


def test_a_lost_display_is_no_concern(tmp_path: Path) -> None:
    """Drivers complain of displays that are not there, on standard error, if they may look for them; the environment stays as it was."""
    ran = python(
        f"""
        import os, regolith_render as rr
        rr.adapters(), rr.Renderer(size=16, adapter={ADAPTER!r}).render(1)
        print(os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY"))
        """,
        DISPLAY=":77",
        XDG_RUNTIME_DIR="",
    )
    assert ran.stdout == ":77 None\n" and ran.stderr == ""


def test_a_module_whose_package_is_missing_is_no_attribute() -> None:
    ran = python("""
        import sys
        for package in ("torch", "ray"):
            sys.modules[package] = None
        import regolith_render as rr
        for package in ("torch", "ray"):
            assert not hasattr(rr, package)
            try:
                getattr(rr, package)
            except AttributeError as error:
                assert str(error).startswith(f"regolith_render.{package} cannot be imported: "), error
                assert isinstance(error.__cause__, ModuleNotFoundError)
            for statement in (f"import regolith_render.{package}", f"from regolith_render import {package}"):
                try:
                    exec(statement)
                except ModuleNotFoundError as error:
                    assert error.name is not None and error.name.split(".")[0] == package, error
                else:
                    raise AssertionError(statement)
    """)
    assert ran.returncode == 0, ran.stderr
