"""The tables of the command line: adapters, knobs, presets, outputs."""

from __future__ import annotations

from typing import NamedTuple

from . import _native
from ._settings import opening, text


class Adapter(NamedTuple):
    """A GPU or a CPU driver that can be used. A part of its `name`, `backend` or `driver` is what
    `Renderer(adapter=...)` takes."""

    name: str
    kind: str
    """`discrete GPU`, `integrated GPU`, `CPU driver`, ..."""
    backend: str
    """`vulkan`, `gl`, ..."""
    driver: str
    """Name and version."""


class Knob(NamedTuple):
    """A setting of a scene: the range of a number is in `low` and `high`, the values of a text in `allowed`."""

    name: str
    """Dotted: `sun.elevation_deg` is what `set={...}` takes."""
    unit: str
    """`deg`, `m`, ...; empty for none."""
    low: float | None
    high: float | None
    default: str
    """As TOML."""
    help: str
    allowed: tuple[str, ...] = ()


class Preset(NamedTuple):
    """A named set of knobs: `name` is what `Renderer(preset=...)` takes."""

    name: str
    help: str


def adapters() -> list[Adapter]:
    """The adapters, best first.

    Raises NoAdapterError if there is none; the message says what to install.
    """
    with opening():
        return [Adapter(*row) for row in _native.adapters()]


def knobs(stage: str = "nominal") -> list[Knob]:
    """The knobs of a stage, `nominal` or `surface`.

    Raises ConfigError for another stage.
    """
    return [
        Knob(name, unit, bounds[0] if bounds else None, bounds[1] if bounds else None, default, help, tuple(allowed))
        for name, unit, bounds, default, help, allowed in _native.knobs(text("stage", stage))
    ]


def presets() -> list[Preset]:
    """The presets that ship with the package."""
    return [Preset(*row) for row in _native.presets()]


def outputs() -> list[str]:
    """The names that `Renderer(outputs=...)` takes, besides `all`; `Frame` says which arrays each has."""
    return _native.outputs()
