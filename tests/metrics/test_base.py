"""Specs, signatures, scores, and the weight of an import."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable

import numpy as np
import pytest
import torch

from handbench.errors import InputError, NonFinite
from handbench.metrics import (
    ENTRIES,
    AnyFamily,
    Family,
    Looks,
    Metric,
    Pair,
    Score,
    View,
    from_signature,
    metric,
    scores,
)
from handbench.registry import METRICS


def every_metric() -> list[Metric]:
    families = [entry.load() for entry in ENTRIES]
    return [
        family.with_options(dict(zip(family.options, values, strict=True)))
        for family in families
        for values in itertools.product(*family.options.values())
    ]


def test_signatures_names_and_headers_are_unique_and_read_back() -> None:
    metrics = every_metric()
    for label in ("signature", "name", "title", "latex"):
        assert len({getattr(m, label) for m in metrics}) == len(metrics), label
    for m in metrics:
        assert from_signature(m.signature).signature == m.signature
        assert metric(m.name).signature == m.signature


def test_the_declared_conventions() -> None:
    assert metric("psnr").signature == "psnr|region:mask|space:srgb|scale:none|mask:alpha>0.5|peak:1|cap:100|v1"
    assert metric("lpips-vgg").signature == "lpips-vgg|region:box|space:srgb|scale:none|mask:alpha>0.5|heads:0.1|v1"
    assert "|border:mirrored|window:gauss11/1.5|" in metric("ssim").signature
    assert "|border:mirrored|" in metric("ssim:region=box").signature
    assert "|border:left-out|" in metric("ssim:region=full").signature
    assert "|border:left-out|window:gauss11/1.5|scales:5|" in metric("ms-ssim").signature
    chosen = metric("psnr: scale=rgb, region=mask")
    assert (chosen.name, chosen.latex) == ("psnr:scale=rgb", r"PSNR (scale rgb)$\uparrow$")
    assert (chosen.unit, chosen.decimals, metric("lpips-alex").latex) == ("dB", 2, r"LPIPS (Alex)$\downarrow$")


def test_the_table_names_its_families() -> None:
    for entry in ENTRIES:
        family = METRICS.load(entry.name)
        assert isinstance(family, AnyFamily) and family.name == entry.name


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("psrn", "unknown metric 'psrn'; did you mean 'psnr'"),
        ("psnr:regoin=box", "unknown option of metric 'psnr' 'regoin'; did you mean 'region'"),
        ("psnr:region=boxes", "unknown region of metric 'psnr' 'boxes'; did you mean 'box'"),
        ("lpips-vgg:space=linear", "unknown space of metric 'lpips-vgg' 'linear'; known: srgb"),
        ("psnr:", "cannot read ''"),
        ("psnr:region", "cannot read 'region'"),
        ("psnr:region=box,region=full", "option 'region' is given twice"),
    ],
)
def test_a_wrong_spec_is_one_clear_sentence(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        metric(spec)


def test_a_signature_of_another_version_is_refused() -> None:
    with pytest.raises(InputError, match="another version of 'psnr'"):
        from_signature(metric("psnr").signature.replace("v1", "v0"))


def of_a_plug_in(measure: Callable[[View], float]) -> Metric:
    return Family("foreign", "Foreign", measure, higher_is_better=False, decimals=2).with_options({})


def test_a_plug_ins_metric_that_crashes_leaves_the_others_their_values() -> None:
    def crash(_: View) -> float:
        raise SystemExit("enough")

    pair = Pair(np.full((16, 16, 3), 0.4), np.full((16, 16, 3), 0.5), np.ones((16, 16)))
    ((lost, kept),) = scores([of_a_plug_in(crash), metric("psnr")], [pair])
    assert kept == metric("psnr")([pair])[0] and kept.value is not None
    assert lost.value is None and lost.reason == "the metric crashed: SystemExit: enough"
    assert lost.trace is not None and "in crash" in lost.trace


def test_a_plug_ins_metric_writes_into_arrays_of_its_own() -> None:
    def spoil(view: View) -> float:
        for array in (view.prediction, view.truth):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # torch warns of read-only arrays, and writes
                torch.from_numpy(array).zero_()
        return 0.0

    pair = Pair(np.full((16, 16, 3), 0.4, np.float32), np.full((16, 16, 3), 0.5, np.float32), np.ones((16, 16)))
    alone = metric("psnr:space=linear")([pair])
    linear = Family("foreign", "Foreign", spoil, higher_is_better=False, spaces=("linear",)).with_options({})
    assert scores([linear, metric("psnr:space=linear")], [pair])[0][1:] == alone


def test_a_metric_of_ours_raises_what_it_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(each.family.ours for each in every_metric())
    pair = Pair(np.full((16, 16, 3), 0.4), np.full((16, 16, 3), 0.5), np.ones((16, 16)))
    monkeypatch.setattr(Looks, "view", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        metric("psnr")([pair])


def test_a_score_is_a_finite_value_or_a_reason() -> None:
    with pytest.raises(NonFinite):
        Score(float("nan"))
    for value, reason in ((None, None), (1.0, "why")):
        with pytest.raises(InputError):
            Score(value, reason)
