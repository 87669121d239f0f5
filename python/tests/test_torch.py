"""Datasets for PyTorch: the same frames in the same order for any number of workers and ranks, resumable."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import regolith_render as rr  # noqa: E402
from conftest import ADAPTER, program  # noqa: E402
from regolith_render.torch import MoonDataset, MoonFolder  # noqa: E402

SIZE = 32


def dataset(length: int | None = 7) -> MoonDataset:
    return MoonDataset("train_dr", seed=5, length=length, size=SIZE, adapter=ADAPTER)


def images(samples: object) -> list[np.ndarray]:
    return [np.asarray(sample["image"]) for sample in samples]  # type: ignore[attr-defined]


def same(left: list[np.ndarray], right: list[np.ndarray]) -> bool:
    return len(left) == len(right) and all(map(np.array_equal, left, right))


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
    assert len(resumed) == 7 and same(resumed, whole)
    other = dataset()
    other.set_epoch(1)
    assert not np.array_equal(images(other)[0], whole[0])


LOADER = """
import hashlib, numpy, torch
from regolith_render.torch import MoonDataset

def batches(method, workers, batch_size):
    # A dataset of its own each time: workers are forked before its device is opened.
    data = MoonDataset("train_dr", seed=5, length=7, size={size}, adapter={adapter!r}, batch_size=batch_size or 1)
    context = method if workers else None
    loader = torch.utils.data.DataLoader(data, batch_size=batch_size, num_workers=workers, multiprocessing_context=context)
    return [hashlib.sha256(numpy.asarray(batch["image"]).tobytes()).hexdigest() for batch in loader]

if __name__ == "__main__":
    for batch_size, count, methods in ((None, 7, ("fork",)), (3, 3, ("fork", "spawn", "forkserver"))):
        alone = batches("fork", 0, batch_size)
        assert len(alone) == len(set(alone)) == count
        for method in methods:
            for workers in (1, 2, 4):
                assert batches(method, workers, batch_size) == alone, (method, workers, batch_size)
    print("same")
"""


def test_workers_change_nothing(tmp_path: Path) -> None:
    """0, 1, 2 and 4 workers by every start method: the same frames in the same order, and the same batches."""
    script = tmp_path / "load.py"
    script.write_text(LOADER.format(size=SIZE, adapter=ADAPTER))
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=600)
    assert (ran.returncode, ran.stdout) == (0, "same\n"), ran.stderr


EPOCHS = """
import hashlib, sys, numpy, torch
from regolith_render.torch import MoonDataset

def digests(samples):
    return [hashlib.sha256(numpy.asarray(sample["image"]).tobytes()).hexdigest() for sample in samples]

def dataset():
    return MoonDataset("train_dr", seed=5, length=8, size={size}, adapter={adapter!r}, batch_size=2)

def loader(data, **more):
    return torch.utils.data.DataLoader(data, batch_size=2, num_workers=2, multiprocessing_context=sys.argv[1], **more)

if __name__ == "__main__":
    data = dataset()
    kept = loader(data, persistent_workers=True)
    epochs = []
    for epoch in (0, 1, 2):
        data.set_epoch(epoch)
        epochs.append(digests(kept))
    del kept
    assert len(set(sum(epochs, []))) == 12, "epochs share batches"
    for epoch in (0, 2):
        fresh = dataset()
        fresh.set_epoch(epoch)
        assert digests(loader(fresh)) == epochs[epoch]
    # Stopped after one batch of epoch 2, and resumed with a loader of the same kind.
    data.set_epoch(2)
    state = data.state_dict(batches=1)
    assert state == {{"epoch": 2, "taken": 2, "within_batch": 0}}, state
    resumed = dataset()
    resumed.load_state_dict(state)
    again = loader(resumed, persistent_workers=True)
    assert digests(again) == epochs[2][1:]
    assert digests(again) == epochs[2], "the next iteration is a whole one"
    # The same with workers that are started for each iteration.
    resumed.load_state_dict(state)
    restarted = loader(resumed)
    assert digests(restarted) == epochs[2][1:]
    assert digests(restarted) == epochs[2], "a state was used twice"
    # Within a batch: that of the first worker.
    samples = dataset()
    samples.set_epoch(2)
    whole = digests(samples)
    samples.load_state_dict({{"epoch": 2, "taken": 2, "within_batch": 1}})
    alone = torch.utils.data.DataLoader(samples, batch_size=None, num_workers=2, multiprocessing_context="spawn")
    assert sorted(digests(alone)) == sorted(whole[3:])
    # Stopped and resumed twice, by a loop that sets the epoch at its head.
    twice = dataset()
    twice.load_state_dict(state)
    twice.set_epoch(2)
    assert digests(loader(twice)) == epochs[2][1:]
    third = dataset()
    third.load_state_dict(twice.state_dict(batches=1))
    third.set_epoch(2)
    assert digests(loader(third)) == epochs[2][2:]
    third.set_epoch(2)
    assert digests(loader(third)) == epochs[2], "from the first frame"
    print("same")
"""


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_follow_epochs_and_states(method: str, tmp_path: Path) -> None:
    script = tmp_path / "epochs.py"
    script.write_text(EPOCHS.format(size=SIZE, adapter=ADAPTER))
    ran = subprocess.run([sys.executable, str(script), method], capture_output=True, text=True, timeout=300)
    assert (ran.returncode, ran.stdout) == (0, "same\n"), ran.stderr


STATES = """
import hashlib, sys, numpy, torch
from regolith_render.torch import MoonDataset

def data_and_loader(workers):
    data = MoonDataset("train_dr", seed=5, length=7, size=16, adapter={adapter!r}, batch_size=2)
    context = sys.argv[1] if workers else None
    return data, torch.utils.data.DataLoader(data, batch_size=2, num_workers=workers, multiprocessing_context=context)

if __name__ == "__main__":
    for workers in (2, 1, 0):
        data, loader = data_and_loader(workers)
        state = {{"epoch": 1, "taken": 4, "within_batch": 0}}
        data.load_state_dict(state)
        passes = []
        for first in (4, 0, 0):
            torch.manual_seed(3)
            digests = []
            for number, batch in enumerate(loader, 1):
                # The last batch has one frame, and counts as whole.
                expected = {{"epoch": 1, "taken": first + 2 * number, "within_batch": 0}}
                assert data.state_dict(batches=number) == expected, (workers, number, data.state_dict(batches=number))
                digests.append(hashlib.sha256(numpy.asarray(batch["image"]).tobytes()).hexdigest())
            passes.append(digests)
        assert len(set(passes[1])) == 4 and passes[0] == passes[1][2:] and passes[2] == passes[1], (workers, passes)
        # A state of which workers know that it was used: the epoch begins again.
        data.load_state_dict(state)
        assert len(list(loader)) == 2
        data.set_epoch(1)
        assert data.state_dict(batches=0)["taken"] == 0
        assert len(list(loader)) == 4
    print("same")
"""


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_state_counts_in_the_iteration_and_is_used_once(method: str, tmp_path: Path) -> None:
    """Also if PyTorch is seeded with the same number before each."""
    script = tmp_path / "states.py"
    script.write_text(STATES.format(adapter=ADAPTER))
    ran = subprocess.run([sys.executable, str(script), method], capture_output=True, text=True, timeout=300)
    assert (ran.returncode, ran.stdout) == (0, "same\n"), ran.stderr


def test_a_state_after_an_epoch_is_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    data, again = dataset(), dataset()
    assert len(images(data)) == 7
    state = data.state_dict()
    assert state == {"epoch": 0, "taken": 7, "within_batch": 0}
    again.load_state_dict(state)
    assert images(again) == [] and len(images(again)) == 7
    again.set_epoch(1)
    assert again.state_dict()["taken"] == 0
    # Of another rank's share too, which ends later.
    monkeypatch.setattr(torch.distributed, "is_available", lambda: True)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 0)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    first = MoonDataset("train_dr", seed=5, length=7, size=SIZE, adapter=ADAPTER, batch_size=1)
    assert len(images(first)) == 4 and first.state_dict() == first.state_dict(batches=4) == state
    with pytest.raises(rr.ConfigError, match="batches = 5: a whole number from 0 to 4"):
        first.state_dict(batches=5)


def test_a_state_in_the_middle_of_a_batch_is_resumed() -> None:
    data = MoonDataset("train_dr", seed=5, length=7, size=SIZE, adapter=ADAPTER, batch_size=3)
    whole = images(data)
    assert len(whole) == 7 and same(whole, images(dataset()))
    taken = iter(data)
    head = images([next(taken) for _ in range(4)])
    assert data.state_dict() == {"epoch": 0, "taken": 3, "within_batch": 1}
    again = MoonDataset("train_dr", seed=5, length=7, size=SIZE, adapter=ADAPTER, batch_size=3)
    again.load_state_dict(data.state_dict())
    assert same(head + images(again), whole)


def test_wrong_arguments_are_named() -> None:
    for wrong, says in (
        ({"length": 0}, "length = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"batch_size": 0}, "batch_size = 0"),
        ({"prefetch": 0}, "prefetch = 0"),
        ({"as_uint8": "no"}, "as_uint8 = 'no': True or False"),
        ({"transform": 5}, "transform = 5: a function"),
        ({"outputs": "rgbd"}, "did you mean `rgb`"),
    ):
        with pytest.raises(rr.ConfigError, match=says):
            MoonDataset("train_dr", **wrong)  # type: ignore[arg-type]
    with pytest.raises(rr.ConfigError, match="epoch = -1"):
        dataset().set_epoch(-1)
    with pytest.raises(rr.ConfigError, match="state_dict"):
        dataset().load_state_dict({})
    with pytest.raises(rr.ConfigError, match="taken = 3: a multiple of batch_size = 2"):
        MoonDataset(batch_size=2).load_state_dict({"epoch": 0, "taken": 3, "within_batch": 0})
    with pytest.raises(rr.ConfigError, match="taken = 8: a whole number from 0 to 7"):
        dataset().load_state_dict({"epoch": 0, "taken": 8, "within_batch": 0})
    with pytest.raises(rr.ConfigError, match=r"batches = 1: MoonDataset\(batch_size=...\) is expected"):
        dataset().state_dict(batches=1)
    begun = MoonDataset(batch_size=2)
    begun.load_state_dict({"epoch": 0, "taken": 2, "within_batch": 1})
    with pytest.raises(rr.ConfigError, match="batches = 3"):
        begun.state_dict(batches=3)
    with pytest.raises(TypeError, match="length"):
        len(dataset(None))
    # An error in a worker arrives as itself.
    data = MoonDataset("train_dr", size=SIZE, adapter="Voodoo")
    with pytest.raises(rr.NoAdapterError, match="Voodoo"):
        next(iter(torch.utils.data.DataLoader(data, num_workers=1, multiprocessing_context="fork")))


def test_tensors_share_memory_with_a_frame() -> None:
    frame = rr.Renderer("train_dr", size=SIZE, outputs="all", adapter=ADAPTER).render(4)
    for name, array in frame.items():
        if array.dtype == np.uint16:  # PyTorch before 2.3 has no such type
            continue
        tensor = torch.from_dlpack(array)
        assert tensor.data_ptr() == array.__array_interface__["data"][0], name
        tensor.zero_()
        assert not array.any()


def test_ranks_share_the_frames_out(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = images(dataset())
    shares = []
    for rank in range(2):
        monkeypatch.setattr(torch.distributed, "is_available", lambda: True)
        monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
        shares.append(images(dataset()))
    # Workers that are not forked get the dataset pickled, and know of no other rank. Other copies have none.
    copied = pickle.dumps(dataset())
    monkeypatch.setattr("multiprocessing.context.get_spawning_popen", lambda: "a worker")
    pickled = pickle.dumps(dataset())
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: False)
    assert same(images(pickle.loads(pickled)), shares[1])
    assert same(images(pickle.loads(copied)), whole)
    assert [len(share) for share in shares] == [4, 3]
    assert same(shares[0], whole[0::2]) and same(shares[1], whole[1::2])


def test_a_damaged_folder_is_an_error_that_names_what_is_wrong(tmp_path: Path) -> None:
    out = tmp_path / "d"
    made = program("dataset", "--count", "3", "--size", "16", "--samples", "1", "--out", str(out), "-q")
    assert made.returncode == 0, made.stderr
    manifest, records = (out / "manifest.json").read_text(), (out / "frames.jsonl").read_text()
    two = records[: records[:-1].rindex("\n") + 1]
    for name, text, says in (
        ("frames.jsonl", two, "d has the records of 2 frames, .* counts 3; run the command .* verify"),
        ("frames.jsonl", records[:-30], "frames.jsonl, line 3 is no record .*; run the command .* verify"),
        ("frames.jsonl", records + "{}\n", "frames.jsonl, line 4 is no record of a frame .it has no index"),
        ("frames.jsonl", two + two[: two.index("\n") + 1], "line 3 is no record of a frame .frame 0 has one above"),
        ("manifest.json", manifest.replace('"done"', '"running"'), "d has 3 of 3 frames, and its status is 'running': finish"),
        ("frames.jsonl", "7\n" + records, "frames.jsonl, line 1 is no record of a frame .an object is expected"),
        ("manifest.json", "{", "manifest.json is no manifest .*; delete it"),
        ("manifest.json", "[]", "manifest.json is no manifest .an object is expected"),
        ("manifest.json", "{}", "manifest.json has no totals.class_weights"),
    ):
        (out / name).write_text(text)
        with pytest.raises(ValueError, match=says):
            MoonFolder(out)
        (out / "manifest.json").write_text(manifest)
        (out / "frames.jsonl").write_text(records)
    assert len(MoonFolder(out)) == 3
    mask = out / "mask" / "mask_00001.png"
    image = mask.read_bytes()
    Image.new("L", (8, 8)).save(out / "small.png")
    for content, says in (
        (None, "No such file"),
        (b"", "cannot identify"),
        (image[:-30], "truncated"),
        ((out / "small.png").read_bytes(), r"\(8, 8\) pixels, \(16, 16\) are expected"),
    ):
        if content is None:
            mask.unlink()
        else:
            mask.write_bytes(content)
        with pytest.raises(ValueError, match=f"mask_00001.png cannot be read .*{says}.*; run the command .* verify"):
            MoonFolder(out)[1]
        mask.write_bytes(image)
    assert MoonFolder(out)[1]["mask"].shape == (16, 16)


def test_a_part_of_a_dataset_is_unfinished(tmp_path: Path) -> None:
    command = ("dataset", "--size", "16", "--samples", "1", "--split", "train=2,val=2", "--out", str(tmp_path), "-q")
    for shard in ("0/2", "1/2"):
        made = program(*command, "--shard", shard)
        assert made.returncode == 0, made.stderr
        if shard == "0/2":
            with pytest.raises(ValueError, match="has 2 of 4 frames, .* with each `--shard`"):
                MoonFolder(tmp_path, "train")
    assert len(MoonFolder(tmp_path)) == 4


def test_a_folder_gives_the_same_samples(tmp_path: Path) -> None:
    outputs = ("rgb", "mask", "depth", "instances", "normals")
    options = ["--seed", "5", "--size", str(SIZE), "--outputs", ",".join(outputs), "--split", "train=3,val=2"]
    made = program("dataset", "--preset", "train_dr", *options, "--out", str(tmp_path / "d"))
    assert made.returncode == 0, made.stderr
    folder = MoonFolder(tmp_path / "d")
    assert len(folder) == 5 and len(MoonFolder(tmp_path / "d", "train")) == 3
    rendered_ones = MoonDataset("train_dr", outputs, seed=5, length=5, size=SIZE, adapter=ADAPTER)
    for stored, rendered in zip((folder[i] for i in range(5)), rendered_ones, strict=True):
        assert set(stored) == set(rendered) and list(stored)[:2] == ["image", "mask"]
        assert all(torch.equal(stored[name], rendered[name]) for name in stored)
        assert stored["normals"].shape == (3, SIZE, SIZE) and stored["instance_segmentation"].dtype == torch.int64
    assert torch.equal(MoonFolder(tmp_path / "d", "val", as_uint8=True)[1]["mask"], folder[4]["mask"])
    assert set(folder.class_weights) == set(folder.class_pixels) == set(rr.CLASSES)
    assert len(folder.channel_mean) == len(folder.channel_std) == 3 and 0 < folder.channel_mean[0] < 1
    with pytest.raises(ValueError, match="'test'.*train, val"):
        MoonFolder(tmp_path / "d", "test")
    with pytest.raises(FileNotFoundError):
        MoonFolder(tmp_path)
    other = program("dataset", "--count", "1", "--size", "16", "--format", "yolo", "--out", str(tmp_path / "yolo"))
    assert other.returncode == 0, other.stderr
    with pytest.raises(ValueError, match="format"):
        MoonFolder(tmp_path / "yolo")
