"""Methods trained once a worker, and their saved weights in bad shape."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from torch import Tensor

from ...bench import given
from ...bench.drawing import light_refusal
from ...bench.lending import Lender, answered
from ...bench.reader import CaptureReader
from ...bench.resolving import resolve
from ...bench.run import find_protocol
from ...data.capture import Capture
from ...errors import InputError, Unsupported
from ...method import Avatar, Method, MethodInfo, Prior
from ...recording import PARTS, Recording
from ...registry import CAPTURES, METHODS, PROTOCOLS
from ...scene import Query


@dataclass(frozen=True)
class Trained:
    """A method trained once on copies of the capture's arrays, as in a run; an avatar, and a query to ask it."""

    method: Method
    reader: CaptureReader
    prior: Prior
    enrolment: Recording
    avatar: Avatar
    query: Query

    def draw(self, query: Query, avatar: Avatar | None = None) -> Any:
        if refusal := light_refusal(self.method.info, query.light):
            raise Unsupported(refusal)
        return answered((avatar or self.avatar).relight(query))


@cache
def _capture() -> Capture:
    return CAPTURES.load("openstage")("mini", None)


def smallest(name: str) -> Method:
    """The method at the preset "smoke" where it has one, else at the one that the smoke protocol names."""
    create = METHODS.load(name)
    try:
        return create(preset="smoke")
    except InputError:
        return create(preset=PROTOCOLS.load("smoke").preset_of(name))


def lacking(info: MethodInfo) -> bool:
    """Whether the shipped light stage has not what a method needs, so that nothing can be tried but the refusal."""
    return bool((info.needs & PARTS) - _capture().offers)


def trained_method(name: str) -> Trained:
    """The method, trained once; an error of its training is raised again for every case."""
    trained = _tried(name)
    if isinstance(trained, BaseException):
        raise trained
    return trained


@cache
def _tried(name: str) -> Trained | BaseException:
    try:
        return _train(name)
    except (Exception, SystemExit) as error:
        return error


def _train(name: str) -> Trained:
    method, capture = smallest(name), _capture()
    reader = CaptureReader(capture)
    selected = Lender().lend(resolve(find_protocol("smoke"), capture.frames(), capture.offers), name)
    prior = method.train(given.training(selected, reader), seed=0)
    frame = next(f for frames in selected.scored.values() for f in frames if f.kind == "olat")
    enrolment = given.enrolment(selected, method.info, frame.subject, reader)
    query = given.asked(selected, method.info, frame)
    return Trained(method, reader, prior, enrolment, prior.personalise(enrolment, seed=0), query)


def _saved(name: str, folder: Path) -> Trained:
    trained = trained_method(name)
    trained.prior.save(folder)
    return trained


def poisoned(name: str, value: float, everywhere: bool) -> Any:
    """The answer with weights that hold `value`, all of each tensor or its first element.

    They are the prior's saved tensors, or the avatar's where a method learns only when it personalises: its networks,
    or what is kept of it.
    Raises `LookupError` if neither holds any: then this must learn where the method keeps its weights.
    """
    from torch import nn

    def poison(tensors: Iterable[Tensor]) -> int:
        found = [tensor for tensor in tensors if tensor.is_floating_point() and tensor.numel()]
        for tensor in found:
            tensor.detach()[... if everywhere else (0,) * tensor.ndim] = value
        return len(found)

    with tempfile.TemporaryDirectory() as place:
        trained = _saved(name, Path(place))
        count = sum(_rewritten(file, poison) for file in Path(place).rglob("*.safetensors"))
        prior = trained.method.load(Path(place))
        avatar = prior.personalise(trained.enrolment, seed=0)
    if not count:
        modules = [part for part in vars(avatar).values() if isinstance(part, nn.Module)]
        count = sum(poison(module.parameters()) for module in modules)
    if not count:
        with tempfile.TemporaryDirectory() as place:
            avatar.save(Path(place))
            count = sum(_rewritten(file, poison) for file in Path(place).rglob("*.safetensors"))
            avatar = prior.restore(Path(place))
    if not count:
        raise LookupError("neither the saved prior nor the avatar holds weights")
    return trained.draw(trained.query, avatar)


def _rewritten(file: Path, change: Callable[[Iterable[Tensor]], int]) -> int:
    """Change the tensors of a file in place; gives what `change` gives."""
    from safetensors import safe_open
    from safetensors.torch import load_file, save_file

    with safe_open(file, framework="pt") as opened:
        metadata = opened.metadata()
    tensors = load_file(file)
    count = change(tensors.values())
    save_file(tensors, file, metadata)
    return count


def damaged(name: str, damage: Callable[[bytes], bytes] | None) -> Any:
    """The answer of a prior whose saved files are damaged (None: deleted)."""
    with tempfile.TemporaryDirectory() as place:
        trained = _saved(name, Path(place))
        for file in [path for path in Path(place).rglob("*") if path.is_file()]:
            if damage is None:
                file.unlink()
            else:
                file.write_bytes(damage(file.read_bytes()))
        return trained.draw(trained.query, trained.method.load(Path(place)).personalise(trained.enrolment, seed=0))
