"""Fitting a hand model to pictures of a hand: key points, masks and depth to shape, poses and placement."""

from __future__ import annotations

from .fit import Fit, Fitted, fit
from .picture import Picture
from .problems import Problem, Unfittable
from .recorded import pictures
from .single import QUICK, THOROUGH, Settings
from .terms import Weights

__all__ = [
    "QUICK",
    "THOROUGH",
    "Fit",
    "Fitted",
    "Picture",
    "Problem",
    "Settings",
    "Unfittable",
    "Weights",
    "fit",
    "pictures",
]
