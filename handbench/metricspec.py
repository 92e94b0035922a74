"""How a protocol names a metric: "psnr", or with options "psnr:region=box,scale=rgb"."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InputError


@dataclass(frozen=True)
class MetricSpec:
    """A registered name and the options that are chosen, as they are written."""

    name: str
    options: dict[str, str]

    @staticmethod
    def parse(spec: str) -> MetricSpec:
        """Raises `InputError` for a spec that cannot be read and for an option given twice."""
        name, colon, rest = spec.partition(":")
        chosen: dict[str, str] = {}
        for part in rest.split(",") if colon else ():
            option, equals, value = (word.strip() for word in part.partition("="))
            if not (option and equals and value):
                raise InputError(
                    f"metric {spec!r}: cannot read {part!r}; write options as name:option=value,option=value"
                )
            if option in chosen:
                raise InputError(f"metric {spec!r}: option {option!r} is given twice; keep one")
            chosen[option] = value
        return MetricSpec(name.strip(), chosen)
