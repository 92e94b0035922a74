"""handbench metrics compare: how one prediction scores under our own metrics and under official evaluators."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..errors import InputError, unknown_name
from ..terminal import complain, say, show
from .shared import examples, json_option, names, tell

if TYPE_CHECKING:
    from ..data.pictures import Stated
    from ..scene import Array

_FORMATS = ("terminal", "csv", "markdown")
_ENCODINGS = ("auto", "linear", "srgb")
_ALPHAS = ("auto", "premultiplied", "straight")


def add(verbs: Any) -> None:
    metrics = verbs.add_parser("metrics", help="score pictures with our metrics and as official evaluators do")
    compare = metrics.add_subparsers(required=True, metavar="VERB").add_parser(
        "compare",
        help="one prediction under all metrics, side by side",
        description="Score a picture, or a folder of pictures, against the truth of equal name under our metrics and "
        "as official evaluators do. EXR and floating-point numpy files are linear, PNG and JPEG are sRGB; images are "
        "premultiplied, on black. Values of a folder are means over its files; --format csv has each file's. "
        "A file that cannot be read loses only its own values, with the reason.",
    )
    compare.add_argument("prediction", type=Path, help="EXR, PNG, JPEG or numpy file, or a folder of them")
    compare.add_argument("truth", type=Path, help="the same, of the same size")
    compare.add_argument("--mask", type=Path, help="where the hand is (default: the truth's alpha, or everywhere)")
    compare.add_argument(
        "--metrics",
        "--only",
        dest="only",
        type=names,
        default=("*",),
        metavar="A,B",
        help="names or patterns: psnr,'goliath-*'",
    )
    compare.add_argument("--sequence", action="store_true", help="files in order of name are a sequence: adds flicker")
    compare.add_argument("--pred-encoding", choices=_ENCODINGS, default="auto", help="of the prediction's values")
    compare.add_argument("--truth-encoding", choices=_ENCODINGS, default="auto", help="of the truth's values")
    compare.add_argument("--alpha", choices=_ALPHAS, help="whether colours are multiplied by alpha (auto: EXR are)")
    compare.add_argument("--layer", help="of an EXR file: its channels are LAYER.R, LAYER.G, LAYER.B")
    compare.add_argument("--part", help="of an EXR file with several: its name, or its number from 0")
    for side, what in (("pred", "prediction"), ("truth", "truth")):
        for option, choices in (("alpha", _ALPHAS), ("layer", None), ("part", None)):
            compare.add_argument(f"--{side}-{option}", choices=choices, help=f"--{option} of the {what} alone")
    compare.add_argument("--max-pixels", type=int, metavar="N", help="largest picture that is read (default: 2^26)")
    compare.add_argument("--format", choices=_FORMATS, default="terminal", help="of the table (default: terminal)")
    json_option(compare)
    examples(
        compare,
        "metrics compare mine.png truth.png",
        "metrics compare mine/ truth/ --metrics 'psnr,ssim,goliath-*' --format csv",
    )
    compare.set_defaults(verb=_compare)


class _Files(NamedTuple):
    prediction: Path
    truth: Path
    mask: Path | None


def _compare(arguments: argparse.Namespace) -> int:
    from ..bench.progress import steps
    from ..metrics.compat import compare as table

    files, chosen, stated = _files(arguments), _metrics(arguments.only), _stated(arguments)
    remarks: dict[str, str] = {}
    failures: dict[str, InputError] = {}
    kept: list[Any] = []
    shares: list[float] = []

    with steps() as told:
        progress = told("pictures scored")

        def pairs() -> Iterator[tuple[str, Any]]:
            for i, (name, of_name) in enumerate(files.items()):
                try:
                    pair = _pair(of_name, stated, remarks)
                except InputError as error:
                    failures[name] = error
                    yield name, str(error)
                else:
                    shares.append(float((pair.mask > 0.5).mean()))
                    if arguments.sequence:
                        kept.append(pair)
                    yield name, pair
                if len(files) > 1:
                    progress(i + 1, len(files))

        found = table.lines(chosen, pairs())
    if not shares:
        raise next(iter(failures.values()))
    if arguments.sequence:
        from ..metrics.geometry.flicker import FLICKER

        found.append(table.MetricScores(FLICKER, {"": _flicker(kept, failures)}))
    told_of = list(remarks.values())

    if arguments.json:
        values = {line.metric.name: {file: score.value for file, score in line.scores.items()} for line in found}
        means = {line.metric.name: line.mean for line in found}
        tell({"values": values, "means": means, "remarks": told_of})
    elif arguments.format == "csv":
        say(table.render_csv(found), end="")
        for remark in told_of:
            complain(f"handbench: {remark}")
    elif arguments.format == "markdown":
        say(table.render_markdown(found, told_of), end="")
    else:
        several = f"; means of {len(files)} files" if len(files) > 1 else ""
        say(f"{arguments.prediction} against {arguments.truth}{several}")
        say(f"the mask covers {100 * sum(shares) / len(shares):.1f} % of the picture")
        show(table.render_terminal(found))
        say("\n".join(table.notes(found, told_of)))
    return 0


def _metrics(only: Sequence[str]) -> list[Any]:
    """The registered metrics whose name fits, with default options; those that can be aligned also so, with rgb."""
    from .. import metrics as module
    from ..registry import METRICS, Broken

    known = [name for name, entry in METRICS.entries().items() if not isinstance(entry, Broken)]
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise unknown_name("metric", pattern, known)
    fits = [name for name in known if any(fnmatchcase(name, pattern) for pattern in only)]
    found = []
    for name in fits:
        found.append(module.metric(name))
        if "rgb" in found[-1].family.options.get("scale", ()):
            found.append(module.metric(f"{name}:scale=rgb"))
    return found


def _files(arguments: argparse.Namespace) -> dict[str, _Files]:
    """What is compared, by name; two files need no equal names, files in folders do."""
    from ..data.pictures import folder_of, matched

    given = {"prediction": arguments.prediction, "truth": arguments.truth}
    if arguments.mask is not None:
        given["mask"] = arguments.mask
    folders = {what: path for what, path in given.items() if path.is_dir()}
    for what, path in given.items():
        if not path.exists():
            raise InputError(f"{what} {path} does not exist")
        if folders and what not in folders:
            raise InputError(f"{what} {path} is a file, but a folder was given too; give files or folders")
    if not folders:
        return {arguments.prediction.stem: _Files(arguments.prediction, arguments.truth, arguments.mask)}
    names = {f"{what} folder {path}": folder_of(path) for what, path in folders.items()}
    by_name = list(names.values())
    masks = by_name[2] if len(by_name) > 2 else {}
    return {name: _Files(by_name[0][name], by_name[1][name], masks.get(name)) for name in matched(names)}


def _stated(arguments: argparse.Namespace) -> dict[str, Stated]:
    """What the options say of the files of each side, and of masks."""
    from ..data.pictures import MAX_PIXELS, Stated

    limit = MAX_PIXELS if arguments.max_pixels is None else arguments.max_pixels
    if limit < 1:
        raise InputError(f"--max-pixels {limit} must be at least 1")
    found = {"mask": Stated(max_pixels=limit)}
    for side in ("pred", "truth"):
        alpha, layer, part = (
            getattr(arguments, option) if of_side is None else of_side
            for option in ("alpha", "layer", "part")
            for of_side in (getattr(arguments, f"{side}_{option}"),)
        )
        found[side] = Stated(getattr(arguments, f"{side}_encoding"), alpha or "auto", layer, part, limit)
    return found


def _pair(files: _Files, stated: dict[str, Stated], remarks: dict[str, str]) -> Any:
    """Prediction, truth and mask as `handbench.metrics.Pair`; what a reader must know of them goes to the remarks."""
    from ..data.compared import compared
    from ..data.pictures import read_mask, read_picture
    from ..metrics import Pair

    prediction = read_picture(files.prediction, stated["pred"])
    truth = read_picture(files.truth, stated["truth"])
    _same_size(files.prediction, prediction.image, files.truth, truth.image)
    mask = None
    if files.mask is not None:
        mask = read_mask(files.mask, stated["mask"])
        _same_size(files.mask, mask, files.truth, truth.image)
    found = compared(prediction, truth, mask)
    for kind, remark in found.remarks.items():
        remarks.setdefault(kind, remark)
    return Pair(found.prediction, found.truth, found.mask, prediction_alpha=found.prediction_alpha)


def _flicker(pairs: list[Any], failures: dict[str, InputError]) -> Any:
    """The score of a sequence; none if one of its pictures is lost."""
    from ..metrics import Score
    from ..metrics.geometry.flicker import flicker

    if failures:
        return Score(None, f"the sequence has gaps: {next(iter(failures.values()))}")
    return flicker(pairs)


def _same_size(path: Path, one: Array, truth: Path, other: Array) -> None:
    (height, width), (rows, columns) = one.shape[:2], other.shape[:2]
    if (height, width) != (rows, columns):
        raise InputError(
            f"{path} is {width}x{height} pixels and {truth} is {columns}x{rows}; give pictures of one size"
        )
