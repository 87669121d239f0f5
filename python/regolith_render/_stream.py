"""Streams of frames that are rendered ahead."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from itertools import islice
from typing import TypeVar

from . import _native
from ._frame import Frame
from ._settings import release_memory

FRAMES_BETWEEN_RELEASES = 100
"""Frames of a stream after which memory that is free goes back to the system."""

FIRST_GROUP = 16
"""Items that are read before the first frame."""

Item = TypeVar("Item")


def streamed_in_parts(
    items: Iterator[Item], ahead: int, start: Callable[[list[Item]], _native.Frames]
) -> Generator[Frame, None, None]:
    """The frames of these items, which are read in groups, from now on: few at first, so that a frame comes soon, then twice as many each
    time, up to `ahead`; `start` starts the stream of a group."""
    size = min(FIRST_GROUP, ahead)

    def part() -> _native.Frames | None:
        nonlocal size
        some = list(islice(items, size))
        size = min(2 * size, ahead)
        return start(some) if some else None

    return streamed(part(), part)


def streamed(
    frames: _native.Frames | None, more: Callable[[], _native.Frames | None] = lambda: None
) -> Generator[Frame, None, None]:
    """The frames of a stream, and of those that `more` returns after it."""
    taken = 0
    try:
        while frames is not None:
            while (frame := frames.next()) is not None:
                yield Frame(*frame)
                taken += 1
                if taken % FRAMES_BETWEEN_RELEASES == 0:
                    release_memory()
            frames.close()
            frames = more()
    finally:
        if frames is not None:
            frames.close()
        release_memory()
