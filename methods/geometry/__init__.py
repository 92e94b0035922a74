"""Hand geometry autoencoder (URHand supp. Sec. 4.1): tracked geometry from fully lit frames; see docs/geometry.md."""

from __future__ import annotations

from .tracker import GeometryPrior, Tracker, Tracking, create

__all__ = ["GeometryPrior", "Tracker", "Tracking", "create"]
