"""The parametric BRDF of URHand (supp. Eqs. 1-6) on the tracked mesh, with one fitted roughness."""

from __future__ import annotations

from handbench.method import Method, MethodInfo
from handbench.scene import KNOWN_LIGHTS

from . import model as reflectance

INFO = MethodInfo(
    name="physical",
    title="Physical BRDF",
    summary="mean texture and the parametric BRDF on the tracked mesh",
    universal=True,
    needs=reflectance.FULLY_LIT,
    trains_on=reflectance.FULLY_LIT | {"olat or group"},
    linear=True,
    lights=KNOWN_LIGHTS,
    fidelity="reference: no learned network",
)


def create(preset: str = "quick") -> Method:
    """The method at a preset."""
    return reflectance.create(INFO, "brdf", preset)
