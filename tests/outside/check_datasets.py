"""Datasets in the hands of the programs that will read them: every Python block of the README's "Formats", word for
word, on 24 frames of each format, held against the masks of the format `folder`; and what no block reads.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

PROGRAM = Path(os.environ["REGOLITH_BINARY"])
README = Path(__file__).parents[2] / "README.md"
FRAMES = 24
FORMATS = ("basic", "coco", "cityscapes", "hf", "webdataset")


def fail(message: str) -> None:
    sys.exit(f"tests/outside/check_datasets.py: {message}")


def make(folder: Path) -> None:
    """A small dataset with instances in `data/moon`, and each other format beside it."""
    environment = {**os.environ, "WGPU_ADAPTER_NAME": "cpu"}
    options = "--size 64 --samples 1 --preset train_dr --outputs rgb,mask,instances --quiet".split()
    command = [PROGRAM, "dataset", "--count", str(FRAMES), "--out", "data/moon", *options]
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    for name in FORMATS:
        command = [PROGRAM, "convert", "data/moon", "--format", name, "--out", f"data/{name}", "--quiet"]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def readme_blocks() -> dict[str, str]:
    """The Python blocks of the README's section "Formats" by the path that they read."""
    section = README.read_text().split("\n### Formats\n")[1].split("\n**Masks of other")[0]
    blocks = re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)
    return {re.search(r'"data/(\w+)', block)[1]: block for block in blocks}


def pictures(folder: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """What every reader must give: RGB and class ids."""
    read = lambda name, i: np.asarray(Image.open(folder / f"data/moon/{name}/{name}_{i:05}.png"))
    return [(read("rgb", i), read("mask", i)) for i in range(FRAMES)]


def check_block(name: str, block: str, truth: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Runs a block and compares its `frames`; COCO's masks hold rocks alone."""
    scope: dict = {}
    exec(compile(block, f"README.md ({name})", "exec"), scope)
    frames = scope["frames"]
    if len(frames) != FRAMES:
        fail(f"{name}: {len(frames)} frames, not {FRAMES}")
    for index, ((image, mask), (true_image, true_mask)) in enumerate(zip(frames, truth, strict=True)):
        expected = (true_mask == 1).astype(np.uint8) if name == "coco" else true_mask
        if image.dtype != np.uint8 or not np.array_equal(image, true_image):
            fail(f"{name}: picture {index} differs")
        if mask.dtype != np.uint8 or not np.array_equal(mask, expected):
            fail(f"{name}: mask {index} differs: ids {np.unique(mask)} for {np.unique(expected)}")
        if name != "coco" and not (mask == 0).any():
            fail(f"{name}: class 0 is gone from mask {index}")
    print(f"{name:<12} {FRAMES} frames: pictures and ids as in folder")


def check_coco(data: Path) -> None:
    """Areas and boxes by the official tools; panoptic segments by the format's rules."""
    from pycocotools import mask as masks

    instances = json.loads((data / "annotations/instances_train.json").read_text())
    for row in instances["annotations"]:
        if masks.area(row["segmentation"]) != row["area"]:
            fail(f"coco: annotation {row['id']}: area {row['area']} is not that of its mask")
        if masks.toBbox(row["segmentation"]).tolist() != row["bbox"]:
            fail(f"coco: annotation {row['id']}: box {row['bbox']} is not that of its mask")
    panoptic = json.loads((data / "annotations/panoptic_train.json").read_text())
    things = {row["id"]: row["isthing"] for row in panoptic["categories"]}
    for row in panoptic["annotations"]:
        colours = np.asarray(Image.open(data / "annotations/panoptic_train" / row["file_name"])).astype(np.uint32)
        segments = colours @ np.array([1, 256, 65536], np.uint32)
        ids, areas = np.unique(segments[segments > 0], return_counts=True)
        listed = {segment["id"]: segment for segment in row["segments_info"]}
        if set(ids.tolist()) != listed.keys():
            fail(f"coco: {row['file_name']}: the segments are not those that are listed")
        for segment, area in zip(ids.tolist(), areas.tolist(), strict=True):
            rows, columns = np.nonzero(segments == segment)
            box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            if listed[segment]["area"] != area or listed[segment]["bbox"] != [float(side) for side in box]:
                fail(f"coco: {row['file_name']}: area or box of segment {segment}")
        stuff = [s["category_id"] for s in row["segments_info"] if not things[s["category_id"]]]
        if len(stuff) != len(set(stuff)):
            fail(f"coco: {row['file_name']}: a class of stuff has two segments")
    print(f"{'coco':<12} {len(instances['annotations'])} rocks: areas and boxes; panoptic segments tile the pictures")


def check_flat(data: Path, truth: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """BasicWriter and Cityscapes: by their names."""
    for index, (image, mask) in enumerate(truth):
        flat = data / "basic"
        city = data / f"cityscapes/gtFine/train/moon/moon_000000_{index:06}_gtFine_labelTrainIds.png"
        left = data / f"cityscapes/leftImg8bit/train/moon/moon_000000_{index:06}_leftImg8bit.png"
        for picture, labels in ((flat / f"rgb_{index:04}.png", flat / f"semantic_segmentation_{index:04}.png"), (left, city)):
            if not np.array_equal(np.asarray(Image.open(picture)), image):
                fail(f"{picture} differs")
            if not np.array_equal(np.asarray(Image.open(labels)), mask):
                fail(f"{labels} differs")
        names = json.loads((flat / f"semantic_segmentation_labels_{index:04}.json").read_text())
        if {int(key): row["class"] for key, row in names.items()} != {0: "regolith", 1: "rock", 2: "sky"}:
            fail(f"basic: labels of frame {index}")
    print(f"{'basic':<12} {FRAMES} frames: pictures, ids and names\n{'cityscapes':<12} {FRAMES} frames: pictures and ids")


def main() -> None:
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["HF_HOME"] = str(folder / "cache")
        os.chdir(folder)
        make(folder)
        truth = pictures(folder)
        blocks = readme_blocks()
        if blocks.keys() != {"moon", "hf", "coco", "webdataset"}:
            fail(f"the README reads {sorted(blocks)}")
        for name, block in blocks.items():
            check_block(name, block, truth)
        check_coco(folder / "data/coco")
        check_flat(folder / "data", truth)
        os.chdir("/")


if __name__ == "__main__":
    main()
