"""A scene that is rendered from many poses."""

from __future__ import annotations

import io
import os
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._frame import Frame
from ._settings import MAX_PREFETCH, Knobs, document, number, path_of, refused, whole
from ._stream import streamed_in_parts

if TYPE_CHECKING:
    from ._renderer import Renderer

POSES_AHEAD = 256
"""How many poses `frames` reads ahead."""
MAX_COORDINATE_M = 1e6
"""Furthest from the origin that `ground_height` is asked for, metres along each axis."""


@dataclass(frozen=True)
class Camera:
    """A camera's pose. What is None stays as the scene has it.

    position: x (right), y (forward), z (up), metres, world; `Scene.ground_height` says where the ground is. Angles in degrees:
    pitch_deg is negative below the horizon, yaw_deg clockwise from +y towards +x, roll_deg clockwise. fov_deg is the horizontal field of
    view. Their ranges are those of the knobs `camera.*`: `rr.knobs()`.
    """

    position: tuple[float, float, float] | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    roll_deg: float | None = None
    fov_deg: float | None = None


@dataclass(frozen=True)
class Sun:
    """The sun's place, degrees: elevation above the horizon, azimuth clockwise from +y towards +x, each in the range of the knobs
    `sun.*`. None stays as it is."""

    elevation_deg: float | None = None
    azimuth_deg: float | None = None


def _position(camera: Camera) -> tuple[float, float, float] | None:
    if camera.position is None:
        return None
    try:
        x, y, z = camera.position
    except (TypeError, ValueError):
        raise refused("position", camera.position, "(x, y, z) in metres is expected") from None
    return number("position", x), number("position", y), number("position", z)


def _pose(camera: Camera | None, sun: Sun | None, scene: _native.Scene) -> tuple[str, float | None]:
    """The knobs that differ, as TOML, and the height of the eye, metres, world."""
    values: dict[str, Any] = {}
    eye_z_m = None
    if camera is not None:
        if not isinstance(camera, Camera):
            raise refused("camera", camera, "a regolith_render.Camera is expected")
        if (position := _position(camera)) is not None:
            x, y, eye_z_m = position
            values |= {"camera.x_m": x, "camera.y_m": y, "camera.height_m": eye_z_m - scene.ground_height(x, y)}
        values |= {f"camera.{name}": getattr(camera, name) for name in ("pitch_deg", "yaw_deg", "roll_deg", "fov_deg")}
    if sun is not None:
        if not isinstance(sun, Sun):
            raise refused("sun", sun, "a regolith_render.Sun is expected")
        values |= {"sun.elevation_deg": sun.elevation_deg, "sun.azimuth_deg": sun.azimuth_deg}
    return document({name: number(name, value) for name, value in values.items() if value is not None}), eye_z_m


def _camera_and_sun(pose: Any) -> tuple[Camera | None, Sun | None]:
    """Those of a camera alone, or of a pair."""
    if isinstance(pose, Camera):
        return pose, None
    camera: Camera | None
    sun: Sun | None
    try:
        camera, sun = pose
    except (TypeError, ValueError):
        raise refused("pose", pose, "a Camera is expected, or a pair of Camera and Sun") from None
    return camera, sun


class Scene:
    """A scene that is built once and rendered from many poses. `Renderer.scene` makes it; it may outlive the renderer's `with`.

    Pickles as its settings; a copy is built again where it is used.
    """

    def __init__(self, renderer: Renderer, seed: int, set: Knobs | None = None) -> None:
        self._renderer, self._seed, self._set = renderer, seed, document(set)
        self._built: _native.Scene | None = None
        self._native()

    def _native(self) -> _native.Scene:
        if self._built is None:
            renderer = self._renderer
            self._built = renderer._engine().scene(renderer._settings, self._seed, self._set)
        return self._built

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": None}

    def __repr__(self) -> str:
        return f"Scene(seed={self._seed})"

    @property
    def seed(self) -> int:
        """Its seed."""
        return self._seed

    def render(self, camera: Camera | None = None, sun: Sun | None = None) -> Frame:
        """A frame from a pose of the camera, under a sun; what is left out stays as the scene has it.

        The nominal stage is the same geometry from every pose. The ground of the surface stage is made for the camera, and is made
        again where the camera has moved: the same craters and rocks, in the detail that this view needs.

        Raises ConfigError for a pose out of the ranges of the knobs `camera.*` and `sun.*`.
        """
        native = self._native()
        return Frame(*native.render(self._renderer._engine(), *_pose(camera, sun, native)))

    def frames(
        self, poses: Iterable[Camera | tuple[Camera | None, Sun | None]], prefetch: int = 2
    ) -> Generator[Frame, None, None]:
        """The frames from these poses, each that of `render`, in order. They are planned on threads, several at a time, and rendered ahead
        from this call on; `prefetch` finished ones, 1 to 1000, wait at most to be taken. Closing the generator stops that.

        poses: cameras, or pairs of camera and sun; any iterable, which may have no end. They are read in groups, of 16 at first and up to
        256 later, and no frame of a group is there before its last pose: a pose that depends on a frame is one for `render`.

        Raises ConfigError for a pose out of range, when it is read.
        """
        prefetch = whole("prefetch", prefetch, 1, MAX_PREFETCH)
        try:
            listed = iter(poses)
        except TypeError:
            raise refused("poses", poses, "an iterable of poses is expected") from None
        native = self._native()

        def start(some: list[tuple[str, float | None]]) -> _native.Frames:
            return native.frames(self._renderer._engine(), some, prefetch)

        checked = (_pose(*_camera_and_sun(pose), native) for pose in listed)
        return streamed_in_parts(checked, POSES_AHEAD, start)

    def ground_height(self, x_m: float, y_m: float) -> float:
        """Height of the ground at a point, metres, world; beyond the border of the ground, that of its border.

        Raises ConfigError for what is no number, or lies more than 1000 km from the origin along an axis.
        """
        x_m, y_m = (number(name, at, -MAX_COORDINATE_M, MAX_COORDINATE_M) for name, at in (("x_m", x_m), ("y_m", y_m)))
        return self._native().ground_height(x_m, y_m)

    def mesh(self, drawn: bool = False) -> dict[str, NDArray[Any]]:
        """The triangles as arrays by name:

        `vertices` (N, 3) float32, metres, world; `normals` (N, 3) float32, unit; `triangles` (M, 3) uint32, indices of vertices;
        `triangle_class` (M,) uint8, as in `CLASSES`, 255 for a rover; `triangle_instance` (M,) uint16, 0 for what is no rock; `albedo`,
        `world_from_camera`, `K` and `sun_direction` as in a frame's record.

        drawn: only what a frame draws or lets cast shadows, in the detail that it uses.
        """
        with np.load(io.BytesIO(self._native().npz(drawn))) as arrays:
            return dict(arrays)

    def export(self, path: str | bytes | os.PathLike[str], drawn: bool = False) -> None:
        """Writes the scene for other software; the extension selects the format: .npz, .glb, .usda or .usdc. A file of that name is
        replaced when the new one is complete, and stays if that fails; a missing folder is created. drawn: as in `mesh`.

        Raises ConfigError for another extension or a name that is no text, OSError if the file cannot be written.
        """
        self._native().export(path_of("path", path), drawn)
