"""Reads datasets with the programs that they are made for.

Every Python block of README.md and docs/formats.md that reads a dataset runs here, word for word, on 24 frames of its
format; what it gives is compared with the files of the format `folder`. COCO, BasicWriter, Cityscapes, YOLO and the types of fields in
WebDataset have checks of their own below, and so does the camera code of docs/outputs.md.
"""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
import types
from pathlib import Path

import numpy as np
import yaml
from PIL import Image, ImageOps

PROGRAM = Path(os.environ["REGOLITH_BINARY"])
ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", ROOT / "docs/formats.md")
CAMERA_PAGE = ROOT / "docs/outputs.md"
FRAMES = 24
FORMATS = ("basic", "coco", "cityscapes", "hf", "webdataset", "yolo", "yolo-seg")


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


def python_blocks(page: Path) -> list[str]:
    """The fenced Python blocks of a page."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


def documented_loaders() -> dict[str, str]:
    """The Python blocks that read a dataset, by the name of its folder below `data/`."""
    found = [(re.search(r'"data/(\w+)', block), block) for page in PAGES for block in python_blocks(page)]
    return {match[1]: block for match, block in found if match}


def expected_frames(folder: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """RGB and class ids of every frame, as every reader must give them."""
    read = lambda name, i: np.asarray(Image.open(folder / f"data/moon/{name}/{name}_{i:05}.png"))
    return [(read("rgb", i), read("mask", i)) for i in range(FRAMES)]


def mappings_of(data: Path) -> list[dict]:
    """The instance mapping of every frame of a dataset of the format `folder`."""
    return [json.loads(path.read_text()) for path in sorted((data / "instances").glob("*.json"))]


def check_block(name: str, block: str, truth: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Runs a block and compares its `frames`, of WebDataset its `rocks` too; COCO's masks hold rocks only."""
    scope: dict = {}
    exec(compile(block, f"documented loader ({name})", "exec"), scope)
    frames = scope["frames"]
    if len(frames) != FRAMES:
        fail(f"{name}: {len(frames)} frames, not {FRAMES}")
    for index, ((image, mask), (true_image, true_mask)) in enumerate(zip(frames, truth, strict=True)):
        expected = (true_mask == 1).astype(np.uint8) if name == "coco" else true_mask
        if image.dtype != np.uint8 or not np.array_equal(image, true_image):
            fail(f"{name}: image {index} differs")
        if mask.dtype != np.uint8 or not np.array_equal(mask, expected):
            fail(f"{name}: mask {index} differs: ids {np.unique(mask)} for {np.unique(expected)}")
        if name != "coco" and not (mask == 0).any():
            fail(f"{name}: class 0 is missing from mask {index}")
    if name == "webdataset" and scope["rocks"] != mappings_of(Path("data/moon")):
        fail(f"{name}: its rocks differ")
    print(f"{name:<12} {FRAMES} frames: images and ids as in folder")


def check_coco(data: Path) -> None:
    """Compares areas and boxes with the official tools, and panoptic segments with the format's rules."""
    from pycocotools import mask as masks

    instances = json.loads((data / "annotations/instances_train.json").read_text())
    for row in instances["annotations"]:
        if masks.area(row["segmentation"]) != row["area"]:
            fail(f"coco: annotation {row['id']}: area {row['area']} differs from its mask's")
        if masks.toBbox(row["segmentation"]).tolist() != row["bbox"]:
            fail(f"coco: annotation {row['id']}: box {row['bbox']} differs from its mask's")
    panoptic = json.loads((data / "annotations/panoptic_train.json").read_text())
    is_thing = {row["id"]: row["isthing"] for row in panoptic["categories"]}
    for row in panoptic["annotations"]:
        colours = np.asarray(Image.open(data / "annotations/panoptic_train" / row["file_name"])).astype(np.uint32)
        segments = colours @ np.array([1, 256, 65536], np.uint32)
        ids, areas = np.unique(segments[segments > 0], return_counts=True)
        listed = {segment["id"]: segment for segment in row["segments_info"]}
        if set(ids.tolist()) != listed.keys():
            fail(f"coco: {row['file_name']}: segments differ from those listed")
        for segment, area in zip(ids.tolist(), areas.tolist(), strict=True):
            rows, columns = np.nonzero(segments == segment)
            box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            if listed[segment]["area"] != area or listed[segment]["bbox"] != [float(side) for side in box]:
                fail(f"coco: {row['file_name']}: area or box of segment {segment}")
        stuff = [s["category_id"] for s in row["segments_info"] if not is_thing[s["category_id"]]]
        if len(stuff) != len(set(stuff)):
            fail(f"coco: {row['file_name']}: a stuff class has two segments")
    print(f"{'coco':<12} {len(instances['annotations'])} rocks: areas and boxes; panoptic segments tile the images")


def check_flat(data: Path, truth: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Reads BasicWriter and Cityscapes files by name."""
    for index, (image, mask) in enumerate(truth):
        flat = data / "basic"
        city = data / f"cityscapes/gtFine/train/moon/moon_000000_{index:06}_gtFine_labelTrainIds.png"
        left = data / f"cityscapes/leftImg8bit/train/moon/moon_000000_{index:06}_leftImg8bit.png"
        for rgb, labels in ((flat / f"rgb_{index:04}.png", flat / f"semantic_segmentation_{index:04}.png"), (left, city)):
            if not np.array_equal(np.asarray(Image.open(rgb)), image):
                fail(f"{rgb} differs")
            if not np.array_equal(np.asarray(Image.open(labels)), mask):
                fail(f"{labels} differs")
        names = json.loads((flat / f"semantic_segmentation_labels_{index:04}.json").read_text())
        if {int(key): row["class"] for key, row in names.items()} != {0: "regolith", 1: "rock", 2: "sky"}:
            fail(f"basic: labels of frame {index}")
    print(f"{'basic':<12} {FRAMES} frames: images, ids and names\n{'cityscapes':<12} {FRAMES} frames: images and ids")


def ultralytics_functions() -> dict:
    """The functions of Ultralytics that check images and labels, from its sources: to import it takes PyTorch and OpenCV, some 5 GB."""
    package = Path(importlib.util.find_spec("ultralytics").submodule_search_locations[0])
    scope = {"np": np, "os": os, "Path": Path, "Image": Image, "ImageOps": ImageOps, "torch": types.SimpleNamespace(Tensor=type(None))}
    wanted = {
        "utils/ops.py": ("empty_like", "xyxy2xywh", "segments2boxes"),
        "data/utils.py": ("IMG_FORMATS", "exif_size", "check_image", "img2label_paths", "verify_image_label"),
    }
    for file, names in wanted.items():
        for node in ast.parse((package / file).read_text()).body:
            named = getattr(node, "name", None) or getattr(getattr(node, "targets", [None])[0], "id", None)
            if named in names:
                module = ast.fix_missing_locations(ast.Module([ast.parse("from __future__ import annotations").body[0], node], []))
                exec(compile(module, file, "exec"), scope)
    return scope


def check_yolo(data: Path, truth: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Runs Ultralytics' own check of images and labels, and compares boxes and polygons with the masks."""
    scope, rocks = ultralytics_functions(), {}
    for name in ("yolo", "yolo-seg"):
        described = yaml.safe_load((data / name / "data.yaml").read_text())
        if described != {"train": "images/train", "val": "images/train", "names": {0: "rock"}}:
            fail(f"{name}: data.yaml is {described}")
        images = sorted((data / name / described["train"]).iterdir())
        labels, rocks[name] = scope["img2label_paths"](images), []
        for (image, mask), image_file, label_file in zip(truth, images, labels, strict=True):
            _, boxes, shape, segments, _, missing, _, _, corrupt, message = scope["verify_image_label"](
                (str(image_file), label_file, "", False, 1, 0, 0, False)
            )
            if missing or corrupt or message or shape != mask.shape:
                fail(f"{name}: {label_file}: {message or 'missing, or of another size'}")
            if not np.array_equal(np.asarray(Image.open(image_file)), image):
                fail(f"{name}: {image_file} differs")
            if len(segments) != (len(boxes) if name == "yolo-seg" else 0):
                fail(f"{name}: {label_file}: {len(segments)} polygons for {len(boxes)} rows")
            covered = np.zeros(mask.shape, bool)
            for _, x, y, width, height in boxes:
                left, right = round((x - width / 2) * mask.shape[1]), round((x + width / 2) * mask.shape[1])
                top, bottom = round((y - height / 2) * mask.shape[0]), round((y + height / 2) * mask.shape[0])
                covered[top:bottom, left:right] = True
                if not (mask[top:bottom, left:right] == 1).any():
                    fail(f"{name}: {label_file}: a box without a pixel of rock")
            if (mask[~covered] == 1).any():
                fail(f"{name}: {label_file}: rock outside of all boxes")
            rocks[name].append(np.sort(boxes, axis=0))
    if not all(np.allclose(a, b, atol=1e-5) for a, b in zip(*rocks.values(), strict=True)):
        fail("yolo-seg: its polygons have other boxes than yolo")
    count = sum(len(boxes) for boxes in rocks["yolo"])
    print(f"{'yolo':<12} {count} rocks: boxes and polygons pass Ultralytics' own check and enclose the rocks of the masks")


def check_camera(folder: Path) -> None:
    """Runs the camera code of docs/outputs.md on frames with and without a lens: pixels that are lifted into the world come back to
    where they were, and are as far from the camera as the program says, which a loader that ignores the lens is not."""
    environment = {**os.environ, "WGPU_ADAPTER_NAME": "cpu"}
    [block] = [block for block in python_blocks(CAMERA_PAGE) if '"out/frame_0000.json"' in block]
    lenses = {"pinhole": "", "lens": "--set camera.k1=-0.08 --set camera.k2=0.01 --set camera.p1=0.004 --set camera.p2=-0.003"}
    for name, options in lenses.items():
        command = [PROGRAM, *f"--size 96x64 --outputs rgb,mask,depth,meta --out out --quiet --force {options}".split()]
        subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        scope: dict = {}
        exec(compile(block, CAMERA_PAGE.name, "exec"), scope)
        ground = np.isfinite(scope["depth"])
        back = scope["pixel_of"](scope["world"][ground])
        centres = (scope["u"][ground] + 0.5, scope["v"][ground] + 0.5)
        if max(np.abs(a - b).max() for a, b in zip(back, centres)) > 1e-4:
            fail(f"{CAMERA_PAGE.name}, {name}: pixels do not come back")
        recorded = np.load("out/distance_to_camera_0000.npy")[ground]

        def error(world: np.ndarray) -> float:
            return np.abs(np.linalg.norm(world - scope["pose"][:3, 3], axis=-1)[ground] / recorded - 1).max()

        if error(scope["world"]) > 1e-5:
            fail(f"{CAMERA_PAGE.name}, {name}: distances are off by {error(scope['world']):.1e}")
        scope["lens"][:] = [0.0] * 5
        pinhole = scope["ray_of"](scope["u"] + 0.5, scope["v"] + 0.5)
        ignored = error(scope["pose"][:3, 3] + (scope["depth"][..., None] * pinhole) @ scope["pose"][:3, :3].T)
        if (ignored > 1e-3) != (name == "lens"):
            fail(f"{CAMERA_PAGE.name}, {name}: without the lens distances are off by {ignored:.1e}")
    print(f"{'camera':<12} pixels lifted into the world and projected back, with and without a lens")


def check_types(folder: Path) -> None:
    """Hugging Face's own loader of WebDataset learns the fields of JSON from the first samples: it refuses others of another type, and
    drops keys that are new. Every sample must have the rocks that it has in the format `folder`."""
    from datasets import load_dataset

    both = 'stage.name={choice=["nominal","surface"]}'
    options = "--preset surface_train_full --outputs rgb,mask,instances --size 32 --samples 1 --quiet".split()
    environment = {**os.environ, "WGPU_ADAPTER_NAME": "cpu"}
    out, plain = folder / "data/both", folder / "data/both_plain"
    for path, name in ((out, "webdataset"), (plain, "folder")):
        command = [PROGRAM, "dataset", "--count", str(FRAMES), "--set", both, "--format", name, "--out", path, *options]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    loaded = load_dataset("webdataset", data_files={"train": [str(path) for path in sorted(out.glob("*.tar"))]}, split="train")
    found = [(row["json"]["index"], row["json"]["stage"], np.asarray(row["mask.png"]).shape) for row in loaded]
    lines = [json.loads(line) for line in (out / "frames.jsonl").read_text().splitlines()]
    if found != [(line["index"], line["stage"], (32, 32)) for line in lines] or len({stage for _, stage, _ in found}) < 2:
        fail(f"datasets.load_dataset('webdataset') of both stages gives {found}")
    mappings = mappings_of(plain)
    learnt, others = ({rock for mapping in part for rock in mapping} for part in (mappings[:5], mappings[5:]))
    if not others - learnt:
        fail("types: the first samples have the ids of all rocks: the check shows nothing")
    [field] = [name for name in loaded.column_names if name.startswith("instance_segmentation_mapping")]
    for index, (value, expected) in enumerate(zip(loaded[field], mappings, strict=True)):
        # A field of JSON, as the loader gives it: without keys that it added.
        rocks = json.loads(value) if isinstance(value, str) else {key: rock for key, rock in value.items() if rock is not None}
        if rocks.keys() != expected.keys():
            fail(f"datasets.load_dataset('webdataset'), {field}: sample {index} lacks the rocks {sorted(expected.keys() - rocks.keys())}")
        if rocks != expected:
            fail(f"datasets.load_dataset('webdataset'), {field}: rocks of sample {index} differ")
    count = sum(map(len, mappings))
    print(f"{'types':<12} {len(found)} samples of both stages, {count} rocks, by Hugging Face's loader of WebDataset")


def check_splits() -> None:
    """Hugging Face's loader gives the splits of the card, by names that say nothing to it."""
    from datasets import load_dataset

    splits = {"crater_a": 2, "crater_b": 3}
    listed = ",".join(f"{name}={count}" for name, count in splits.items())
    command = [PROGRAM, "dataset", "--split", listed, "--format", "hf", "--out", "data/splits", *"--size 32 --samples 1 --quiet".split()]
    subprocess.run(command, env={**os.environ, "WGPU_ADAPTER_NAME": "cpu"}, check=True, stdout=subprocess.DEVNULL)
    found = {name: len(split) for name, split in load_dataset("data/splits").items()}
    if found != splits:
        fail(f"datasets.load_dataset gives the splits {found}, not {splits}")
    print(f"{'splits':<12} {found} by Hugging Face's loader")


def main() -> None:
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["HF_HOME"] = str(folder / "cache")
        os.chdir(folder)
        make(folder)
        truth = expected_frames(folder)
        blocks = documented_loaders()
        if blocks.keys() != {"moon", "hf", "coco", "webdataset"}:
            fail(f"the documentation reads {sorted(blocks)}")
        for name, block in blocks.items():
            check_block(name, block, truth)
        check_coco(folder / "data/coco")
        check_flat(folder / "data", truth)
        check_yolo(folder / "data", truth)
        check_camera(folder)
        check_types(folder)
        check_splits()
        os.chdir("/")


if __name__ == "__main__":
    main()
