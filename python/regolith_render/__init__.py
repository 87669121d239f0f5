"""Labelled images of the Moon, rendered into NumPy arrays.

>>> import regolith_render as rr
>>> with rr.Renderer(preset="train_dr", size=(256, 256)) as renderer:
...     frame = renderer.render(seed=7)
>>> frame["rgb"].shape, frame["mask"].shape
((256, 256, 3), (256, 256))

Frames are those of the command `regolith-render`, to the byte. The modules `regolith_render.torch` (datasets for PyTorch) and
`regolith_render.ray` (Ray Data) import those packages, at first use; nothing else does.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from ._frame import CLASSES, IGNORE, Frame
from ._native import ConfigError, DeviceError, NoAdapterError, __version__
from ._renderer import Renderer
from ._scene import Camera, Scene, Sun
from ._tables import Adapter, Knob, Preset, adapters, knobs, outputs, presets

__all__ = [
    "CLASSES",
    "IGNORE",
    "Adapter",
    "Camera",
    "ConfigError",
    "DeviceError",
    "Frame",
    "Knob",
    "NoAdapterError",
    "Preset",
    "Renderer",
    "Scene",
    "Sun",
    "__version__",
    "adapters",
    "knobs",
    "outputs",
    "presets",
]

if TYPE_CHECKING:
    from . import ray as ray
    from . import torch as torch
else:

    def __getattr__(name: str) -> ModuleType:
        """`rr.torch` and `rr.ray`, imported at first use. Without the package that one needs it is no attribute, as `hasattr` says."""
        if name in ("torch", "ray"):
            try:
                return import_module(f".{name}", __name__)
            except ModuleNotFoundError as error:
                raise AttributeError(f"{__name__}.{name} cannot be imported: {error}") from error
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
