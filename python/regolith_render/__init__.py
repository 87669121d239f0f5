"""Labelled images of the Moon, rendered into NumPy arrays.

>>> import regolith_render as rr
>>> with rr.Renderer(preset="train_dr", size=(256, 256)) as renderer:
...     frame = renderer.render(seed=7)
>>> frame["rgb"].shape, frame["mask"].shape
((256, 256, 3), (256, 256))

Frames are those of the command `regolith-render`, to the byte. The module `regolith_render.torch` has datasets for PyTorch, which it
alone imports.
"""

from ._frame import CLASSES, IGNORE, Frame
from ._native import ConfigError, DeviceError, NoAdapterError, __version__
from ._renderer import Adapter, Camera, Knob, Preset, Renderer, Scene, Sun, adapters, knobs, outputs, presets

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
