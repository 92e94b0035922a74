"""Fitting a hand model to pictures of a hand: key points, masks and depth to shape, poses and placement."""

from __future__ import annotations

from .fit import Fit, Fitted, fit
from .picture import HandPicture
from .problems import Problem, Unfittable
from .recorded import pictures
from .single import QUICK, THOROUGH, FittingSettings
from .terms import TermWeights

__all__ = [
    "QUICK",
    "THOROUGH",
    "Fit",
    "Fitted",
    "FittingSettings",
    "HandPicture",
    "Problem",
    "TermWeights",
    "Unfittable",
    "fit",
    "pictures",
]
