"""The state of a training on disk: written now and then, read when the same training starts again."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from handbench.checkpoint import Checkpoints, checkpoints
from handbench.errors import StorageError
from handbench.files import whole
from handbench.terminal import complain

from .adam import Adam

Part: TypeAlias = tuple[nn.Module, Adam]
T = TypeVar("T")

EVERY = 30.0
"""Seconds between two checkpoints: when one is written changes no result, only what a kill costs."""


class Checkpoint:
    """Weights and optimiser states of named parts of a training, and where it stands."""

    def __init__(self, kept: Checkpoints, name: str, parts: Mapping[str, Part]) -> None:
        self._kept, self._path, self._parts = kept, kept.folder / f"{name}.safetensors", parts
        self._start = self._last = time.monotonic()
        self._earlier = 0.0

    @staticmethod
    def of(name: str, parts: Mapping[str, Part]) -> Checkpoint | None:
        """The checkpoint of the training called `name`, or None if nothing is to be kept."""
        kept = checkpoints()
        return None if kept is None else Checkpoint(kept, name, parts)

    def due(self) -> bool:
        return time.monotonic() - self._last >= EVERY

    def write(self, about: Mapping[str, Any]) -> None:
        """Keep the state. Raises `StorageError` if it cannot be written."""
        tensors: dict[str, Tensor] = {}
        for name, (module, adam) in self._parts.items():
            tensors |= {f"{name}/{key}": value for key, value in module.state_dict().items()}
            for index, moments in adam.moments.items():
                tensors |= {f"{name}/adam/{index}/{key}": value for key, value in moments.items()}
        tensors = {name: value.contiguous() for name, value in tensors.items()}
        told = json.dumps({**about, "seconds": self._earlier + time.monotonic() - self._start})
        metadata = {"about": told, "digest": _digest(told, tensors)}
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with whole(self._path) as part:
                save_file(tensors, part, metadata)
        except (OSError, SafetensorError) as error:  # safetensors has its own word for a full disk
            raise StorageError(f"{self._path} cannot be written ({error}); free some space") from error
        self._last = time.monotonic()

    def read(self, parse: Callable[[dict[str, Any]], T]) -> T | None:
        """Put the kept state into modules and optimisers, and return what `parse` makes of what was told with it.

        None if there is none, or if it is damaged or does not fit, which is told: the training then starts anew.
        `parse` raises `KeyError`, `TypeError` or `ValueError` for what does not fit.
        """
        try:
            return self._read(parse)
        except FileNotFoundError:
            return None
        except (OSError, SafetensorError, ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            why = " ".join(f"{type(error).__name__}: {error}".split())
            complain(f"handbench: checkpoint {self._path} cannot be used ({why}); the training starts anew")
            return None

    def _read(self, parse: Callable[[dict[str, Any]], T]) -> T:
        with safe_open(self._path, framework="pt") as file:
            metadata = file.metadata()
        tensors = load_file(self._path)
        if metadata["digest"] != _digest(metadata["about"], tensors):
            raise ValueError("its content is not what was written")
        about: dict[str, Any] = json.loads(metadata["about"])
        parsed, earlier = parse(about), float(about["seconds"])
        if not all(value.isfinite().all() for value in tensors.values()):
            raise ValueError("it holds NaN or infinity")
        states = [_state(name, *part, tensors) for name, part in self._parts.items()]  # before anything is changed
        for (module, adam), (weights, moments) in zip(self._parts.values(), states, strict=True):
            module.load_state_dict(weights)
            adam.moments = moments
        self._earlier = earlier
        self._kept.earlier_s += earlier
        return parsed


def _digest(about: str, tensors: Mapping[str, Tensor]) -> str:
    content = hashlib.blake2b(about.encode(), digest_size=16)
    for name, value in sorted(tensors.items()):
        content.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        content.update(value.detach().cpu().reshape(-1).view(torch.uint8).numpy().data)
    return content.hexdigest()


def _state(
    name: str, module: nn.Module, adam: Adam, tensors: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[int, dict[str, Tensor]]]:
    """The weights of a part, and its optimiser's state by the parameter's number. `KeyError` if they do not fit.

    Adam keeps no state of a parameter that has had no gradient yet, such as those of fields that a first stage does
    not draw.
    """
    weights = {key: tensors[f"{name}/{key}"] for key in module.state_dict()}
    if any(weights[key].shape != value.shape for key, value in module.state_dict().items()):
        raise KeyError(name)
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        head, _, kind = key.rpartition("/")
        if head.startswith(f"{name}/adam/"):
            moments.setdefault(int(head.rpartition("/")[2]), {})[kind] = value
    parameters = dict(enumerate(adam.parameters))
    for index, kept in moments.items():
        shape = parameters[index].shape
        if {kind: value.shape for kind, value in kept.items()} != {"step": (), "exp_avg": shape, "exp_avg_sq": shape}:
            raise KeyError(f"{name}/adam/{index}")
        moments[index] = {kind: value.to(parameters[index].device) for kind, value in kept.items()}
    return weights, moments
