"""The renderer: settings, its device, and frames by seed, in streams and in batches."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._frame import Frame
from ._scene import Scene
from ._settings import MAX_FRAMES, MAX_PREFETCH, MAX_SEED, MAX_THREADS
from ._settings import Knobs, document, names_of, opening, outputs_of, path_of, plain, refused, release_memory, samples_of, seed_of, size_of
from ._settings import named, text, whole
from ._stream import streamed, streamed_in_parts

SEEDS_AHEAD = 1024
"""How many seeds `frames` reads ahead."""
DEFAULTS: dict[str, Any] = {"stage": None, "set": {}, "adapter": None, "raster": "auto", "edges": "hard", "threads": None}
"""Settings that a renderer does not show where they are as here."""


class Renderer:
    """Renders labelled frames on one device, which is opened at first use.

    preset: a name, several with commas between them, or a list, of which later ones win; `rr.presets()` lists them.
    stage: `nominal` or `surface`; without it, that of the preset.
    config: a TOML file of knobs, which wins over presets.
    set: values of knobs, which win over all: a number, a text, a list, or a distribution to be drawn from as in
    `{"sun.elevation_deg": {"uniform": [5, 40]}}`; `rr.knobs()` lists them with unit and range.
    size: width and height, pixels, or one number for both.
    outputs: names; `rr.outputs()` lists them, and `Frame` says what they are.
    samples: 1, 4 or 16 for each pixel.
    adapter: a part of an adapter's name, backend or driver (`rr.adapters()`), or `cpu`; the best one without it. Of several that it is a
        part of, the first: a backend (`gl`) tells apart two of one name.
    raster: where triangles are rasterised: `auto`, `device`, `compute` or `host`.
    edges: `hard`, or `ignore:N` for 255 in the mask within N pixels of another class.
    threads: how many build scenes, 1 to 256; without it one for each core, or with a software adapter, which draws on the same cores,
        one for every two.

    Raises ConfigError for a wrong setting, FileNotFoundError for a missing file of knobs; opening the device raises NoAdapterError if there
    is none of that name, and DeviceError if its driver fails.

    Pickles as its settings; a copy opens a device of its own. It may be used from several threads.
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
        self._settings_of: dict[str, Any] = {
            "stage": None if stage is None else text("stage", stage),
            "presets": names_of("preset", preset),
            # As it is now: a copy in another process has neither this folder nor this version of the file.
            "config": None if config is None else _file_of_knobs(config),
            "set": document(set),
            "size": size_of(size),
            "outputs": ",".join(outputs_of(outputs)),
            "samples": samples_of(samples),
            "edges": text("edges", edges),
            "raster": text("raster", raster),
        }
        self._knobs = plain(set)
        self._device_of: dict[str, Any] = {
            "adapter": None if adapter is None else named("adapter", adapter),
            "threads": None if threads is None else whole("threads", threads, 1, MAX_THREADS),
        }
        self._open()

    def _open(self) -> None:
        self._settings = _native.Settings(**self._settings_of)
        self._opened: tuple[int, _native.Engine] | None = None

    def _engine(self) -> _native.Engine:
        """The device of this process."""
        process = os.getpid()
        opened = self._opened
        if opened is None:
            with opening():
                if (opened := self._opened) is None:
                    self._opened = opened = (process, _native.Engine(self._settings, **self._device_of))
        if opened[0] != process:
            raise _native.DeviceError(
                "this process was forked from one that had already opened the graphics device, which a fork cannot share; open it "
                "only in the workers, or start them by 'spawn' or 'forkserver' (multiprocessing_context= of a DataLoader)"
            )
        return opened[1]

    def __getstate__(self) -> dict[str, Any]:
        return {"settings": self._settings_of, "knobs": self._knobs, "device": self._device_of}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._settings_of, self._knobs, self._device_of = state["settings"], state["knobs"], state["device"]
        self._open()

    def __repr__(self) -> str:
        settings = {**self._settings_of, **self._device_of, "set": self._knobs}
        shown = {"preset": ",".join(settings["presets"]) or None, **{name: settings[name] for name in ("size", "outputs", "samples")}}
        if settings["config"] is not None:
            shown["config"] = settings["config"][1]
        shown |= {name: settings[name] for name, default in DEFAULTS.items() if settings[name] != default}
        return f"Renderer({', '.join(f'{name}={value!r}' for name, value in shown.items())})"

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Gives the device back. Another use opens it again."""
        self._opened = None
        release_memory()

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
        """The frame of a seed, 0 to 2^64 - 1, as `regolith-render --seed` writes it. set: values of knobs for this frame alone.

        Raises ConfigError for a wrong seed or knob, DeviceError if the device fails.
        """
        seed, knobs = seed_of(seed), document(set)
        return Frame(*self._engine().render(self._settings, seed, knobs))

    def frames(self, seeds: Iterable[int], prefetch: int = 2) -> Generator[Frame, None, None]:
        """The frames of these seeds, each that of `render`, in order. Scenes are built on threads and frames rendered ahead from this call
        on; `prefetch` finished ones, 1 to 1000, wait at most to be taken. Closing the generator stops that.

        seeds: any iterable, which may have no end. They are read in groups, of 16 at first and up to 1024 later, and no frame of a group is
        there before its last seed: one that depends on a frame is one for `render`.

        Raises ConfigError for a wrong seed.
        """
        prefetch = whole("prefetch", prefetch, 1, MAX_PREFETCH)
        checked = map(seed_of, _iterator(seeds))

        def start(some: list[int]) -> _native.Frames:
            return self._engine().frames_of_seeds(self._settings, some, prefetch)

        return streamed_in_parts(checked, SEEDS_AHEAD, start)

    def dataset_frames(
        self, base_seed: int, first: int = 0, step: int = 1, end: int | None = None, prefetch: int = 2
    ) -> Generator[Frame, None, None]:
        """The frames `first`, `first + step`, ... below `end` of the dataset that `regolith-render dataset --seed BASE_SEED` makes, in
        order; without `end`, as many as are taken, 2^32 at most. A frame that breaks a rule of the preset is drawn again, as there.
        prefetch as in `frames`.

        Raises ConfigError for a wrong argument, and when a frame breaks the rules however often it is drawn.
        """
        return self._dataset_frames(base_seed, (first, step, end), (1, 0), prefetch)

    def _dataset_frames(
        self, base_seed: int, indices: tuple[int, int, int | None], runs: tuple[int, int], prefetch: int
    ) -> Generator[Frame, None, None]:
        """The same with `runs[0]` frames in a row at each step, without the first `runs[1]` of them all."""
        first, step, end = indices
        base_seed = whole("base_seed", base_seed, 0, MAX_SEED)
        first, step = whole("first", first, 0, MAX_FRAMES), whole("step", step, 1, MAX_FRAMES)
        end = None if end is None else whole("end", end, 0, MAX_FRAMES)
        prefetch = whole("prefetch", prefetch, 1, MAX_PREFETCH)
        engine = self._engine()
        return streamed(engine.frames_of_dataset(self._settings, base_seed, (first, step, end), runs, prefetch))

    def batch(self, seeds: Iterable[int], out: dict[str, NDArray[Any]] | None = None) -> dict[str, NDArray[Any]]:
        """The frames of these seeds as arrays (B, H, W, ...) by name, of the types of `arrays()`. out: arrays to fill instead of new ones,
        as an earlier call returned them; the same dictionary is returned.

        Raises ConfigError if an array of `out` is missing, of another shape or type, or read-only.
        """
        listed = [seed_of(seed) for seed in _iterator(seeds)]
        wanted = {name: ((len(listed), *shape), dtype) for name, (shape, dtype) in self.arrays().items()}
        if out is not None and not isinstance(out, dict):
            raise refused("out", out, "a dictionary of arrays by name is expected")
        batch = out if out is not None else {}
        if not batch:
            batch.update({name: np.empty(shape, dtype) for name, (shape, dtype) in wanted.items()})
        for name, (shape, dtype) in wanted.items():
            array = batch.get(name)
            if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
                found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
                raise refused(f"out[{name!r}]", found, f"an array {dtype} {shape} is expected")
            if not array.flags.writeable:
                raise refused(f"out[{name!r}]", "read-only", "an array that may be written is expected")
        for row, frame in enumerate(self.frames(listed)):
            for name, pixels in frame.items():
                batch[name][row] = pixels
        return batch

    def scene(self, seed: int, set: Knobs | None = None) -> Scene:
        """The scene of a seed, to be rendered from many poses. set: values of knobs for this scene alone.

        Raises ConfigError for a wrong seed or knob.
        """
        return Scene(self, seed_of(seed), set)


def _file_of_knobs(config: str | os.PathLike[str]) -> tuple[str, str]:
    """The text of a file of knobs, and its path for messages."""
    if not isinstance(config, (str, os.PathLike)):
        raise refused("config", config, "the path of a file is expected")
    path = path_of("config", config)
    knobs = _native.config_text(path)
    if knobs.lstrip().startswith("{"):
        raise refused("config", path, 'a TOML file of knobs is expected; of a frame\'s record pass set=json.load(...)["knobs"]')
    return knobs, os.fsencode(path).decode("utf-8", "replace")


def _iterator(seeds: Iterable[int]) -> Iterator[object]:
    try:
        return iter(seeds)
    except TypeError:
        raise refused("seeds", seeds, "seeds are expected, as in range(100) or [3, 5]") from None
