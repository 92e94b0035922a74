"""How much people differ, and what a person's textures cost: `python -m benchmarks.skins [PEOPLE]`."""

from __future__ import annotations

import sys
import time

import numpy as np

from handbench.data.openstage.people import look
from handbench.data.openstage.places import places
from handbench.data.openstage.skin import make_skin
from handbench.hand.openhand import OpenHand
from handbench.scene import Array

_SIDE, _FINER = 64, 4


def explained(people: int, components: int = 5) -> float:
    """Share of variance that the first principal components of people's skins explain.

    Linear albedo of 256 x 256 textures, averaged over the covered texels of 4 x 4 blocks to 64 x 64; blocks that are
    at least half covered, all three channels, around the mean of the people.
    """
    hand, size = OpenHand.load(), _SIDE * _FINER
    covered = places(hand, size).atlas.covered
    share = _blocks(covered.astype(float))
    used = share >= 0.5
    skins = []
    for seed in range(people):
        albedo = make_skin(hand, hand.neutral(), look(seed), size).albedo
        skins.append([_blocks(albedo[..., channel] * covered)[used] / share[used] for channel in range(3)])
    flat = np.array(skins).reshape(people, -1)
    power = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False) ** 2
    return float(power[:components].sum() / power.sum())


def _blocks(image: Array) -> Array:
    return image.reshape(_SIDE, _FINER, _SIDE, _FINER).mean(axis=(1, 3))


def main() -> None:
    people = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    print(f"5 components explain {100 * explained(people):.1f} % of the variance of {people} people's skins")
    hand = OpenHand.load()
    for size in (1024, 2048):
        make_skin(hand, hand.neutral(), look(0), size)
        start = time.process_time()
        make_skin(hand, hand.neutral(), look(9), size)
        print(f"textures of a person at {size}: {time.process_time() - start:.1f} s of processor time")


if __name__ == "__main__":
    main()
