"""Geometry metrics in a protocol: a run on the mini capture scores them beside pictures."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from flat import flat_cells

from handbench.bench.protocol import Protocol
from handbench.bench.run import find_protocol, run
from handbench.metrics import from_signature, metric
from handbench.settings import Setting

ROOT = Path(__file__).parents[2]
METRICS = ("psnr", "depth", "normal", "mask-iou", "chamfer", "vertex", "joint")


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Protocol:
    """The smoke protocol with other metrics, from a file."""
    text = (ROOT / "protocols" / "smoke.toml").read_text()
    asked = tomllib.loads(text)["metrics"]
    assert f"metrics = {asked}".replace("'", '"') in text
    file = tmp_path_factory.mktemp("protocol") / "geometry.toml"
    text = text.replace(f"metrics = {asked}".replace("'", '"'), f"metrics = {list(METRICS)}")
    file.write_text(text.replace('name = "smoke"', 'name = "geometry"'))
    return find_protocol(str(file))


@pytest.fixture(scope="module")
def scores(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], list[dict]]:
    """Scores by method and metric."""
    folder = tmp_path_factory.mktemp("run")
    small = [Setting("texture", "64", "physical"), Setting("fit_frames", "8", "physical")]
    outcome = run(protocol, methods=["oracle", "mean", "physical"], out=folder, settings=small)
    assert not outcome.crashed
    found: dict[tuple[str, str], list[dict]] = {}
    for cell in flat_cells(folder):
        for score in cell["scores"]:
            name = from_signature(score["metric"]).name
            found.setdefault((cell["method"]["name"], name), []).append(score)
    return found


def test_the_oracle_is_perfect(scores: dict[tuple[str, str], list[dict]]) -> None:
    for name in METRICS[:-1]:
        best = 100.0 if name == "psnr" else metric(name).perfect
        assert [s["value"] for s in scores["oracle", name]] == pytest.approx([best] * 8, abs=1e-4), name


def test_methods_that_draw_the_tracked_mesh_have_its_depth_and_normals(
    scores: dict[tuple[str, str], list[dict]],
) -> None:
    for method in ("mean", "physical"):
        for name, low, high in (("depth", 0.05, 1.0), ("normal", 1.0, 12.0), ("mask-iou", 0.95, 1.0)):
            values = [s["value"] for s in scores[method, name]]
            assert values and all(low < v <= high for v in values), (method, name, values)
    assert [s["value"] for s in scores["mean", "depth"]] == [s["value"] for s in scores["physical", "depth"]]


def test_what_a_method_does_not_give_is_a_reason(scores: dict[tuple[str, str], list[dict]]) -> None:
    for method in ("mean", "physical"):
        for name in ("chamfer", "vertex"):
            assert {s["reason"] for s in scores[method, name]} == {"the method gives no mesh"}
    reasons = {(method, s["reason"]) for method in ("oracle", "mean") for s in scores[method, "joint"]}
    assert reasons == {("oracle", "the method gives no joints"), ("mean", "the method gives no joints")}
