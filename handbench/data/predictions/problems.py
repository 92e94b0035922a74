"""All that is wrong with a prediction folder, in one report."""

from __future__ import annotations

from ...errors import InputError

SHOWN = 20  # of each kind

# What there is, in the order of the report, and what helps.
KINDS = {
    "manifest": "manifest.json must say what the pictures answer",
    "times": "times.json must say how long queries of the protocol took; mend it or leave it out",
    "missing": "no picture for these queries; draw them, or score what is there with --allow-missing",
    "unexpected": "these answer no query; remove them, or mend their names",
    "duplicate": "these stand for a query that has a picture already; remove one of the two",
    "link": "links that lead to a folder or out of this one are not followed; copy what they point to",
    "unreadable": "these are no whole pictures; write them again",
    "channels": "a picture has red, green, blue and alpha; EXR has float channels R, G, B, A, and may have depth.Z and "
    "normal.X, normal.Y, normal.Z",
    "size": "a picture has the size of its camera",
    "colour": "EXR pictures are linear with Rec. 709 primaries, alpha is in [0, 1]",
    "non-finite": "NaN or infinite values; draw these again, or have them told as missing with --allow-missing",
}


class Problems:
    """Texts by kind."""

    def __init__(self) -> None:
        self._found: dict[str, list[str]] = {kind: [] for kind in KINDS}

    def add(self, kind: str, text: str) -> None:
        self._found[kind].append(text)

    def __bool__(self) -> bool:
        return any(self._found.values())

    def counts(self) -> dict[str, int]:
        return {kind: len(texts) for kind, texts in self._found.items() if texts}

    def lines(self) -> list[str]:
        """The report: each kind with its number and remedy, then the first of its texts."""
        lines = []
        for kind, count in self.counts().items():
            lines.append(f"{kind} ({count}): {KINDS[kind]}")
            lines += [f"  {text}" for text in self._found[kind][:SHOWN]]
            if count > SHOWN:
                lines.append(f"  … and {count - SHOWN} more")
        return lines


class Unfit(InputError):
    """A prediction folder that cannot be scored; `lines` is the whole report."""

    def __init__(self, what: str, problems: Problems) -> None:
        counts = ", ".join(f"{kind} {count}" for kind, count in problems.counts().items())
        super().__init__(f"{what} cannot be scored ({counts}); nothing was written")
        self.lines = problems.lines()
