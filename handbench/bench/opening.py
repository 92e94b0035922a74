"""The data of a protocol, opened."""

from __future__ import annotations

from pathlib import Path

from ..data.capture import Capture, open_capture
from ..data.together import Together
from .progress import Steps
from .protocol import Protocol
from .resolving import Selected, resolve


def open_data(protocol: Protocol, data: Path | None, told: Steps) -> Capture:
    """The capture of a protocol, together with that which it trains on if that is another one.

    Raises `InputError` as `open_capture` does, and for a subject that is in both.
    """
    scored = open_capture(protocol.capture, protocol.size, data, told)
    if protocol.trains_on is None:
        return scored
    return Together(scored, open_capture(*protocol.trains_on, data, told))


def select(protocol: Protocol, capture: Capture) -> Selected:
    """The frames of a capture that a protocol names, as `resolve` chooses them."""
    return resolve(protocol, capture.frames(), capture.offers, capture.teaches)
