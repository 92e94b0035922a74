"""Large pictures through the networks in tiles: the same features, without holding those of the whole picture.

A tile is cut with a margin as wide as the networks see, and only the features of its own pixels count, so they equal
those of the whole picture but for the order of sums. Tiles begin at multiples of the networks' greatest stride.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

LARGEST = 1 << 20  # pixels that go through in one piece: VGG-16 takes about 1 kB for each
SIDE = 768
MARGIN = 112  # the fifth stage of VGG-16 with windows of 3 pixels for pooling sees 105 pixels around, AlexNet 93


@dataclass(frozen=True)
class Tile:
    """`cut` is what goes through the network, `own` the pixels that count; (rows, columns) of the picture."""

    cut: tuple[slice, slice]
    own: tuple[slice, slice]

    def features(self, stride: int) -> tuple[slice, slice]:
        """The tile's own features in those of its cut, of a layer with that stride."""
        rows, columns = (
            slice((own.start - cut.start) // stride, None if own.stop == cut.stop else (own.stop - cut.start) // stride)
            for own, cut in zip(self.own, self.cut, strict=True)
        )
        return rows, columns


def tiles(height: int, width: int) -> Iterator[Tile]:
    """The picture in one piece, or in rows of tiles if it is larger than `LARGEST`."""
    side = SIDE if height * width > LARGEST else max(height, width)
    for rows in _spans(height, side):
        for columns in _spans(width, side):
            own = (rows, columns)
            cut = tuple(
                slice(max(span.start - MARGIN, 0), min(span.stop + MARGIN, size))
                for span, size in zip(own, (height, width), strict=True)
            )
            yield Tile((cut[0], cut[1]), own)


def _spans(size: int, side: int) -> list[slice]:
    """Spans of `side`, the last one longer if what is left is less than half of it."""
    count = max(1, (size + side // 2) // side)
    return [slice(i * side, (i + 1) * side if i + 1 < count else size) for i in range(count)]
