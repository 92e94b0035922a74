"""URHand: universal relightable hands."""

from .method import create

__all__ = ["create"]
