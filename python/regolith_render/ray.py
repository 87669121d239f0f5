"""Ray Data: frames rendered by the workers of a cluster, for those who outgrow one machine.

Ray is imported here and nowhere else in the package.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import ray.data
from ray.data import Datasource, ReadTask
from ray.data.block import BlockAccessor, BlockMetadata

from ._renderer import Renderer
from ._settings import MAX_FRAMES, MAX_SEED, Knobs, document, names_of, whole

_RENDERERS: dict[bytes, Renderer] = {}
"""The renderers of this worker process as they were pickled: a device is opened once, not for each block."""


def _renderer(pickled: bytes) -> Renderer:
    if pickled not in _RENDERERS:
        _RENDERERS.clear()
        _RENDERERS[pickled] = pickle.loads(pickled)
    return _RENDERERS[pickled]


def _blocks(renderer: bytes, seed: int, first: int, end: int) -> Iterator[Any]:
    """A block of the frames `first` to `end - 1`."""
    columns: dict[str, list[Any]] = {}
    for frame in _renderer(renderer).dataset_frames(seed, first, end=end):
        record = frame.meta
        row = {"index": record["index"], "seed": record["seed"], **frame, "record": json.dumps(record)}
        for name, value in row.items():
            columns.setdefault(name, []).append(value)
    yield BlockAccessor.batch_to_block(
        {name: np.stack(column) if isinstance(column[0], np.ndarray) else np.array(column) for name, column in columns.items()}
    )


class MoonDatasource(Datasource):  # type: ignore[misc,unused-ignore]
    """The frames of a dataset as a datasource of Ray Data. `read_moon` is what most need."""

    def __init__(self, settings: dict[str, Any], seed: int, first: int, count: int, frames_per_block: int) -> None:
        super().__init__()
        # Wrong settings are errors here, not on the cluster, which gets the text of a file of knobs as it is now.
        renderer = Renderer(**settings)
        arrays = renderer.arrays().values()
        self._frame_bytes = sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in arrays)
        self._renderer, self._seed, self._first, self._count = pickle.dumps(renderer), seed, first, count
        self._frames_per_block = frames_per_block

    def estimate_inmemory_data_size(self) -> int | None:
        """Bytes of all arrays."""
        return self._count * self._frame_bytes

    def get_read_tasks(self, parallelism: int, per_task_row_limit: int | None = None, data_context: Any = None) -> list[ReadTask]:
        """One task for each block of frames. Which frames there are, and their order, does not depend on the parallelism."""
        end, tasks = self._first + self._count, []
        for first in range(self._first, end, self._frames_per_block):
            last = min(first + self._frames_per_block, end)
            metadata = BlockMetadata(
                num_rows=last - first, size_bytes=(last - first) * self._frame_bytes, input_files=None, exec_stats=None
            )
            tasks.append(ReadTask(_reader(self._renderer, self._seed, first, last), metadata, per_task_row_limit=per_task_row_limit))
        return tasks


def _reader(renderer: bytes, seed: int, first: int, end: int) -> Callable[[], Iterable[Any]]:
    return lambda: _blocks(renderer, seed, first, end)


def read_moon(
    preset: str | Iterable[str] | None,
    count: int,
    *,
    seed: int = 42,
    first: int = 0,
    outputs: str | Iterable[str] = ("rgb", "mask"),
    set: Knobs | None = None,
    frames_per_block: int = 32,
    concurrency: int | None = None,
    num_cpus: float = 1,
    num_gpus: float | None = None,
    **renderer: Any,
) -> ray.data.Dataset:
    """The frames that `regolith-render dataset --seed SEED --count COUNT` makes, rendered by the workers of a Ray cluster as they are
    taken: a `ray.data.Dataset` with a row a frame. Ray gives blocks as they are finished; with
    `ray.data.DataContext.get_current().execution_options.preserve_order = True` they come by index.

    Columns are the arrays by name, as in a `Frame`, `index` and `seed`, and the `record` as JSON. preset, outputs, set, and further
    arguments: those of `Renderer`. first: index of the first frame. frames_per_block: frames of a task. concurrency: tasks at a time; as
    many as the cluster has room for without it. num_cpus, num_gpus: what each task takes of the cluster; it builds scenes on `num_cpus`
    threads unless `threads` says otherwise.

    Raises ConfigError for a wrong setting.
    """
    document(set)
    settings = {
        "preset": names_of("preset", preset),
        "outputs": names_of("outputs", outputs),
        "set": dict(set or {}),
        "threads": max(1, int(num_cpus)),
        **renderer,
    }
    count, frames_per_block = whole("count", count, 1, MAX_FRAMES), whole("frames_per_block", frames_per_block, 1, MAX_FRAMES)
    seed, first = whole("seed", seed, 0, MAX_SEED), whole("first", first, 0, MAX_FRAMES)
    source = MoonDatasource(settings, seed, first, count, frames_per_block)
    blocks = -(-count // frames_per_block)
    return ray.data.read_datasource(
        source, num_cpus=num_cpus, num_gpus=num_gpus, concurrency=concurrency, override_num_blocks=blocks
    )
