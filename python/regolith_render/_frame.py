"""A frame: its arrays by name, and its record."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._settings import number

CLASSES: dict[str, int] = {"regolith": 0, "rock": 1, "sky": 2}
"""The ids of the classes in a mask."""

IGNORE: int = 255
"""The id in a mask that a loss should ignore."""

ALIASES = {
    "depth": "distance_to_image_plane",
    "instances": "instance_segmentation",
    "coverage": "semantic_coverage",
}
"""Names of outputs whose arrays are called otherwise; `depth` has the array `distance_to_camera` besides."""

_COLOURS = {"regolith": (170, 140, 110), "rock": (220, 45, 40), "sky": (70, 120, 205)}


class Frame(Mapping[str, NDArray[Any]]):
    """A rendered frame: a mapping from the names of its arrays to NumPy arrays, and its record.

    By output, the arrays; the names are those of the files of a dataset:

    - `rgb`: `rgb` (H, W, 3) uint8, sRGB.
    - `mask`: `mask` (H, W) uint8, the ids of `CLASSES`, and `IGNORE`.
    - `preview`: `preview` (H, W, 3) uint8, the mask in colour.
    - `depth`: `distance_to_image_plane` and `distance_to_camera` (H, W) float32, metres along the optical axis and along the ray,
      infinite for the sky. `frame["depth"]` is the first.
    - `normals`: `normals` (H, W, 3) float32, unit vectors in world axes; 0 for the sky.
    - `instances`: `instance_segmentation` (H, W) uint16, 0 for no rock; `frame["instances"]` is the same, `frame.rocks` describes them.
    - `shadow`: `shadow` (H, W) uint8, the hidden part of the sun's disc, 0 (lit) to 255.
    - `hdr`: `hdr` (H, W, 3) float16, linear radiance before exposure.
    - `coverage`: `semantic_coverage` (H, W, 3) float32, the fraction of the pixel of each class, 0 to 1; `frame["coverage"]` is the same.
    - `slope`: `slope` (H, W) float32, degrees; NaN for rocks and sky.
    - `craters`: `craters` (H, W) uint8: 1 inside a crater, 2 on its rim, else 0.
    - `angles`: `incidence` and `phase` (H, W) float32, degrees; NaN for the sky.
    - `five_classes`: `five_classes` (H, W) uint8, the mask with 3 inside craters and 4 for ground beyond 400 m; `five_classes_preview`
      (H, W, 3) uint8.
    - `rock_sizes`: `rock_sizes` (H, W, 3) uint8, the mask in colours by the size of rocks.
    - `meta`: no array; every frame has its record in `frame.meta`.

    Each array is C-contiguous, writable, and the only one in its memory, which it keeps: nothing was copied on the way, and
    `torch.from_dlpack(frame["rgb"])` copies nothing either. Frames are equal if their arrays are. They pickle.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]], meta: str = "{}", rocks: str = "{}") -> None:
        self._arrays = arrays
        self._meta_text = meta
        self._rocks_text = rocks

    @cached_property
    def meta(self) -> dict[str, Any]:
        """The record of the frame, as in `frame_0000.json`: `seed`; `knobs` as drawn, by dotted name; `camera`
        with `K` (3 x 3, pixels), `world_from_camera` (4 x 4, axes of OpenCV, metres), `distortion`, ...; `sun`; `coverage`, the share of
        each class, 0 to 1; `ms`, milliseconds by stage of work; and so on. A frame of a dataset has besides what a line of
        `frames.jsonl` has; there `adapter` is its name alone, and what is the same for all frames (`size`, `samples`, ...) is in the
        manifest."""
        record: dict[str, Any] = json.loads(self._meta_text)
        return record

    @cached_property
    def rocks(self) -> dict[int, dict[str, Any]]:
        """The visible rocks by instance id, as in `instance_segmentation_mapping_0000.json`: `box_px` (left, top, right, bottom, all
        inclusive), `visible_px`, `occluded` (0 to 1), height and diameter in metres, ... Empty unless `instances` was asked for."""
        return {int(instance): rock for instance, rock in json.loads(self._rocks_text).items()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self._arrays[ALIASES.get(name, name)]
        except KeyError:
            have = ", ".join(self._arrays)
            raise KeyError(f"{name}: this frame has {have}; ask for more by Renderer(outputs=...)") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Frame):
            return NotImplemented
        same = (np.array_equal(array, other[name], equal_nan=array.dtype.kind == "f") for name, array in self.items())
        return self._arrays.keys() == other._arrays.keys() and all(same)

    __hash__ = None  # type: ignore[assignment]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        arrays = ", ".join(f"{name} {array.dtype}{list(array.shape)}" for name, array in self._arrays.items())
        return f"Frame(seed={self.meta.get('seed')}, {arrays})"

    def _repr_html_(self) -> str:
        """Image, mask over image, and a legend, for notebooks."""
        if "rgb" not in self:
            return f"<pre>{self!r}</pre>"
        shown = [self["rgb"]]
        legend = ""
        if "mask" in self:
            shown.append(self.overlay())
            rows = [(name, _COLOURS[name], float((self["mask"] == class_id).mean())) for name, class_id in CLASSES.items()]
            legend = " ".join(
                f'<span style="background:rgb{colour};padding:0 0.6em">&nbsp;</span> {name} {100 * share:.1f} %'
                for name, colour, share in rows
            )
        images = "".join(
            f'<img src="data:image/png;base64,{base64.b64encode(_png(rgb)).decode()}" style="margin:2px">'
            for rgb in shown
        )
        return f"<div>{images}<br>{legend} (seed {self.meta.get('seed')})</div>"

    def overlay(self, opacity: float = 0.45) -> NDArray[np.uint8]:
        """The image with the classes over it in their preview colours: (H, W, 3) uint8. What is ignored is black. opacity: that of the
        classes, 0 to 1. Needs the outputs `rgb` and `mask`.

        Raises ConfigError for another opacity.
        """
        opacity = number("opacity", opacity, 0, 1)
        colours = np.zeros((256, 3), np.float32)
        for name, class_id in CLASSES.items():
            colours[class_id] = _COLOURS[name]
        mixed: NDArray[np.float32] = (1.0 - opacity) * self["rgb"] + opacity * colours[self["mask"]]
        return mixed.round().astype(np.uint8)


def _png(rgb: NDArray[np.uint8]) -> bytes:
    """An image (H, W, 3) as a PNG file."""
    height, width, _ = rgb.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), rgb.reshape(height, 3 * width)], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
