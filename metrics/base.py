"""A metric family, a metric (a family with options), its spec, its signature, and the score of one pair.

spec        "psnr" or "psnr:region=box,scale=rgb": what a protocol or the command line says
signature   "psnr|region:box|space:srgb|scale:rgb|mask:alpha>0.5|peak:1|cap:100|v1": what a result carries;
            values with different signatures never share a column
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handbench.errors import InputError, NonFinite, Unsupported, text_of, trace_of, unknown_name
from handbench.metricspec import MetricSpec
from handbench.registry import METRICS

from .pair import Pair
from .view import ALPHA, REGIONS, SCALES, SPACES, Looks, Recent, View


@dataclass(frozen=True)
class Score:
    """The score of one pair: a finite value, or None and the reason why there is none.

    trace    the traceback where the metric of a plug-in crashed, which trying again may help
    """

    value: float | None
    reason: str | None = None
    trace: str | None = None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.reason is None):
            raise InputError(f"score: give a value or a reason, not value {self.value!r} and reason {self.reason!r}")
        if self.value is not None and not math.isfinite(self.value):
            raise NonFinite(f"score: {self.value} is not finite; give None and a reason")


@dataclass(frozen=True)
class AnyFamily(ABC):
    """One way of measuring, before its options are chosen: what `Family` and `PairFamily` share.

    terms      what else the signature must say, in order
    version    goes up whenever the same input would score differently
    perfect    the value of a prediction that equals the truth, where there is one
    needs      fields of the pair that must be there beside the two pictures; what no metric needs is not worked out
    """

    name: str
    title: str
    measure: Callable[..., float]
    higher_is_better: bool
    unit: str = ""
    decimals: int = 3
    terms: tuple[str, ...] = ()
    version: int = 1
    perfect: float | None = None
    needs: tuple[str, ...] = ()

    @property
    @abstractmethod
    def options(self) -> Mapping[str, tuple[str, ...]]:
        """The allowed values of every option, the default first."""

    @abstractmethod
    def stated(self, options: Mapping[str, str]) -> tuple[str, ...]:
        """What the signature says after the chosen options."""

    @abstractmethod
    def value(self, looks: Looks, options: Mapping[str, str]) -> float:
        """The value for a pair under the chosen options; raises `Unsupported` with the reason there is none."""

    @property
    def ours(self) -> bool:
        """Whether handbench itself measures it, and no plug-in."""
        code = getattr(self, "measure", type(self))
        while isinstance(code, partial):
            code = code.func
        return str(getattr(code, "__module__", "")).startswith("handbench.")

    def with_options(self, chosen: Mapping[str, str]) -> Metric:
        """The metric with the chosen options, the rest default. `InputError` for an unknown option or value."""
        for option, value in chosen.items():
            if option not in self.options:
                raise unknown_name(f"option of metric {self.name!r}", option, self.options)
            if value not in self.options[option]:
                raise unknown_name(f"{option} of metric {self.name!r}", value, self.options[option])
        return Metric(self, {option: chosen.get(option, values[0]) for option, values in self.options.items()})


@dataclass(frozen=True)
class Family(AnyFamily):
    """A way of measuring pictures; an image metric's module defines one.

    measure    the value of a view; may raise `Unsupported` with the reason there is none
    regions, spaces, scales    the allowed values of the options, the default first
    of_region  what the signature must say, in front of the terms, only under some regions: {"full": "border:left-out"}
    context    pixels around the region that the value depends on
    least      width and height in pixels of the smallest image the metric is defined for
    """

    measure: Callable[[View], float]
    regions: tuple[str, ...] = REGIONS
    spaces: tuple[str, ...] = SPACES
    scales: tuple[str, ...] = SCALES
    of_region: Mapping[str, str] = field(default_factory=dict, hash=False)
    context: int = 0
    least: int = 1

    def stated(self, options: Mapping[str, str]) -> tuple[str, ...]:
        own = self.of_region.get(options["region"])
        return f"mask:alpha>{ALPHA:g}", *(() if own is None else (own,)), *self.terms

    @property
    def options(self) -> Mapping[str, tuple[str, ...]]:
        return {"region": self.regions, "space": self.spaces, "scale": self.scales}

    def value(self, looks: Looks, options: Mapping[str, str]) -> float:
        return self.measure(looks.view(options, self.context, self.least))


@dataclass(frozen=True)
class PairFamily(AnyFamily):
    """A way of measuring that looks at a pair as it is: geometry, or pictures by rules of its own.

    measure    the value of a pair (of what `seen` gives) under the chosen options; may raise `Unsupported` with the
               reason there is none
    choices    the allowed values of each option, the default first: {"threshold": ("2mm", "1mm", "5mm")}
    needs      fields of the pair that must be there; arrays among them must be finite, or the score has no value
    """

    measure: Callable[[Any, Mapping[str, str]], float]
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=dict, hash=False)
    needs: tuple[str, ...] = ("prediction",)

    def stated(self, options: Mapping[str, str]) -> tuple[str, ...]:
        return self.terms

    @property
    def options(self) -> Mapping[str, tuple[str, ...]]:
        return self.choices

    def value(self, looks: Looks, options: Mapping[str, str]) -> float:
        for name in self.needs:
            found, (whose, _, channel) = getattr(looks.pair, name), name.partition("_")
            what = channel or name  # "prediction" and "truth" are the pictures themselves
            if found is None:
                raise Unsupported(f"the {'method' if whose == 'prediction' else 'capture'} gives no {what}")
            if hasattr(found, "__array__"):
                bad = int(np.count_nonzero(~np.isfinite(_drawn(found, what))))
                if bad:
                    raise Unsupported(f"non-finite {what}: {bad} {'value' if bad == 1 else 'values'}")
        return self.measure(self.seen(looks), options)

    def seen(self, looks: Looks) -> Any:
        """What is measured: the pair, or what is made of it once for several metrics."""
        return looks.pair


@dataclass(frozen=True)
class Metric:
    """A family with its options: calling it scores pairs, each alone, so order and company change nothing."""

    family: AnyFamily
    options: Mapping[str, str] = field(hash=False)

    @property
    def name(self) -> str:
        """The shortest spec of the metric: only options that are not default."""
        return self.family.name + (":" if self._unusual else "") + ",".join(f"{k}={v}" for k, v in self._unusual)

    @property
    def title(self) -> str:
        """For people: "PSNR", or "PSNR (scale rgb)" where options are not default."""
        return self.family.title + (f" ({', '.join(f'{k} {v}' for k, v in self._unusual)})" if self._unusual else "")

    @property
    def latex(self) -> str:
        """The title with an arrow to the better side, e.g. PSNR$\\uparrow$."""
        return self.title + (r"$\uparrow$" if self.higher_is_better else r"$\downarrow$")

    @property
    def unit(self) -> str:
        return self.family.unit

    @property
    def higher_is_better(self) -> bool:
        return self.family.higher_is_better

    @property
    def decimals(self) -> int:
        """Digits after the point in a table."""
        return self.family.decimals

    @property
    def perfect(self) -> float | None:
        """The value of a prediction that equals the truth, where there is one."""
        return self.family.perfect

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of a pair that it is not scored without."""
        return self.family.needs

    @property
    def signature(self) -> str:
        """Everything that decides the value, e.g. "psnr|region:mask|space:srgb|scale:none|…|v1"."""
        chosen = (f"{option}:{value}" for option, value in self.options.items())
        return "|".join((self.family.name, *chosen, *self.family.stated(self.options), f"v{self.family.version}"))

    @property
    def _unusual(self) -> list[tuple[str, str]]:
        return [(k, v) for k, v in self.options.items() if v != self.family.options[k][0]]

    def __call__(self, pairs: Sequence[Pair]) -> list[Score]:
        """One score a pair, in the order of the pairs."""
        return [row[0] for row in scores([self], pairs)]

    def score(self, looks: Looks) -> Score:
        """The score of one pair, sharing what other metrics have already computed of it.

        A plug-in's metric gets arrays of its own, and if it crashes there is no value, so that other metrics hold
        whatever it does. One of ours raises what it raises.
        """
        ours = self.family.ours
        try:
            value = float(self.family.value(looks if ours else Looks(_copied(looks.pair)), self.options))
        except Unsupported as reason:
            return Score(None, str(reason))
        except (Exception, SystemExit) as error:
            if ours or isinstance(error, MemoryError):
                raise
            crash = f"the metric crashed: {type(error).__name__}: {text_of(error)}"[:300]
            return Score(None, crash, trace_of(error))
        return Score(value) if math.isfinite(value) else Score(None, f"{self.family.title} is {value}")


def scores(metrics: Sequence[Metric], pairs: Iterable[Pair], recent: Recent | None = None) -> list[list[Score]]:
    """For each pair the scores of all metrics, in the order of the metrics: what each alone would say, but faster.

    What several metrics need of a pair is computed once, and dropped with the pair, but for what `recent` keeps for
    the next pairs; give the same one for pairs that follow later.
    """
    rows, recent = [], recent or Recent()
    for pair in pairs:
        looks = Looks(pair, recent)
        rows.append([metric.score(looks) for metric in metrics])
    return rows


def _copied(pair: Pair) -> Pair:
    """A pair with arrays of its own; what is drawn only when it is asked for stays as it is."""
    arrays: dict[str, Any] = {
        f.name: array.copy() for f in fields(pair) if isinstance(array := getattr(pair, f.name), np.ndarray)
    }
    return replace(pair, **arrays)


def _drawn(found: Any, what: str) -> NDArray[Any]:
    """An array, worked out if it is not one yet. That is the method's code: where it fails, there is no answer."""
    if isinstance(found, np.ndarray):
        return found
    try:
        drawn = np.asarray(found, np.float64)
    except (Exception, SystemExit) as error:
        trouble = " ".join(f"{type(error).__name__}: {error}".split())
        raise Unsupported(f"the method's {what} could not be drawn: {trouble}") from error
    if drawn.shape != found.shape:
        raise Unsupported(f"the method's {what} has shape {drawn.shape}, announced was {found.shape}")
    return drawn


def metric(spec: str) -> Metric:
    """The metric of a spec: a registered name, and options after a colon, "psnr:region=box,scale=rgb".

    Raises `InputError` for an unknown name, option or value, an option given twice, or a spec that cannot be read.
    """
    found = MetricSpec.parse(spec)
    return _family(found.name).with_options(found.options)


def from_signature(signature: str) -> Metric:
    """The metric that writes this signature; `InputError` if no metric of this version of handbench does."""
    name, *terms = signature.split("|")
    family = _family(name)
    stated = dict(term.split(":", 1) for term in terms if ":" in term)
    found = family.with_options({option: stated[option] for option in family.options if option in stated})
    if found.signature != signature:
        raise InputError(
            f"signature {signature!r} is of another version of {name!r}, which is now {found.signature!r}; score again"
        )
    return found


def _family(name: str) -> AnyFamily:
    family = METRICS.load(name)
    if not isinstance(family, AnyFamily):
        raise InputError(
            f"the metric plug-in {name!r} is a {type(family).__name__}, expected a handbench.metrics.Family"
        )
    return family
