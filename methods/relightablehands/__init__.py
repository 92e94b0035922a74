"""RelightableHands on a mesh: a texture decoder for one identity, asked once per light."""

from .method import create

__all__ = ["create"]
