"""Settings as texts: read by the type that a configuration declares, refused with a sentence, part of a cell's key."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import pytest

from handbench.bench.changes import assigned, settable
from handbench.bench.plan import make_method, make_plan
from handbench.errors import InputError
from handbench.methods import ENTRIES
from handbench.registry import METHODS, PROTOCOLS
from handbench.settings import Setting, changed, names_in, parted


@dataclass(frozen=True)
class Weights:
    photo: float = 1.0
    rough: float = 2.0


@dataclass(frozen=True)
class Config:
    steps: int = 10
    rate: tuple[float, float] = (1e-3, 1e-4)
    lights: tuple[int, ...] = (1, 2)
    space: Literal["linear", "display"] = "linear"
    gloss: float | None = None
    on: bool = False
    title: str = ""
    weights: Weights = field(default_factory=Weights)

    def __post_init__(self) -> None:
        if self.steps > 1000:
            raise InputError(f"steps {self.steps} are too many")


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("steps", "500", 500),
        ("rate", "1e-2,1e-3", (0.01, 0.001)),
        ("rate", "(0.01, 0.001)", (0.01, 0.001)),
        ("lights", "3", (3,)),
        ("space", "display", "display"),
        ("gloss", "0.25", 0.25),
        ("gloss", "none", None),
        ("on", "True", True),
        ("on", "off", False),
        ("title", "a = b", "a = b"),
    ],
)
def test_a_text_becomes_the_declared_type(name, text, value):
    found = changed(Config(), {name: text}, "toy")
    assert found == replace(Config(), **{name: value})
    assert type(getattr(found, name)) is type(value)


def test_a_point_leads_into_a_configuration():
    assert changed(Config(), {"weights.photo": "3"}, "toy") == Config(weights=Weights(3.0, 2.0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("stesp", "5", r"unknown setting of toy: 'stesp'; did you mean 'steps'"),
        ("weights.phot", "5", r"unknown setting of toy: 'weights.phot'; did you mean"),
        ("weights", "5", r"unknown setting of toy: 'weights'; did you mean 'weights.(photo|rough)' or"),
        ("steps.photo", "5", r"unknown setting of toy: 'steps.photo'"),
        ("steps", "5.5", r"toy: steps is '5.5'; give a whole number, 0 or more"),
        ("steps", "-5", r"give a whole number, 0 or more"),
        ("steps", "9" * 5000, r"give a whole number"),
        ("steps", "2000", r"steps 2000 are too many"),
        ("rate", "1", r"give 2 values with commas between them, each a number, 0 or more"),
        ("rate", "nan,1", r"each a number"),
        ("lights", "1,b", r"give values with commas between them, each a whole number"),
        ("lights", "", r"each a whole number"),
        ("space", "srgb", r"give linear or display"),
        ("gloss", "matt", r"give a number, 0 or more or none"),
        ("on", "2", r"give true or false"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_sentence(name, text, message):
    with pytest.raises(InputError, match=message):
        changed(Config(), {name: text}, "toy")


@pytest.mark.parametrize("text", ["steps", "=5", ":steps=5", "urhand:=5", ""])
def test_a_setting_needs_a_name_and_a_value(text):
    with pytest.raises(InputError, match="write steps=500, or urhand:steps=500"):
        Setting.parse(text)


def test_a_setting_can_name_its_methods():
    assert Setting.parse("steps=5") == Setting("steps", "5")
    assert Setting.parse("urhand*:rate=1e-3,1e-4") == Setting("rate", "1e-3,1e-4", "urhand*")


def test_parts_take_what_is_theirs():
    assert parted({"a.x": "1", "b.y.z": "2"}, ("a", "b"), "toy") == ({"x": "1"}, {"y.z": "2"})
    for name in ("x", "c.x"):
        with pytest.raises(InputError, match="unknown setting of toy"):
            parted({name: "1"}, ("a", "b"), "toy")


@pytest.mark.parametrize("name", [entry.name for entry in ENTRIES if entry.presets])
def test_every_method_with_presets_can_be_set_as_its_configuration_says(name):
    """Each number of its configuration, given as text, is what `config` then holds; so it is in a cell's key."""
    entry, preset = METHODS.entry(name), "quick"
    names = settable({name: entry}, {name: preset})[name]
    numbers = {key: value for key, value in names.items() if type(value) in (int, float) and value}
    assert numbers
    key, value = next(iter(numbers.items()))
    entry = replace(entry, changes=((key, str(type(value)(value * 2))),))
    assert dict(names_in(make_method(entry, preset).config))[key] == value * 2


def test_a_setting_goes_to_the_methods_that_have_it():
    entries = {name: METHODS.entry(name) for name in ("oracle", "mean", "phong", "transfer")}
    presets = dict.fromkeys(entries, "quick")

    def of(*texts: str) -> dict:
        return dict(assigned([Setting.parse(text) for text in texts], entries, presets))

    assert of("texture=64") == {"phong": (("texture", "64"),), "transfer": (("texture", "64"),)}
    assert of("transfer:texture=64", "fit_frames=8") == {
        "phong": (("fit_frames", "8"),),
        "transfer": (("texture", "64"),),
    }
    assert of("fit_frames=48") == {}, "as it is already"
    for text, message in (
        ("txture=64", "unknown setting 'txture'; did you mean 'texture'"),
        ("phnog:texture=64", "unknown method 'phnog'; did you mean 'phong'"),
        ("transfer:fit_frames=2", "unknown setting of transfer: 'fit_frames'"),
        ("mean:texture=2", "'texture' cannot be set: mean take no settings"),
        ("texture=a", "phong: texture is 'a'; give a whole number"),
    ):
        with pytest.raises(InputError, match=message):
            of(text)


def test_settings_are_in_the_key_of_their_method_alone():
    smoke = PROTOCOLS.load("smoke")
    plain = make_plan(smoke, "digest", ("oracle", "phong")).cells
    plan = make_plan(smoke, "digest", ("oracle", "phong"), changes=(("phong", (("texture", "64"),)),)).cells
    by_method = {name: [c for c in plan if c.method == name] for name in ("oracle", "phong")}
    assert [c.key for c in by_method["oracle"]] == [c.key for c in plain if c.method == "oracle"]
    assert not {c.key for c in by_method["phong"]} & {c.key for c in plain}
    assert {c.changes for c in by_method["phong"]} == {(("texture", "64"),)}
    as_text = make_plan(smoke, "digest", ("phong",), changes=(("phong", (("texture", "064"),)),)).cells
    assert as_text[0].prior == by_method["phong"][0].prior, "what counts is the value"
