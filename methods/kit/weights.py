"""Weights on disk: safetensors beside the configuration they belong to; loading never unpickles."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from handbench.errors import InputError, StorageError

SCHEMA = 2
_FILE = "weights.safetensors"


def save_state(folder: Path, method: str, config: Mapping[str, Any], state: Mapping[str, Tensor]) -> None:
    """Write tensors and the configuration of a method into a folder: equal ones give equal bytes.

    Raises `StorageError` if it cannot be written.
    """
    # in one value: the library writes several in an order that changes from process to process
    told = {"schema": SCHEMA, "method": method, "config": config}
    metadata = {"handbench": json.dumps(told, sort_keys=True)}
    try:
        save_file({name: tensor.contiguous() for name, tensor in state.items()}, folder / _FILE, metadata)
    except SafetensorError as error:  # the library's word for a full disk
        raise StorageError(f"{folder / _FILE} cannot be written ({error}); free some space") from error


def load_state(
    folder: Path, method: str, config: Mapping[str, Any], shapes: Mapping[str, tuple[int | None, ...]] | None = None
) -> dict[str, Tensor]:
    """The tensors that `save_state` wrote; `shapes` says which there must be, and their sizes (None: any).

    Raises `InputError` if the file is missing, damaged, or of another method, version or configuration, lacks one of
    `shapes`, and if a value is not finite.
    """
    path = folder / _FILE
    try:
        with safe_open(path, framework="pt") as file:
            told = json.loads((file.metadata() or {}).get("handbench", "{}"))
        state = load_file(path)
    except (OSError, ValueError, SafetensorError) as error:
        raise InputError(f"weights {path} cannot be read ({error}); train again") from error
    if told.get("schema") != SCHEMA or told.get("method") != method:
        found = f"{told.get('method')!r} of schema {told.get('schema')}"
        raise InputError(f"weights {path} are of {found}, expected {method!r} of schema {SCHEMA}; train again")
    trained, wanted = (json.dumps(each, sort_keys=True) for each in (told.get("config"), config))
    if trained != wanted:
        raise InputError(f"weights {path} were trained with {trained}, asked for {wanted}; train again")
    if odd := [name for name, tensor in state.items() if not tensor.isfinite().all()]:
        raise InputError(f"weights {path} hold NaN or infinity in {odd[0]}; train again")
    check_shapes(folder, state, shapes or {})
    return state


def check_shapes(folder: Path, state: Mapping[str, Tensor], shapes: Mapping[str, tuple[int | None, ...]]) -> None:
    """Raises `InputError` unless a state of a folder has the named tensors, of these sizes (None: any)."""
    for name, shape in shapes.items():
        found = None if name not in state else tuple(state[name].shape)
        if (
            found is None
            or len(found) != len(shape)
            or any(w not in (None, f) for f, w in zip(found, shape, strict=True))
        ):
            raise InputError(
                f"weights {folder / _FILE} hold {name} of shape {found}, expected {shape}; make them again"
            )


def as_tensor(text: str) -> Tensor:
    """A text as a tensor, to be kept beside others."""
    return torch.tensor(list(text.encode()), dtype=torch.uint8)


def as_text(tensor: Tensor) -> str:
    """The text that `as_tensor` made a tensor of."""
    return bytes(tensor.to(torch.uint8).flatten().tolist()).decode(errors="replace")
