"""Trains a small U-Net on frames that are rendered while it trains, and tests it on frames of another preset.

    pip install . torch pillow                        # in a checkout
    python train_segmentation.py                      # renders what it trains on: no files
    python train_segmentation.py --data data/train    # or takes the frames of a finished dataset

It prints the loss and the IoU of each class, and writes an image of predictions. `--least-iou` makes it fail below a mean IoU.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
import regolith_render as rr
import torch
from numpy.typing import NDArray
from PIL import Image
from regolith_render.torch import MoonDataset, MoonFolder
from torch import Tensor, nn
from torch.nn import functional as F

parser = argparse.ArgumentParser(description="Trains a small U-Net on rendered frames.")
parser.add_argument("--preset", default="train_dr", help="what it trains on")
parser.add_argument("--test-preset", default="test_photoreal", help="what it is tested on")
parser.add_argument("--data", help="train on this finished dataset instead, made in the layout `folder`")
parser.add_argument("--size", type=int, default=128, help="pixels a side, a multiple of 8")
parser.add_argument("--batch", type=int, default=8)
parser.add_argument("--steps", type=int, default=300)
parser.add_argument("--test-frames", type=int, default=32)
parser.add_argument("--adapter", help="a part of the name of a GPU, or cpu")
parser.add_argument("--out", default="predictions.png")
parser.add_argument("--least-iou", type=float, default=0.0, help="exit with 1 below this mean IoU")


def block(inputs: int, outputs: int) -> nn.Sequential:
    def half(inputs: int) -> list[nn.Module]:
        return [nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]

    return nn.Sequential(*half(inputs), *half(outputs))


class UNet(nn.Module):
    """Logits (B, classes, H, W) of images (B, 3, H, W), whose sides are multiples of 8."""

    def __init__(self, classes: int, mean: list[float], std: list[float], widths: tuple[int, ...] = (16, 24, 32, 48)) -> None:
        super().__init__()
        self.mean = nn.Parameter(torch.tensor(mean).reshape(1, 3, 1, 1), requires_grad=False)
        self.std = nn.Parameter(torch.tensor(std).reshape(1, 3, 1, 1), requires_grad=False)
        self.down = nn.ModuleList(block(a, b) for a, b in zip((3, *widths), widths))
        self.up = nn.ModuleList(block(a + b, b) for a, b in zip(widths[:0:-1], widths[-2::-1]))
        self.head = nn.Conv2d(widths[0], classes, 1)

    def forward(self, image: Tensor) -> Tensor:
        x = self.down[0]((image - self.mean) / self.std)
        skips = []
        for level in list(self.down)[1:]:
            skips.append(x)
            x = level(F.max_pool2d(x, 2))
        for level in self.up:
            x = level(torch.cat([F.interpolate(x, scale_factor=2.0), skips.pop()], 1))
        logits: Tensor = self.head(x)
        return logits


def statistics(data: MoonDataset | MoonFolder) -> tuple[list[float], list[float], list[float]]:
    """Mean and deviation of each channel, and the weight of each class in the loss: by a dataset's manifest, or a few frames."""
    if isinstance(data, MoonFolder):
        return data.channel_mean, data.channel_std, [data.class_weights[name] for name in rr.CLASSES]
    first = list(islice(data, 32))
    data.set_epoch(0)
    images, masks = (torch.stack([sample[name] for sample in first]) for name in ("image", "mask"))
    pixels = torch.stack([masks.eq(class_id).sum() for class_id in rr.CLASSES.values()]).float()
    weights = pixels.median() / pixels.clamp(min=1.0)  # median frequency balancing
    return images.mean((0, 2, 3)).tolist(), images.std((0, 2, 3)).tolist(), weights.clamp(max=10.0).tolist()


def batches(data: MoonDataset | MoonFolder, size: int, steps: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Batches without end, half of them mirrored, brighter or darker: epoch after epoch."""
    made = 0
    for epoch in range(steps):
        if isinstance(data, MoonDataset):
            data.set_epoch(epoch)
        # The dataset renders ahead on threads of its own, so no worker processes are needed.
        loader = torch.utils.data.DataLoader(data, batch_size=size, shuffle=isinstance(data, MoonFolder), drop_last=True)
        for batch in loader:
            image, mask = batch["image"], batch["mask"]
            if made % 2:
                image, mask = image.flip(3), mask.flip(2)
            yield (image * 2.0 ** (2.0 * torch.rand(len(image), 1, 1, 1) - 1.0)).clamp(max=1.0), mask
            made += 1


def confusion(network: UNet, frames: list[rr.Frame]) -> tuple[NDArray[np.int64], list[NDArray[np.uint8]]]:
    """How often each class (row) was taken for each (column), and the predicted masks."""
    network.eval()
    counts, masks = np.zeros((3, 3), np.int64), []
    for frame in frames:
        with torch.no_grad():
            image = torch.as_tensor(frame["rgb"]).permute(2, 0, 1)[None].float() / 255.0
            masks.append(network(image)[0].argmax(0).numpy().astype(np.uint8))
        known = frame["mask"] != rr.IGNORE
        counts += np.bincount(3 * frame["mask"][known] + masks[-1][known], minlength=9).reshape(3, 3)
    return counts, masks


def main() -> int:
    options, began = parser.parse_args(), time.monotonic()
    torch.manual_seed(0)
    device = {"size": options.size, "adapter": options.adapter}
    length = options.batch * options.steps
    data = MoonFolder(options.data) if options.data else MoonDataset(options.preset, seed=1, length=length, **device)
    mean, std, weights = statistics(data)
    network = UNet(len(rr.CLASSES), mean, std)
    optimiser = torch.optim.AdamW(network.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=4e-3, total_steps=options.steps)
    for step, (image, mask) in enumerate(islice(batches(data, options.batch, options.steps), options.steps), 1):
        loss = F.cross_entropy(network(image), mask, weight=torch.tensor(weights), ignore_index=rr.IGNORE)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call,unused-ignore]
        optimiser.step()
        schedule.step()
        if step % 25 == 0 or step == options.steps:
            rate = step * options.batch / (time.monotonic() - began)
            print(f"step {step:4}: loss {loss.item():.3f}, {rate:.1f} frames/s", flush=True)

    with rr.Renderer(options.test_preset, **device) as renderer:
        frames = list(renderer.dataset_frames(7777, end=options.test_frames))
    counts, masks = confusion(network, frames)
    union = counts.sum(0) + counts.sum(1) - counts.diagonal()
    iou = counts.diagonal() / np.maximum(union, 1)
    shares = ", ".join(f"{name} {value:.3f}" for name, value in zip(rr.CLASSES, iou))
    print(f"IoU on {len(frames)} frames of {options.test_preset}: {shares}; mean {iou.mean():.3f}; {time.monotonic() - began:.0f} s")
    rows = []
    for frame, predicted in zip(frames[:6], masks):
        other = rr.Frame({"rgb": frame["rgb"], "mask": predicted})
        rows.append(np.concatenate([frame["rgb"], frame.overlay(), other.overlay()], 1))
    Image.fromarray(np.concatenate(rows)).save(options.out)
    print(f"{options.out}: image, truth, prediction")
    return int(iou.mean() < options.least_iou)


if __name__ == "__main__":
    sys.exit(main())
