"""Datasets for PyTorch: frames rendered while a network trains, and finished datasets from their folders.

PyTorch is imported here and nowhere else in the package.
"""

from __future__ import annotations

import json
import multiprocessing
import multiprocessing.context
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from ._frame import Frame
from ._renderer import Renderer
from ._settings import MAX_FRAMES, MAX_PREFETCH, MAX_SEED, Knobs, refused, truth, whole

Sample = dict[str, Any]
"""Tensors by name of the output, and what a transform makes of them."""

Transform = Callable[[Sample], Any]

MAX_WORKERS = 1024
"""Workers of a loader that are distinguished by their number."""


def _tensor(name: str, array: np.ndarray[Any, Any], as_uint8: bool) -> torch.Tensor:
    """An array as a tensor for a loss: images (3, H, W) float32 in [0, 1], or uint8; masks and ids int64; the rest as it is."""
    # Pillow before 11.3 reads 16 bits as 32.
    if name == "mask" or array.dtype in (np.uint16, np.int32):
        return torch.as_tensor(array.astype(np.int64))
    tensor = torch.as_tensor(array)
    if array.ndim == 3:
        tensor = tensor.permute(2, 0, 1).contiguous()
    return tensor.float() / 255.0 if name == "rgb" and not as_uint8 else tensor


def sample(frame: Frame, as_uint8: bool = False) -> Sample:
    """The tensors of a frame by name: `image` (3, H, W) float32 in [0, 1], or uint8; `mask` (H, W) int64 with 255 to be ignored; others
    under the names of their arrays, channels first."""
    names = {name: "image" if name == "rgb" else name for name in frame}
    return {names[name]: _tensor(name, array, as_uint8) for name, array in frame.items()}


class MoonDataset(IterableDataset[Any]):
    """Frames rendered while they are taken: those of the dataset that `regolith-render dataset --seed SEED` makes, in order.

    A sample is a dictionary: `image` (3, H, W) float32 in [0, 1], `mask` (H, W) int64 with 255 to be ignored
    (`cross_entropy(..., ignore_index=255)`), and the arrays of further outputs under their names, channels first.

    preset, outputs, and further arguments: those of `Renderer`.
    seed: the base seed, 0 to 2^64 - 1.
    length: number of frames of an epoch, of all ranks together; None for no end.
    transform: what becomes of each sample.
    batch_size: that of the loader, if it has worker processes or `state_dict` is to count its batches. Each worker then makes whole
    batches, so that batches are the same for any number of workers; without it, worker w of n makes every n-th frame from the w-th on.
    as_uint8: images as uint8, 0 to 255, without conversion.
    prefetch: finished frames that wait at most, 1 to 1000.

    Which frames there are does not depend on the number of workers, and the ranks of a distributed run (`torch.distributed`) share their
    batches out: with a length that is a multiple of `batch_size` times the number of ranks, each gets as many. Each worker opens a device
    of its own at its first frame. Workers that are forked after the device of this dataset was opened in their parent get an error; start
    them by `multiprocessing_context="spawn"`.

    Raises ConfigError for a wrong argument.
    """

    def __init__(
        self,
        preset: str | Iterable[str] | None = None,
        outputs: str | Iterable[str] = ("rgb", "mask"),
        seed: int = 42,
        length: int | None = None,
        transform: Transform | None = None,
        *,
        batch_size: int | None = None,
        as_uint8: bool = False,
        prefetch: int = 2,
        set: Knobs | None = None,
        **renderer: Any,
    ) -> None:
        super().__init__()
        self.renderer = Renderer(preset, outputs=outputs, set=set, **renderer)
        self.seed = whole("seed", seed, 0, MAX_SEED)
        self.length = None if length is None else whole("length", length, 1, MAX_FRAMES)
        # Frames in a row that a rank or a worker makes; and whether a loader's batches are known to have as many.
        self.batch_size = 1 if batch_size is None else whole("batch_size", batch_size, 1, MAX_FRAMES)
        self._knows_batches = batch_size is not None
        self.prefetch = whole("prefetch", prefetch, 1, MAX_PREFETCH)
        self.transform, self.as_uint8 = _transform(transform), truth("as_uint8", as_uint8)
        # Epoch, `taken` and `within_batch` of the next iteration, and how often these were set: in memory that workers share, as they
        # may live longer than an epoch.
        self._start = _shared([0] * 4)
        self._starts_used = -1
        # The start that was used last, in which iteration, by how many workers, and of which process; the start that each worker used, by
        # its number; and the start that an iteration found used, so that it began at the first frame. Workers that a loader starts for
        # each iteration know nothing else of those before.
        self._used_by, self._used_by_worker, self._used_up = _shared([-1] * 4), _shared([-1] * MAX_WORKERS), _shared([-1])
        # The start of a worker that was given a state of its own, as `torchdata`'s StatefulDataLoader does.
        self._own_start: tuple[int, int, int] | None = None
        self._position = (0, 0, 0)
        # The rank, and how many there are, where `torch.distributed` is not initialised: in workers that are not forked.
        self._rank = (0, 1)
        # The epoch of a state that was loaded and not used since, as far as this process knows.
        self._loaded_epoch: int | None = None

    def set_epoch(self, epoch: int) -> None:
        """The next iteration has the frames of this epoch, which are others than those of any other, from the first one; or, if a state of
        this epoch was just loaded, from where that is. Epoch 0 is the dataset of the command line. Workers that a loader keeps
        (`persistent_workers`) follow."""
        epoch = whole("epoch", epoch, 0, MAX_FRAMES)
        loaded, self._loaded_epoch = self._loaded_epoch, None
        if epoch != loaded or self._is_begun():
            self._set_start((epoch, 0, 0))

    def state_dict(self, batches: int | None = None) -> dict[str, int]:
        """Where an epoch is: `epoch`, `taken`, the frames of all ranks and workers in batches that are complete, and `within_batch`, those
        of the batch that was begun.

        batches: how many of `batch_size` frames, which this dataset must have been given, the loader of this rank has given in this
        iteration, as `enumerate(loader, 1)` counts. With worker processes it is needed, as only the loader knows; without it, the state
        is that of the iteration in this process.

        Loaded after the last frame of an epoch, it gives an iteration without frames; the one after that is whole, or that of the next
        `set_epoch`.

        Raises ConfigError for more batches than there are, and without `batch_size`.
        """
        epoch, taken, within = self._position
        if batches is not None:
            if not self._knows_batches:
                allowed = "MoonDataset(batch_size=...) is expected, that of the loader: its batches are to be counted"
                raise refused("batches", batches, allowed)
            epoch, taken, within, set_times = (int(number) for number in self._start)
            if int(self._used_up[0]) == set_times:
                taken = within = 0
            if within:
                raise refused("batches", batches, "None is expected after a state within a batch: only the iteration knows")
            run = self.batch_size * self._rank_of()[1]
            most = MAX_FRAMES if self.length is None else max(0, -((taken - self.length) // run))
            taken += whole("batches", batches, 0, most) * run
        if self.length is not None:
            # The last batches of other ranks and workers may lie beyond it.
            taken = min(taken, self._end())
        return {"epoch": epoch, "taken": taken, "within_batch": within}

    def _end(self) -> int:
        """Most frames in complete batches: the length, rounded up to a batch; without a length as many as there may be."""
        return MAX_FRAMES if self.length is None else -(-self.length // self.batch_size) * self.batch_size

    def load_state_dict(self, state: dict[str, int]) -> None:
        """The next iteration goes on from there, with any number of workers; those after it start at the first frame of the epoch.

        Raises ConfigError if it is no state, one of another `batch_size` in whose batches it does not fit, or one beyond the length.
        """
        try:
            epoch, taken, within = state["epoch"], state["taken"], state["within_batch"]
        except (TypeError, KeyError):
            raise refused("state", state, "what state_dict returned is expected") from None
        taken, within = whole("taken", taken, 0, self._end()), whole("within_batch", within, 0, self.batch_size - 1)
        if taken % self.batch_size:
            raise refused("taken", taken, f"a multiple of batch_size = {self.batch_size} is expected")
        self._set_start((whole("epoch", epoch, 0, MAX_FRAMES), taken, within))
        self._loaded_epoch = epoch

    def _set_start(self, start: tuple[int, int, int]) -> None:
        self._position = start
        if get_worker_info() is not None:  # type: ignore[no-untyped-call,unused-ignore]
            self._own_start = start
        else:
            self._start.copy_(torch.tensor([*start, int(self._start[3]) + 1]))

    def _next_start(self) -> tuple[int, int, int]:
        """Where the iteration that begins now starts."""
        epoch, taken, within, set_times = (int(number) for number in self._start)
        if self._own_start is not None:
            epoch, taken, within = self._own_start
        elif self._is_used(set_times):
            taken = within = 0
            self._used_up.fill_(set_times)
        self._own_start, self._starts_used = None, set_times
        return epoch, taken, within

    def _is_begun(self) -> bool:
        """Whether an iteration of this process, or of its workers, began at the present start."""
        set_times, _, _, process = self._used_by.tolist()
        return bool(set_times == int(self._start[3]) and process == os.getpid())

    def _is_used(self, set_times: int) -> bool:
        """Whether an earlier iteration began at this start, in this process or in workers. All workers of an iteration have its seed in
        common, but so have iterations before each of which PyTorch was seeded with the same number: those have workers of equal numbers."""
        if set_times == self._starts_used:
            return True
        worker = get_worker_info()  # type: ignore[no-untyped-call,unused-ignore]
        number, workers, seed = (MAX_WORKERS, 0, 0) if worker is None else (worker.id, worker.num_workers, worker.seed)
        iteration, used = [set_times, int(seed - number) % 2**62, workers], self._used_by.tolist()
        of_worker = self._used_by_worker[number : number + 1]
        if used[0] == set_times and (used[:3] != iteration or set_times in of_worker.tolist()):
            return True
        parent = None if worker is None else multiprocessing.parent_process()
        self._used_by.copy_(torch.tensor([*iteration, (parent.pid or 0) if parent else os.getpid()]))
        of_worker.fill_(set_times)
        return False

    def __getstate__(self) -> dict[str, Any]:
        if multiprocessing.context.get_spawning_popen() is not None:
            # For a worker, in the process that starts it, which knows the rank.
            return {**self.__dict__, "_rank": self._rank_of()}
        # For a copy, which has no part in this process's distributed run, and a position of its own.
        shared = {name: value.clone() for name, value in self.__dict__.items() if isinstance(value, torch.Tensor)}
        return {**self.__dict__, **shared, "_rank": (0, 1)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for shared in (self._start, self._used_by, self._used_up, self._used_by_worker):
            shared.share_memory_()  # type: ignore[no-untyped-call,unused-ignore]

    def __iter__(self) -> Iterator[Any]:
        self._loaded_epoch = None
        is_own = self._own_start is not None
        epoch, taken, within = self._next_start()
        if not is_own and _worker_of()[0] > 0:
            # The batch that was begun is the first worker's.
            within = 0
        self._position = epoch, taken, within
        (rank, ranks), (worker, workers) = self._rank_of(), _worker_of()
        # Batches of a loader alternate between its workers; batches of a rank are every `ranks`-th one.
        number, of, run = rank + ranks * worker, ranks * workers, self.batch_size
        # Epochs are apart by more frames than one has, and base seeds by more than all epochs.
        base_seed = (self.seed + 0x9E3779B97F4A7C15 * epoch) % 2**64
        indices = (taken + number * run, of * run, self.length)
        for frame in self.renderer._dataset_frames(base_seed, indices, (run, within), self.prefetch):
            within += 1
            if within == run:
                taken, within = taken + of * run, 0
            self._position = (epoch, taken, within)
            made = sample(frame, self.as_uint8)
            yield made if self.transform is None else self.transform(made)

    def _rank_of(self) -> tuple[int, int]:
        """The rank of this process in a distributed run, or of the one that started it, and how many there are."""
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return torch.distributed.get_rank(), torch.distributed.get_world_size()
        return self._rank

    def __len__(self) -> int:
        if self.length is None:
            raise TypeError("this dataset has no end; give it a length")
        return self.length


def _shared(numbers: list[int]) -> torch.Tensor:
    """Whole numbers in memory that processes share."""
    tensor = torch.tensor(numbers, dtype=torch.int64)
    tensor.share_memory_()  # type: ignore[no-untyped-call,unused-ignore]
    return tensor


def _worker_of() -> tuple[int, int]:
    """The number of this worker of a loader, and how many it has."""
    worker = get_worker_info()  # type: ignore[no-untyped-call,unused-ignore]
    return (0, 1) if worker is None else (worker.id, worker.num_workers)


def _object(text: bytes) -> dict[str, Any]:
    """An object of JSON; ValueError for anything else."""
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("an object is expected")
    return found


def _manifest_of(folder: Path) -> dict[str, Any]:
    """The manifest of a dataset."""
    path = folder / "manifest.json"
    try:
        return _object(path.read_bytes())
    except ValueError as error:
        remedy = "delete it and run the command of the dataset again with --force, which writes it again"
        raise ValueError(f"{path} is no manifest ({error}); {remedy}") from None


def _remedy(folder: Path) -> str:
    """What to do about a damaged dataset."""
    return f"run the command of the dataset again, or `regolith-render verify {folder}`, which lists what is wrong"


def _transform(transform: object) -> Transform | None:
    """A transform that can be called, or none."""
    if transform is not None and not callable(transform):
        raise refused("transform", transform, "a function of a sample is expected")
    return transform


def _records_of(folder: Path, manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The records of the frames of a dataset: as many as its manifest counts."""
    path, records = folder / "frames.jsonl", []
    remedy, indices = _remedy(folder), set()
    lines = path.read_bytes().removesuffix(b"\n").split(b"\n")
    for number, line in enumerate(lines, 1):
        try:
            record = _object(line)
            missing = [key for key in ("index", "hashes") if key not in record]
            if missing:
                raise ValueError(f"it has no {missing[0]}")
            if record["index"] in indices:
                raise ValueError(f"frame {record['index']} has one above")
        except ValueError as error:
            reason = getattr(error, "msg", error)
            raise ValueError(f"{path}, line {number} is no record of a frame ({reason}); {remedy}") from None
        records.append(record)
        indices.add(record["index"])
    if (completed := manifest.get("n_completed")) != len(records):
        raise ValueError(f"{folder} has the records of {len(records)} frames, and its manifest counts {completed}; {remedy}")
    return records


class MoonFolder(Dataset[Any]):
    """A finished dataset of the layout `folder`, as `regolith-render dataset` writes it: the same samples as `MoonDataset`, without `hdr` and
    `preview`.

    folder: with `manifest.json`. split: the name of one of its splits; all frames without it. transform, as_uint8: as in `MoonDataset`.
    Needs Pillow.

    Attributes, those of all frames of the dataset, for a loss and a normalisation: `class_weights` (median frequency balancing) and
    `class_pixels` by name of the class; `channel_mean` and `channel_std`, three numbers of 0 to 1. `manifest` and `records` are the
    dataset's own.

    Raises FileNotFoundError if there is no dataset, ValueError if it is unfinished, of another layout, or has no such split, or if its
    manifest or its records are damaged; so does a sample whose files are missing, unreadable or of another size. Their content is what `regolith-render verify`
    checks.
    """

    manifest: dict[str, Any]
    records: list[dict[str, Any]]
    class_weights: dict[str, float]
    class_pixels: dict[str, int]
    channel_mean: list[float]
    channel_std: list[float]

    def __init__(
        self,
        folder: str | os.PathLike[str],
        split: str | None = None,
        transform: Transform | None = None,
        *,
        as_uint8: bool = False,
    ) -> None:
        super().__init__()
        self.folder, self.transform, self.as_uint8 = Path(folder), _transform(transform), truth("as_uint8", as_uint8)
        self.manifest = _manifest_of(self.folder)
        for key, value in (("format", "folder"), ("label_ids", "canonical")):
            if (found := self.manifest.get(key, value)) != value:
                raise ValueError(f"{self.folder} has {key} = {found!r}; {value!r} is expected")
        totals = self.manifest.get("totals") or {}
        missing = [name for name in ("class_weights", "channel_mean") if name not in totals]
        if missing:
            raise ValueError(
                f"{self.folder / 'manifest.json'} has no totals.{missing[0]}: finish the dataset by running its command again, which adds it"
            )
        status, completed, count = (self.manifest.get(key) for key in ("status", "n_completed", "count"))
        if status != "done" or completed != count:
            raise ValueError(
                f"{self.folder} has {completed} of {count} frames, and its status is {status!r}: finish the dataset by running its command "
                "again, with each `--shard` if it has shards"
            )
        self.class_weights, self.class_pixels = totals["class_weights"], totals["class_pixels"]
        self.channel_mean, self.channel_std = totals["channel_mean"], totals["channel_std"]
        splits = self.manifest.get("splits") or {}
        if split is not None and split not in splits:
            raise ValueError(f"split = {split!r}: {self.folder} has {', '.join(splits) or 'no splits'}")
        self.records = sorted(
            (record for record in _records_of(self.folder, self.manifest) if split is None or record.get("split", "") == split),
            key=lambda record: int(record["index"]),
        )

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, index: int) -> Any:
        from PIL import Image

        record = self.records[index]
        arrays: dict[str, np.ndarray[Any, Any]] = {}
        size = tuple(self.manifest["size"])
        for name in record["hashes"]:
            path = self.folder / name
            if path.suffix not in (".png", ".npy") or path.parent.name == "preview":
                continue
            stem = path.stem.rsplit("_", 1)[0]
            try:
                arrays[stem] = np.load(path) if path.suffix == ".npy" else np.array(Image.open(path))
                if arrays[stem].shape[1::-1] != size:
                    raise ValueError(f"it has {arrays[stem].shape[1::-1]} pixels, {size} are expected")
            except (OSError, ValueError, EOFError, SyntaxError) as error:
                raise ValueError(f"{path} cannot be read ({error}); {_remedy(self.folder)}") from None
        ordered = {name: arrays[name] for name in sorted(arrays, key=lambda name: (name != "rgb", name != "mask", name))}
        made = sample(Frame(ordered), self.as_uint8)
        return made if self.transform is None else self.transform(made)
