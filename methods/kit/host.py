"""The way out of a device."""

from __future__ import annotations

from torch import Tensor

from handbench.scene import Array


def on_host(tensor: Tensor) -> Array:
    """An array of what was worked out, wherever that was; on the CPU they share memory.

    It waits for the device. So it is for what leaves a method as part of the scene (a picture, a mesh, a pose) and for
    what is prepared once, and nothing else of a method copies from a device.
    """
    found: Array = tensor.detach().cpu().numpy()
    return found
