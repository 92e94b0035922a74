"""Whether a prediction is in the unit of its truth: lengths are metres, and millimetres are what they are taken for."""

from __future__ import annotations

from handbench.errors import Unsupported

_THOUSAND = (500.0, 2000.0)


def same_unit(what: str, found: float, true: float) -> None:
    """Raises `Unsupported` if a length of the prediction is about a thousand times the truth's, or a thousandth of it.

    `what` names the length for people, "the prediction's mesh is … across".
    """
    if found <= 0.0 or true <= 0.0:
        return
    for large, small, whose in ((found, true, "prediction"), (true, found, "truth")):
        if _THOUSAND[0] < large / small < _THOUSAND[1]:
            raise Unsupported(
                f"{what} {found:.3g} m in the prediction and {true:.3g} m in the truth: "
                f"the {whose} seems to be in millimetres; give metres"
            )
