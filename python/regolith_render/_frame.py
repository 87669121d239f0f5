"""A frame: its arrays by name, and its record."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """A rendered frame: a mapping from the names of its arrays to NumPy arrays.

    The names are those of the files of a dataset: `rgb` (H, W, 3) uint8; `mask` (H, W) uint8 with the ids of `CLASSES` and `IGNORE`;
    `distance_to_image_plane` and `distance_to_camera` (H, W) float32, metres, infinite for the sky; `normals` (H, W, 3) float32;
    `instance_segmentation` (H, W) uint16; `shadow` (H, W) uint8, 255 where the whole sun is hidden; `hdr` (H, W, 3) float16, linear
    radiance; and so on, by output. `frame["depth"]`, `frame["instances"]` and `frame["coverage"]` work as well.

    Each array is C-contiguous, writable, and owns the memory that was rendered into. `torch.from_dlpack(frame["rgb"])` copies nothing.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]], meta: str, rocks: str) -> None:
        self._arrays = arrays
        self._meta_text = meta
        self._rocks_text = rocks

    @property
    def meta(self) -> dict[str, Any]:
        """The record of the frame, as in `frame_0000.json` or a line of `frames.jsonl`: seed, knobs as drawn, camera, sun, ..."""
        record: dict[str, Any] = json.loads(self._meta_text)
        return record

    @property
    def rocks(self) -> dict[int, dict[str, Any]]:
        """The visible rocks by instance id: box, visible pixels, occluded fraction, size. Empty unless `instances` was asked for."""
        return {int(instance): rock for instance, rock in json.loads(self._rocks_text).items()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self._arrays[ALIASES.get(name, name)]
        except KeyError:
            have = ", ".join(self._arrays)
            raise KeyError(f"{name}: this frame has {have}; ask for more by Renderer(outputs=...)") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        arrays = ", ".join(f"{name} {array.dtype}{list(array.shape)}" for name, array in self._arrays.items())
        return f"Frame(seed={self.meta['seed']}, {arrays})"

    def _repr_html_(self) -> str:
        """Image, mask over image, and a legend, for notebooks."""
        if "rgb" not in self:
            return f"<pre>{self!r}</pre>"
        pictures = [self["rgb"]]
        legend = ""
        if "mask" in self:
            pictures.append(self.overlay())
            rows = [(name, _COLOURS[name], self.meta["coverage"][name]) for name in CLASSES]
            legend = " ".join(
                f'<span style="background:rgb{colour};padding:0 0.6em">&nbsp;</span> {name} {100 * share:.1f} %'
                for name, colour, share in rows
            )
        images = "".join(
            f'<img src="data:image/png;base64,{base64.b64encode(_png(picture)).decode()}" style="margin:2px">'
            for picture in pictures
        )
        return f"<div>{images}<br>{legend} (seed {self.meta['seed']})</div>"

    def overlay(self, opacity: float = 0.45) -> NDArray[np.uint8]:
        """The image with the classes over it in their preview colours: (H, W, 3) uint8. What is ignored is black."""
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
