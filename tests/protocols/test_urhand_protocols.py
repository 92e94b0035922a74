"""URHand's protocols fit the light stage they name, and hold the numbers of the paper's tables."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest

from handbench.bench.protocol import Protocol
from handbench.bench.resolving import resolve
from handbench.data.openstage import presets, stage
from handbench.registry import PROTOCOLS
from handbench.scene import Camera, Directional, Frame, Group, Light, Mesh, Pose, Topology, leaves

NAMES = ("urhand-main", "urhand-main-standard", "urhand-ablation", "urhand-ablation-standard")
TOPOLOGY = Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])


@cache
def frames(size: str) -> tuple[Frame, ...]:
    """The frames of a light stage of this size, without pictures, environments and all but two of the cameras."""
    made = presets.preset(size)
    lights = stage.stage_lights(made)
    trained = made.lights - made.held_out_lights
    lightings: list[tuple[str, str, Light]] = [(f"olat-{i:02d}", "olat", light) for i, light in enumerate(lights)]
    lightings += [(f"group-{k}", "group", Group(lights[k:trained:6][:3])) for k in range(6)]
    lightings.append(("full", "full", Group(lights[:trained])))
    cameras = [Camera(name, 2, 2, np.eye(3), np.eye(3, 4)) for name in made.cameras[:2]]
    subjects = [f"s{i + 1:02d}" for i in range(made.subjects)]
    poses = [("train", i) for i in range(made.train_poses)] + [("held-out", 90 + i) for i in range(made.held_out_poses)]
    mesh, pose = Mesh(np.eye(3), TOPOLOGY), Pose(np.zeros((1, 3)))
    return tuple(
        Frame(subject, f"pose-{number}", name, pose, mesh, camera, light, segment, kind)
        for subject, (segment, number), camera, (name, kind, light) in product(subjects, poses, cameras, lightings)
    )


@pytest.mark.parametrize("name", NAMES)
def test_they_resolve_on_their_capture_and_keep_lights_apart(name: str) -> None:
    protocol: Protocol = PROTOCOLS.load(name)
    selected = resolve(protocol, frames(protocol.size))
    for column in protocol.columns:
        scored = selected.scored[column.name]
        assert {frame.subject for frame in scored} == set(protocol.subjects_of(column))
        assert len(scored) <= column.limit
        assert {frame.segment for frame in scored} == {"held-out"}
    held_out = {tuple(light.direction) for light in stage.stage_lights(presets.preset(protocol.size))[-2:]}
    for frame in (*selected.train, *selected.enrol):
        shown = {tuple(light.direction) for light in leaves(frame.light) if isinstance(light, Directional)}
        assert not shown & held_out, "the last directions are never trained on"
    assert {frame.kind for frame in selected.enrol} == {"full"}
    assert {frame.segment for frame in (*selected.train, *selected.enrol)} == {"train"}


@pytest.mark.parametrize("name", NAMES)
def test_both_sizes_ask_the_same_and_published_numbers_are_plausible(name: str) -> None:
    protocol, quick = PROTOCOLS.load(name), PROTOCOLS.load(name.removesuffix("-standard"))
    assert protocol.published == quick.published and protocol.metrics == quick.metrics
    assert protocol.methods == quick.methods and protocol.seeds == quick.seeds
    assert [column.name for column in protocol.columns] == [column.name for column in quick.columns]
    assert protocol.published_note, "the paper's LPIPS network is unknown, and that must be told"
    for row in protocol.published:
        for _, metric, value in row.values:
            low, high = {"psnr": (10, 30), "ssim": (0.8, 1), "lpips-alex": (0.1, 0.4)}[metric]
            assert low < value < high


def test_the_tables_of_the_paper_are_whole() -> None:
    main, ablation = PROTOCOLS.load("urhand-main"), PROTOCOLS.load("urhand-ablation")
    assert [(row.marker, row.title) for row in main.published] == [
        ("†", "RelightableHands"),
        ("†", "Physical branch only"),
        ("†", "URHand"),
        ("*", "Handy + Phong"),
        ("*", "Handy + GGX"),
        ("*", "URHand"),
    ]
    assert all(len(row.values) == 9 for row in main.published), "three subjects, three metrics"
    assert len(ablation.published) == 11
    lit = [row.method for row in ablation.published if any(column == "fully-lit" for column, _, _ in row.values)]
    assert lit == ["urhand-non-linear", "urhand-linear-consistency", "urhand-mlp-linear", "urhand"]
    assert {row.method for row in ablation.published} <= set(ablation.methods), "every row of the paper is measured"
    assert ablation.seeds == (0, 1, 2)
