"""handbench relight: avatars under other light, as pictures and videos."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..terminal import complain, say
from .shared import examples, json_option, names, seed, tell

if TYPE_CHECKING:
    from ..avatars.portrait import Portrait
    from ..bench.progress import Steps
    from ..relighting.shots import Wish
    from ..scene import Camera, Pose

_AROUND = ("yaw", "pitch", "zoom")


def add(verbs: Any) -> None:
    relight = verbs.add_parser(
        "relight",
        help="show avatars under other light: stills, turning lights, turntables, sequences of poses",
    )
    add_avatars(relight)
    relight.add_argument("--light", action="append", required=True, metavar="MAP", help="several: one after the other")
    relight.add_argument("--turn-light", action="store_true", help="the light turns once about the vertical")
    relight.add_argument("--turntable", action="store_true", help="the camera goes once around the hand")
    relight.add_argument(
        "--pose", default="", metavar="NAME|all|FILE", help="a recorded pose, all of them in order, or an .npz of poses"
    )
    relight.add_argument(
        "--flat-hand-mean", choices=("yes", "no"), help="of MANO poses in a file: whether they are whole"
    )
    relight.add_argument(
        "--camera",
        default="",
        metavar="NAME|FILE[:yaw=,pitch=,zoom=]",
        help="a recorded camera, or those of a transforms.json or COLMAP folder; gone around the hand",
    )
    relight.add_argument("--size", type=size, metavar="WxH", help="pixels (default: the camera's)")
    relight.add_argument("--seconds", type=number, metavar="S", help="of each light (default: 4, or one frame a pose)")
    relight.add_argument("--fps", type=number, default=24.0, metavar="N", help="frames a second (default: 24)")
    relight.add_argument(
        "--exposure", type=stops, metavar="STOPS", help="of what is shown (default: what suits all frames together)"
    )
    relight.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help=".mp4 or .gif; .png or .exr for stills; or a folder"
    )
    relight.add_argument(
        "--format", choices=("png", "exr"), default="png", help="of the pictures in a folder (exr: linear, not exposed)"
    )
    json_option(relight)
    examples(
        relight,
        "relight me.avatar --light studio.exr --turn-light --out me.mp4",
        "relight me.avatar --light hall --light park:exposure=1 --out stills.png",
        "relight --run runs/quick --methods urhand,physical --subject s05 --light hall --turntable --out both.mp4",
        "relight me.avatar --light hall --pose wave.npz --out frames/",
        "relight me.avatar --light hall --camera flight.json:z-up --seconds 3 --out flight.mp4",
        below="lights: a .exr, .hdr or .ktx map, or a sky box, with :rotate=DEGREES,exposure=STOPS,clip "
        "(docs/environment-maps.md)",
    )
    relight.set_defaults(verb=_relight, resumes=True)


def add_avatars(verb: Any) -> None:
    """The arguments that name avatars: kept ones, and subjects of a run."""
    verb.add_argument("avatars", type=Path, nargs="*", metavar="AVATAR", help="what 'handbench personalise' wrote")
    verb.add_argument("--run", type=Path, metavar="RUN", help="a run folder; its trainings are used")
    verb.add_argument("--methods", type=names, metavar="A,B", help="of the run (default: its first that draws)")
    verb.add_argument("--subject", metavar="NAME", help="of the run (default: the first that is scored)")
    verb.add_argument("--seed", type=seed, metavar="N", help="of the run (default: its first)")
    verb.add_argument("--protocol", metavar="FILE", help="of the run, where it is no registered one")
    verb.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    verb.add_argument("--device", default="cpu", help="where networks run: cpu (default), cuda, cuda:1, …")


def portraits(arguments: argparse.Namespace, told: Steps) -> list[Portrait]:
    """The avatars that are named. Raises `InputError` if there are none."""
    from ..avatars.folder import read_avatar

    found = [read_avatar(folder) for folder in arguments.avatars]
    if arguments.run is not None:
        from ..avatars.making import drawing_methods, from_run

        chosen = arguments.methods or drawing_methods(arguments.run)[:1]
        about = (arguments.subject, told, arguments.seed, arguments.data, arguments.protocol)
        found += [from_run(arguments.run, method, *about) for method in chosen]
    elif given := [f"--{n}" for n in ("methods", "subject", "seed", "protocol") if getattr(arguments, n) is not None]:
        raise InputError(f"{given[0]} goes with --run; leave it out, or name a run")
    if not found:
        raise InputError("there is nothing to show: name an avatar, or a run with --run")
    return found


def _relight(arguments: argparse.Namespace) -> int:
    from ..bench.progress import steps
    from ..data.lights import NamedLight
    from ..device import on_device
    from ..files import check_file, check_folder
    from ..relighting.drawing import draw
    from ..relighting.showing import Tiles, exposure_of, flicker_of
    from ..relighting.video import VIDEOS, check_video

    out, suffix = arguments.out, arguments.out.suffix.lower()
    if suffix not in (*VIDEOS, ".png", ".exr", "") or not out.name:
        raise InputError(f"--out {out} names no video, picture or folder; end it in .mp4, .gif, .png, .exr, or nothing")
    check_video(out)
    (check_file if suffix else check_folder)(out)
    lights = tuple(NamedLight.parse(text) for text in arguments.light)
    maps = [light.read(complain) for light in lights]  # what is mistyped or missing is told before anything is drawn
    with on_device(arguments.device), steps() as told:
        shown = portraits(arguments, told)
        wish = _wish(arguments, lights, shown)
        _check_wish(wish, suffix, len(shown), out)
        frames, times = draw(shown, wish, maps, out.with_name(f"{out.name}.frames"), told)
        named = _names(shown)
        exposure = exposure_of(frames) if arguments.exposure is None else 2.0**arguments.exposure
        _write(arguments, Tiles(frames, named, exposure), wish)
        unsteady = [flicker_of(frames, i, exposure) if wish.still_view else None for i in range(len(named))]
        frames.remove()
    if arguments.json:
        drawn = [
            {"name": name, **time.told, "flicker": flicker}
            for name, time, flicker in zip(named, times, unsteady, strict=True)
        ]
        tell({"out": str(out), "exposure": exposure, "frames": frames.count, "avatars": drawn})
        return 0
    for name, time, flicker in zip(named, times, unsteady, strict=True):
        say(f"{name}: {time}" + ("" if flicker is None else f"; flicker {flicker:.4f}"))
    say(f"exposure: {exposure:.3g} ({frames.count} frames)")
    say(out)
    return 0


def _wish(arguments: argparse.Namespace, lights: tuple[Any, ...], shown: Sequence[Portrait]) -> Wish:
    from ..data.camerafile import FLAGS, NUMBERS, is_camera_file, read_cameras
    from ..data.options import split_options
    from ..relighting.shots import Wish

    poses: tuple[Pose, ...] = ()
    pose = arguments.pose
    if pose.endswith(".npz"):
        poses, pose = _poses(Path(pose), arguments.flat_hand_mean, shown), ""
    camera, said = split_options(arguments.camera, "camera", (*_AROUND, *NUMBERS), FLAGS)
    around = {name: value for name, value in said.items() if name in _AROUND}
    if not 0.05 <= around.get("zoom", 1.0) <= 20.0:
        raise InputError(f"camera: zoom is {around['zoom']:g}; give 0.05 to 20")
    cameras: tuple[Camera, ...] = ()
    if is_camera_file(camera):
        cameras, camera = read_cameras(camera, said), ""
        if len(cameras) > 1 and arguments.turntable:
            raise InputError(f"--turntable goes around with one camera; choose one of {len(cameras)} with :frame=0")
    elif of_files := [name for name in said if name not in _AROUND]:
        raise InputError(f"camera {camera!r} is a recorded one, and {of_files[0]} is said of files; leave it out")
    return Wish(
        lights,
        arguments.turn_light,
        arguments.turntable,
        pose,
        poses,
        camera,
        cameras,
        **around,
        size=arguments.size,
        seconds=arguments.seconds,
        fps=arguments.fps,
    )


def _poses(path: Path, flat: str | None, shown: Sequence[Portrait]) -> tuple[Pose, ...]:
    """The poses of a file, in the hand model of the first avatar."""
    from ..data.poses import read_poses
    from ..hand import hand_model

    body = shown[0].repertoire.body
    if body is None:
        raise InputError(f"{shown[0].name} shows recorded poses only: its hand model or shape is not told")
    read = read_poses(path, hand_model(body.hand), None if flat is None else flat == "yes")
    return tuple(each.pose for each in read)


def _check_wish(wish: Wish, suffix: str, count: int, out: Path) -> None:
    """Raises `InputError` where what is asked for and where it shall go do not fit."""
    from ..relighting.video import VIDEOS

    if suffix in VIDEOS and not wish.moves and len(wish.lights) == 1:
        raise InputError(
            f"nothing moves in {out}: give --turn-light, --turntable, several poses or cameras, or name a .png"
        )
    if suffix in (".png", ".exr") and wish.moves:
        raise InputError(f"{out} is one picture; name an .mp4, a .gif, or a folder for frames")
    if suffix == ".exr" and (count > 1 or len(wish.lights) > 1):
        raise InputError(f"{out} holds one avatar under one light; name a folder, with --format exr")


def _names(shown: Sequence[Portrait]) -> list[str]:
    """The avatars' names, told apart by their subjects where they are equal."""
    names = [portrait.name for portrait in shown]
    return [
        f"{portrait.name} ({portrait.repertoire.subject})" if names.count(portrait.name) > 1 else portrait.name
        for portrait in shown
    ]


def _write(arguments: argparse.Namespace, tiles: Any, wish: Wish) -> None:
    import numpy as np

    from ..relighting.video import VIDEOS, copy_picture, write_picture, write_video

    out, suffix = arguments.out, arguments.out.suffix.lower()
    if suffix in VIDEOS:
        fps = arguments.fps if wish.moves else 1.0  # lights one after the other, each for a second
        write_video(out, tiles.all(), fps)
    elif suffix == ".png":
        write_picture(out, np.concatenate(list(tiles.all())))
    elif suffix == ".exr":
        copy_picture(tiles.frames.path(0, 0), out)
    elif arguments.format == "exr":
        out.mkdir(parents=True, exist_ok=True)
        for frame, portrait in np.ndindex(tiles.frames.count, tiles.frames.portraits):
            beside = "" if tiles.frames.portraits == 1 else f"-{portrait:02d}"
            copy_picture(tiles.frames.path(frame, portrait), out / f"{frame:05d}{beside}.exr")
    else:
        out.mkdir(parents=True, exist_ok=True)
        for frame, picture in enumerate(tiles.all()):
            write_picture(out / f"{frame:05d}.png", picture)


def number(text: str) -> float:
    """A number above 0, and no larger than any film is long."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1e5:
        raise argparse.ArgumentTypeError(f"{text!r} is no number above 0, and at most 100000")
    return value


def stops(text: str) -> float:
    """From -30 to 30 stops."""
    try:
        value = float(text)
    except ValueError:
        value = 99.0
    if not -30.0 <= value <= 30.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of stops from -30 to 30")
    return value


def size(text: str) -> tuple[int, int]:
    """ "342x256" as width and height in pixels."""
    width, x, height = text.partition("x")
    if not (x and width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; give WIDTHxHEIGHT, such as 342x256")
    if not (8 <= int(width) <= 8192 and 8 <= int(height) <= 8192):
        raise argparse.ArgumentTypeError(f"{text!r} is too small or too large; give 8 to 8192 pixels a side")
    return int(width), int(height)
