"""Frames as files: .mp4 (by imageio-ffmpeg), .gif, one picture, or a folder of them."""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen

import numpy as np
from PIL import Image

from ..errors import InputError
from ..files import whole
from ..scene import Array

VIDEOS = (".mp4", ".gif")
_CODED = (
    *("-an", "-c:v", "libx264", "-crf", "18", "-preset", "medium", "-movflags", "+faststart"),
    # players take untold colours for one thing or another by the size of the picture
    *("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p"),
    *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-color_range", "tv"),
)
_HUNDREDTH = 100  # GIF counts time in hundredths of a second
_LONGEST = 65535  # that a picture can stay


def check_video(path: Path) -> None:
    """Raises `InputError` for a video that cannot be written here."""
    if path.suffix.lower() == ".mp4":
        _ffmpeg()


def write_video(path: Path, frames: Iterable[Array], fps: float) -> None:
    """Frames (H, W, 3) uint8, all of one size, as a video; whole or not at all.

    Raises `InputError` for .mp4 without imageio-ffmpeg, and `StorageError` if it cannot be written.
    """
    if path.suffix.lower() == ".mp4":
        _write_mp4(path, frames, fps)
    else:
        _write_gif(path, frames, fps)


def write_picture(path: Path, picture: Array) -> None:
    """One picture (H, W, 3) uint8 as PNG."""
    with whole(path) as part:
        Image.fromarray(picture).save(part, "PNG")


def copy_picture(source: Path, target: Path) -> None:
    """A drawn frame as it is: linear, premultiplied, half floats."""
    with whole(target) as part:
        shutil.copyfile(source, part)


def _write_mp4(path: Path, frames: Iterable[Array], fps: float) -> None:
    ffmpeg = _ffmpeg()
    frames = map(_even, frames)
    first = next(frames)
    height, width = first.shape[:2]
    given = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-")
    with whole(path) as part, tempfile.TemporaryFile() as told:
        command = (ffmpeg, "-y", "-loglevel", "error", *given, *_CODED, "-f", "mp4", str(part))
        # in a session of its own, so that Ctrl-C reaches it through us alone
        process = Popen(command, stdin=PIPE, stdout=DEVNULL, stderr=told, start_new_session=True)
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):  # what ffmpeg says tells more
                for frame in chain([first], frames):
                    process.stdin.write(np.ascontiguousarray(frame).data)
                process.stdin.close()
            failed = process.wait() != 0
        finally:
            process.kill()
            process.wait()
        if failed:
            told.seek(0)
            why = told.read(2000).decode(errors="replace").strip().splitlines() or ["no reason"]
            raise OSError(errno.EIO, f"ffmpeg stopped: {why[-1]}")


def _write_gif(path: Path, frames: Iterable[Array], fps: float) -> None:
    pictures = [Image.fromarray(frame).quantize(256, Image.Quantize.MEDIANCUT) for frame in frames]
    with whole(path) as part:
        wait = 10 * min(max(2, round(_HUNDREDTH / fps)), _LONGEST)
        pictures[0].save(part, "GIF", save_all=True, append_images=pictures[1:], duration=wait, loop=0)


def _even(frame: Array) -> Array:
    """The frame with a black line more where its sides are odd: the codec halves the colours."""
    height, width = frame.shape[:2]
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0))) if height % 2 or width % 2 else frame


def _ffmpeg() -> str:
    """The program. Raises `InputError` if it is not installed."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise InputError(
            "an .mp4 is written by imageio-ffmpeg, which is not installed: pip install 'handbench[video]', or name a "
            ".gif or a folder of pictures with --out"
        ) from error
