"""Datasets for PyTorch: frames rendered while a network trains, and finished datasets from their folders.

PyTorch is imported here and nowhere else in the package.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from ._frame import Frame
from ._renderer import Knobs, Renderer

Sample = dict[str, Any]
"""Tensors by name of the output, and what a transform makes of them."""

Transform = Callable[[Sample], Any]


def _tensor(name: str, array: np.ndarray[Any, Any], as_uint8: bool) -> torch.Tensor:
    """An array as a tensor for a loss: images (3, H, W) float32 in [0, 1], or uint8; masks and ids int64; the rest as it is."""
    if name == "mask" or array.dtype == np.uint16:
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

    Frame i goes to worker i mod n of rank r: which frames there are does not depend on the number of workers, and ranks of a distributed
    run share them out. Each worker opens a device of its own at its first frame. Workers that are forked after the device was opened in
    their parent get an error; start them by `multiprocessing_context="spawn"`.

    preset, outputs, and further arguments: those of `Renderer`. seed: the base seed. length: number of frames of an epoch; None for no
    end. transform: what becomes of each sample. as_uint8: images as they are, without conversion.
    """

    def __init__(
        self,
        preset: str | Iterable[str] | None = None,
        outputs: str | Iterable[str] = ("rgb", "mask"),
        seed: int = 42,
        length: int | None = None,
        transform: Transform | None = None,
        *,
        as_uint8: bool = False,
        prefetch: int = 2,
        set: Knobs | None = None,
        **renderer: Any,
    ) -> None:
        super().__init__()
        self.renderer = Renderer(preset, outputs=outputs, set=set, **renderer)
        self.seed, self.length, self.transform = seed, length, transform
        self.as_uint8, self.prefetch = as_uint8, prefetch
        self._epoch, self._taken = 0, 0

    def set_epoch(self, epoch: int) -> None:
        """The next iteration has the frames of this epoch, which no other epoch has, from the first one."""
        self._epoch, self._taken = epoch, 0

    def state_dict(self) -> dict[str, int]:
        """Where an iteration of this process is: its epoch, and how many frames of all ranks and workers were begun."""
        return {"epoch": self._epoch, "taken": self._taken}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """The next iteration goes on from there."""
        self._epoch, self._taken = state["epoch"], state["taken"]

    def _share(self) -> tuple[int, int]:
        """The number of this worker among all workers of all ranks, and how many there are."""
        rank, ranks = 0, 1
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            rank = torch.distributed.get_rank()
            ranks = torch.distributed.get_world_size()
        worker = get_worker_info()  # type: ignore[no-untyped-call,unused-ignore]
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        # Batches of a loader alternate between its workers; frames of a rank are every `ranks`-th one.
        return rank + ranks * number, ranks * workers

    def __iter__(self) -> Iterator[Any]:
        number, of = self._share()
        # Epochs are apart by more frames than one has, and base seeds by more than all epochs.
        base_seed = (self.seed + 0x9E3779B97F4A7C15 * self._epoch) % 2**64
        first = self._taken + number
        frames = self.renderer.dataset_frames(base_seed, first, of, self.length, self.prefetch)
        for frame in frames:
            self._taken += of
            made = sample(frame, self.as_uint8)
            yield made if self.transform is None else self.transform(made)
        self._taken = 0

    def __len__(self) -> int:
        if self.length is None:
            raise TypeError("this dataset has no end; give it a length")
        return self.length


class MoonFolder(Dataset[Any]):
    """A finished dataset of the layout `folder`, as `regolith-render dataset` writes it: the same samples as `MoonDataset`.

    folder: with `manifest.json`. split: the name of one of its splits; all frames without it. Needs Pillow.

    Attributes, those of all frames of the dataset, for a loss and a normalisation: `class_weights` and `class_pixels` by name of the class,
    `channel_mean` and `channel_std`, three numbers of 0 to 1. `manifest` and `records` are the dataset's own records.
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
        self.folder, self.transform, self.as_uint8 = Path(folder), transform, as_uint8
        self.manifest = json.loads((self.folder / "manifest.json").read_text(encoding="utf-8"))
        totals = self.manifest.get("totals", {})
        missing = [name for name in ("class_weights", "channel_mean") if name not in totals]
        if missing:
            raise ValueError(
                f"{self.folder / 'manifest.json'} has no totals.{missing[0]}: finish the dataset by running its command again, which adds it"
            )
        self.class_weights, self.class_pixels = totals["class_weights"], totals["class_pixels"]
        self.channel_mean, self.channel_std = totals["channel_mean"], totals["channel_std"]
        lines = (self.folder / "frames.jsonl").read_text(encoding="utf-8").splitlines()
        records = (json.loads(line) for line in lines)
        self.records = sorted(
            (record for record in records if split is None or record.get("split", "") == split),
            key=lambda record: int(record["index"]),
        )

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, index: int) -> Any:
        from PIL import Image

        record = self.records[index]
        folder, number = self.folder / record.get("split", ""), f"{record['index']:05}"
        arrays = {}
        for path in sorted(folder.glob(f"*/*_{number}.*")):
            stem = path.name.rsplit("_", 1)[0]
            if path.parent.name == "preview" or path.suffix not in (".png", ".npy"):
                continue
            arrays[stem] = np.load(path) if path.suffix == ".npy" else np.array(Image.open(path))
        ordered = {name: arrays[name] for name in sorted(arrays, key=lambda name: (name != "rgb", name != "mask", name))}
        made = sample(Frame(ordered, json.dumps(record), "{}"), self.as_uint8)
        return made if self.transform is None else self.transform(made)
