"""The renderer, scenes, and the tables of adapters, knobs, outputs and presets."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._frame import Frame

Knobs = Mapping[str, Any]
"""Values of knobs by dotted name: a number, a text, a list, or a distribution as in `{"uniform": [5, 40]}`."""


class Adapter(NamedTuple):
    """A GPU or a CPU driver that can be used."""

    name: str
    kind: str
    backend: str
    driver: str


class Knob(NamedTuple):
    """A setting of a scene: its range is in `low` and `high`, or in `allowed` if it is a text."""

    name: str
    unit: str
    low: float | None
    high: float | None
    allowed: tuple[str, ...]
    default: str
    help: str


class Preset(NamedTuple):
    """A named set of knobs."""

    name: str
    help: str


def adapters() -> list[Adapter]:
    """The adapters, best first.

    Raises NoAdapterError if there is none; the message says what to install.
    """
    return [Adapter(*row) for row in _native.adapters()]


def knobs(stage: str = "nominal") -> list[Knob]:
    """The knobs of a stage, `nominal` or `surface`."""
    return [
        Knob(name, unit, bounds[0] if bounds else None, bounds[1] if bounds else None, tuple(allowed), default, text)
        for name, unit, bounds, allowed, default, text in _native.knobs(stage)
    ]


def presets() -> list[Preset]:
    """The presets that ship with the package."""
    return [Preset(*row) for row in _native.presets()]


def outputs() -> list[str]:
    """The names that `Renderer(outputs=...)` takes."""
    return _native.outputs()


@dataclass(frozen=True)
class Camera:
    """A camera's pose. What is None stays as the scene has it.

    position: x (right), y (forward), z (up), metres, world. Angles in degrees: pitch is negative below the horizon, yaw clockwise from
    +y towards +x, roll clockwise. fov_deg is the horizontal field of view.
    """

    position: tuple[float, float, float] | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    roll_deg: float | None = None
    fov_deg: float | None = None


@dataclass(frozen=True)
class Sun:
    """The sun's place, degrees: elevation above the horizon, azimuth clockwise from +y towards +x. None stays as it is."""

    elevation_deg: float | None = None
    azimuth_deg: float | None = None


def _toml(value: object) -> str:
    """A value of a knob as TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (Sequence, np.ndarray)):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    raise _native.ConfigError(f"{value!r} ({type(value).__name__}) is no value of a knob")


def _document(set: Knobs | None) -> str:
    return "".join(f"{name} = {_toml(value)}\n" for name, value in (set or {}).items())


def _pose(camera: Camera | None, sun: Sun | None, scene: _native.Scene) -> dict[str, float]:
    pose: dict[str, float | None] = {}
    if camera is not None:
        if camera.position is not None:
            x, y, z = (float(number) for number in camera.position)
            pose |= {"camera.x_m": x, "camera.y_m": y, "camera.height_m": z - scene.ground_height(x, y)}
        pose |= {"camera.pitch_deg": camera.pitch_deg, "camera.yaw_deg": camera.yaw_deg}
        pose |= {"camera.roll_deg": camera.roll_deg, "camera.fov_deg": camera.fov_deg}
    if sun is not None:
        pose |= {"sun.elevation_deg": sun.elevation_deg, "sun.azimuth_deg": sun.azimuth_deg}
    return {name: number for name, number in pose.items() if number is not None}


class Scene:
    """A scene that is built once and rendered from many poses. `Renderer.scene` makes it; it may outlive the renderer's `with`."""

    def __init__(self, renderer: Renderer, native: _native.Scene) -> None:
        self._renderer = renderer
        self._native = native

    def render(self, camera: Camera | None = None, sun: Sun | None = None) -> Frame:
        """A frame from a pose of the camera, under a sun; what is left out stays as the scene has it.

        The nominal stage is the same geometry from every pose. The ground of the surface stage is made for the camera, and is made
        again where the camera has moved: the same craters and rocks, in the detail that this view needs.
        """
        document = _document(_pose(camera, sun, self._native))
        z = None if camera is None or camera.position is None else float(camera.position[2])
        return Frame(*self._native.render(self._renderer._engine(), document, z))

    def ground_height(self, x_m: float, y_m: float) -> float:
        """Height of the ground at a point, metres."""
        return self._native.ground_height(x_m, y_m)

    def mesh(self, drawn: bool = False) -> dict[str, NDArray[Any]]:
        """The triangles: `vertices` (N, 3) float32, metres, world; `normals` (N, 3) float32; `triangles` (M, 3) uint32;
        `triangle_class` (M,) uint8; `triangle_instance` (M,) uint16, 0 for what is no rock; and `albedo`, `world_from_camera`, `K`,
        `sun_direction`.

        drawn: only what a frame draws or lets cast shadows, in the detail that it uses.
        """
        with np.load(io.BytesIO(self._native.export("npz", drawn))) as arrays:
            return dict(arrays)

    def export(self, path: str | os.PathLike[str], drawn: bool = False) -> None:
        """Writes the scene for other software; the extension selects the format: .npz, .glb, .usda or .usdc."""
        extension = os.path.splitext(path)[1].removeprefix(".")
        data = self._native.export(extension, drawn)
        with open(path, "wb") as file:
            file.write(data)


class Renderer:
    """Renders labelled frames on one device, which is opened at first use.

    preset: a name, several with commas between them, or a list, of which later ones win; `rr.presets()` lists them.
    stage: `nominal` or `surface`; without it, that of the preset. config: a TOML file of knobs. set: values of knobs, which win over all.
    size: width and height, pixels, or one number for both. outputs: names; `rr.outputs()` lists them. samples: 1, 4 or 16 a pixel.
    adapter: a part of an adapter's name, or `cpu`; the best one without it. raster: `auto`, `device` or `host`. edges: `hard`, or
    `ignore:N` for 255 within N pixels of another class. threads: how many build scenes; as many as there are cores without it.

    Raises ConfigError for a wrong setting. Pickles as its settings; a copy opens a device of its own. It may be used from several threads.
    """

    def __init__(
        self,
        preset: str | Iterable[str] | None = None,
        *,
        stage: str | None = None,
        config: str | os.PathLike[str] | None = None,
        set: Knobs | None = None,
        size: int | tuple[int, int] = (512, 512),
        outputs: str | Iterable[str] = ("rgb", "mask"),
        samples: int = 4,
        adapter: str | None = None,
        raster: str = "auto",
        edges: str = "hard",
        threads: int | None = None,
    ) -> None:
        names = preset.split(",") if isinstance(preset, str) else list(preset or ())
        width, height = (size, size) if isinstance(size, int) else size
        self._settings_of: dict[str, Any] = {
            "stage": stage,
            "presets": [name.strip() for name in names],
            "config": config,
            "set": _document(set),
            "size": (int(width), int(height)),
            "outputs": outputs if isinstance(outputs, str) else ",".join(outputs),
            "samples": samples,
            "edges": edges,
        }
        self._device_of: dict[str, Any] = {"adapter": adapter, "raster": raster, "threads": threads}
        self._open()

    def _open(self) -> None:
        self._settings = _native.Settings(**self._settings_of)
        self._opened: tuple[int, _native.Engine] | None = None

    def _engine(self) -> _native.Engine:
        """The device of this process."""
        process = os.getpid()
        if self._opened is not None and self._opened[0] != process:
            raise _native.DeviceError(
                "this process was forked from one that had already opened the graphics device, which a fork cannot share; open it "
                "only in the workers, or start them by 'spawn' or 'forkserver' (multiprocessing_context= of a DataLoader)"
            )
        if self._opened is None:
            self._opened = (process, _native.Engine(**self._device_of))
        return self._opened[1]

    def __getstate__(self) -> dict[str, Any]:
        return {"settings": self._settings_of, "device": self._device_of}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._settings_of, self._device_of = state["settings"], state["device"]
        self._open()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Gives the device back. Another use opens it again."""
        self._opened = None

    @property
    def adapter(self) -> str:
        """The adapter in one line: name, kind, backend, driver. Opens the device."""
        return self._engine().adapter

    def arrays(self) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Shape and type of the arrays of each frame, by name. Opens no device."""
        width, height = self._settings_of["size"]
        return {
            name: ((height, width) if channels == 1 else (height, width, channels), np.dtype(dtype))
            for name, channels, dtype in self._settings.arrays()
        }

    def render(self, seed: int, set: Knobs | None = None) -> Frame:
        """The frame of a seed, 0 to 2^64 - 1, as `regolith-render --seed` writes it. set: values of knobs for this frame alone."""
        return Frame(*self._engine().render(self._settings, seed, _document(set)))

    def frames(self, seeds: Iterable[int], prefetch: int = 2) -> Generator[Frame, None, None]:
        """The frames of these seeds, in order. Scenes are built on threads and frames rendered ahead; `prefetch` finished ones wait at
        most. Closing the generator stops that."""
        engine, settings = self._engine(), self._settings
        yield from _taken(engine.frames_of_seeds(settings, [int(seed) for seed in seeds], prefetch))

    def dataset_frames(
        self, base_seed: int, first: int = 0, step: int = 1, end: int | None = None, prefetch: int = 2
    ) -> Generator[Frame, None, None]:
        """The frames `first`, `first + step`, ... below `end` of the dataset that `regolith-render dataset --seed BASE_SEED` makes, in
        order; without `end`, as many as are taken. A frame that breaks a rule of the preset is drawn again, as there."""
        engine, settings = self._engine(), self._settings
        yield from _taken(engine.frames_of_dataset(settings, base_seed, (first, step, end), prefetch))

    def batch(self, seeds: Iterable[int], out: dict[str, NDArray[Any]] | None = None) -> dict[str, NDArray[Any]]:
        """The frames of these seeds as arrays (B, H, W, ...) by name. out: arrays to fill, as an earlier call returned them."""
        listed = [int(seed) for seed in seeds]
        batch = out if out is not None else {}
        if not batch:
            batch.update({name: np.empty((len(listed), *shape), dtype) for name, (shape, dtype) in self.arrays().items()})
        for row, frame in enumerate(self.frames(listed)):
            for name, array in frame.items():
                batch[name][row] = array
        return batch

    def scene(self, seed: int, set: Knobs | None = None) -> Scene:
        """The scene of a seed, to be rendered from many poses."""
        return Scene(self, self._engine().scene(self._settings, seed, _document(set)))


def _taken(frames: _native.Frames) -> Iterator[Frame]:
    try:
        while (frame := frames.next()) is not None:
            yield Frame(*frame)
    finally:
        frames.close()
