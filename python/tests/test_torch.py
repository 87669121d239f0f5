"""Datasets for PyTorch: the same frames in the same order for any number of workers and ranks, resumable."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import regolith_render as rr  # noqa: E402
from conftest import ADAPTER, program  # noqa: E402
from regolith_render.torch import MoonDataset, MoonFolder  # noqa: E402

SIZE = 32


def dataset(length: int | None = 7) -> MoonDataset:
    return MoonDataset("train_dr", seed=5, length=length, size=SIZE, adapter=ADAPTER)


def images(samples: object) -> list[np.ndarray]:
    return [np.asarray(sample["image"]) for sample in samples]  # type: ignore[attr-defined]


def test_samples_are_ready_for_a_loss() -> None:
    first = next(iter(dataset()))
    assert first["image"].shape == (3, SIZE, SIZE) and first["image"].dtype == torch.float32
    assert 0.0 <= first["image"].min() and first["image"].max() <= 1.0
    assert first["mask"].shape == (SIZE, SIZE) and first["mask"].dtype == torch.int64
    logits = torch.zeros(1, 3, SIZE, SIZE)
    loss = torch.nn.functional.cross_entropy(logits, first["mask"][None], ignore_index=rr.IGNORE)
    assert abs(loss.item() - np.log(3)) < 1e-6


def test_state_is_resumed_and_epochs_differ() -> None:
    whole = images(dataset())
    assert len(whole) == len(dataset()) == 7
    begun = dataset()
    taken = iter(begun)
    head = images([next(taken) for _ in range(3)])
    again = dataset()
    again.load_state_dict(begun.state_dict())
    resumed = head + images(again)
    assert len(resumed) == 7 and all(map(np.array_equal, resumed, whole))
    other = dataset()
    other.set_epoch(1)
    assert not np.array_equal(images(other)[0], whole[0])


LOADER = """
import sys, hashlib, numpy, torch
from regolith_render.torch import MoonDataset
if __name__ == "__main__":
    method, workers = sys.argv[1], int(sys.argv[2])
    data = MoonDataset("train_dr", seed=5, length=7, size={size}, adapter={adapter!r})
    context = method if workers else None
    for sample in torch.utils.data.DataLoader(data, batch_size=None, num_workers=workers, multiprocessing_context=context):
        print(hashlib.sha256(numpy.asarray(sample["image"]).tobytes()).hexdigest())
"""


@pytest.mark.parametrize(
    ("method", "workers"), [("fork", 1), ("fork", 2), ("fork", 4), ("spawn", 2), ("forkserver", 2)]
)
def test_workers_change_nothing(method: str, workers: int, tmp_path: Path) -> None:
    script = tmp_path / "load.py"
    script.write_text(textwrap.dedent(LOADER.format(size=SIZE, adapter=ADAPTER)))

    def frames(workers: int) -> list[str]:
        ran = subprocess.run(
            [sys.executable, str(script), method, str(workers)], capture_output=True, text=True, timeout=300
        )
        assert ran.returncode == 0, ran.stderr
        return ran.stdout.split()

    alone = frames(0)
    assert len(alone) == 7 and frames(workers) == alone


def test_ranks_share_the_frames_out(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = images(dataset())
    shares = []
    for rank in range(2):
        monkeypatch.setattr(torch.distributed, "is_available", lambda: True)
        monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
        shares.append(images(dataset()))
    assert [len(share) for share in shares] == [4, 3]
    assert all(map(np.array_equal, shares[0], whole[0::2])) and all(map(np.array_equal, shares[1], whole[1::2]))


def test_a_folder_gives_the_same_samples(tmp_path: Path) -> None:
    made = program("dataset", "--preset", "train_dr", "--seed", "5", "--count", "4", "--size", str(SIZE), "--out", str(tmp_path / "d"))
    assert made.returncode == 0, made.stderr
    folder = MoonFolder(tmp_path / "d")
    assert len(folder) == 4
    for stored, rendered in zip((folder[i] for i in range(4)), dataset(4)):
        assert list(stored) == list(rendered) == ["image", "mask"]
        assert all(torch.equal(stored[name], rendered[name]) for name in stored)
