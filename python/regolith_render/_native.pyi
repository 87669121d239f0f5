import os
from typing import Any, final

from numpy.typing import NDArray
from typing_extensions import Self

__version__: str

class ConfigError(ValueError):
    """A setting that is wrong. Attributes are None where they do not apply."""

    knob: str | None
    value: str | None
    allowed: str | None
    nearest: str | None

class DeviceError(RuntimeError):
    """The graphics device or its driver failed."""

class NoAdapterError(DeviceError):
    """There is no graphics adapter to use."""

_Frame = tuple[dict[str, NDArray[Any]], str, str]

def main(words: list[str], executable: str) -> int: ...
def config_text(path: str | os.PathLike[str]) -> str: ...
def adapters() -> list[tuple[str, str, str, str]]: ...
def knobs(stage: str) -> list[tuple[str, str, tuple[float, float] | None, str, str, list[str]]]: ...
def presets() -> list[tuple[str, str]]: ...
def outputs() -> list[str]: ...

@final
class Settings:
    def __new__(
        cls,
        stage: str | None,
        presets: list[str],
        config: tuple[str, str] | None,
        set: str,
        size: tuple[int, int],
        outputs: str,
        samples: int,
        edges: str,
        raster: str,
    ) -> Self: ...
    def arrays(self) -> list[tuple[str, int, str]]: ...

@final
class Engine:
    def __new__(cls, settings: Settings, adapter: str | None, threads: int | None) -> Self: ...
    @property
    def adapter(self) -> str: ...
    def render(self, settings: Settings, seed: int, set: str) -> _Frame: ...
    def scene(self, settings: Settings, seed: int, set: str) -> Scene: ...
    def frames_of_seeds(self, settings: Settings, seeds: list[int], prefetch: int) -> Frames: ...
    def frames_of_dataset(
        self,
        settings: Settings,
        base_seed: int,
        indices: tuple[int, int, int | None],
        runs: tuple[int, int],
        prefetch: int,
    ) -> Frames: ...

@final
class Frames:
    def next(self) -> _Frame | None: ...
    def close(self) -> None: ...

@final
class Scene:
    def render(self, engine: Engine, set: str, eye_z_m: float | None) -> _Frame: ...
    def frames(self, engine: Engine, poses: list[tuple[str, float | None]], prefetch: int) -> Frames: ...
    def ground_height(self, x_m: float, y_m: float) -> float: ...
    def npz(self, drawn: bool) -> bytes: ...
    def export(self, path: str, drawn: bool) -> None: ...
