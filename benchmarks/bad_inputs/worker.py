"""The process that tries cases: a line of JSON in, a line of JSON out. It is reused, since loading takes a second."""

from __future__ import annotations

import io
import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

VALUES = "SELECT method, seed, query, metric, value FROM scores ORDER BY ALL"
MEMORY = 12 << 30  # bytes; more is an error of memory, not a machine that stands still


def protocol(path: Path) -> str:
    """The digest of a protocol file, and of the frames it chooses of the smallest light stage."""
    from handbench.bench.protocol import digest
    from handbench.bench.resolving import resolve
    from handbench.bench.run import find_protocol
    from handbench.registry import CAPTURES

    found = find_protocol(str(path))
    chosen = resolve(found, CAPTURES.load("openstage")(size="mini").frames())
    frames = {name: [frame.key for frame in frames] for name, frames in chosen.scored.items()}
    return digest([[frame.key for frame in chosen.train], frames])


def environment(path: Path) -> str:
    """Mean radiance of an environment map."""
    from handbench.data.environments import read_environment

    return " ".join(f"{value:.5g}" for value in read_environment(path).radiance.mean((0, 1)))


def capture(folder: Path) -> str:
    """Means of pictures, and of a mesh, of a light stage in a folder."""
    import numpy as np

    from handbench.data.openstage.capture import OpenCapture

    frames = OpenCapture(folder).frames()
    stage = OpenCapture(folder)
    means = [float(np.mean(stage.observe(frame).image)) for frame in frames[:: max(1, len(frames) // 5)]]
    return " ".join(f"{value:.5g}" for value in (*means, float(frames[0].mesh.vertices.mean())))


def score(folder: Path) -> str:
    """The values of a prediction folder, scored."""
    from handbench.cli import main

    code = main(["score", "p.toml", str(folder), "--out", "scored"])
    if code:
        raise SystemExit(code)
    sys.stdout.flush()
    sys.stdout.buffer.seek(0)  # what the score printed is not asked for
    sys.stdout.buffer.truncate()
    main(["query", "scored", VALUES, "--format", "json"])
    return ""


def folder(path: Path) -> str:
    """What a folder of pictures tells: keys, means of a picture and of a mesh, and what is doubted."""
    import numpy as np

    from handbench.data.capture import read
    from handbench.data.conventions import checked
    from handbench.data.readers import open_at

    found = open_at(path)
    frame = found.frames()[-1]
    seen = read(found, frame)
    shape = "" if frame.mesh is None else f"{frame.mesh.vertices.mean():.4g}"
    return f"{frame.key} {float(np.mean(seen.image)):.4g} {shape} {len(checked(found).doubts)}"


def mesh(path: Path) -> str:
    """Counts and the mean of a mesh file."""
    from handbench.data.meshfile import read_mesh

    found = read_mesh(path)
    return f"{found.vertices.shape} {found.topology.faces.shape} {found.vertices.mean():.4g}"


def poses(path: Path) -> str:
    """How many poses a file holds, and where the first is."""
    from handbench.data.poses import read_poses
    from handbench.hand import hand_model

    found = read_poses(path, hand_model())
    return f"{len(found)} {found[0].pose.translation.tolist()}"


def cameras(path: Path) -> str:
    """The cameras of a file."""
    from handbench.data.camerafile import read_cameras

    return " ".join(f"{camera.name} {camera.centre.tolist()}" for camera in read_cameras(str(path), {}))


def picture(path: Path) -> str:
    """The size and the mean of a picture."""
    from handbench.data.pictures import read_picture

    image = read_picture(path).image
    return f"{image.shape} {image.mean():.4g}"


def mano(path: Path) -> str:
    """The digest of MANO's file, and what its hand is made of."""
    from handbench.hand.mano.files import read_mano

    found = read_mano(path)
    return f"{found.v_template.mean():.6g} {found.weights.sum():.6g}"


def avatar(path: Path) -> str:
    """The mean of a picture of an avatar under one light."""
    from handbench.avatars.folder import read_avatar
    from handbench.scene import Directional

    found = read_avatar(path)
    shown = found.repertoire
    viewpoint = shown.viewpoint(shown.posture(shown.views[0][0]), shown.camera(shown.views[0][1]))
    return f"{found.avatar.pose(viewpoint).relight(Directional([0, 0, 1], [1.0, 1.0, 1.0])).image.mean():.5g}"


CALLS: dict[str, Callable[..., str]] = {
    **{"protocol": protocol, "environment": environment, "capture": capture, "score": score, "folder": folder},
    **{"mesh": mesh, "poses": poses, "cameras": cameras, "mano": mano, "avatar": avatar},
    "picture": picture,
}


def attempt(words: list[str]) -> int:
    """The exit code of a command line or of a call, both with the same way out."""
    from handbench.cli import main
    from handbench.cli.endings import ending
    from handbench.terminal import say

    if not words[0].startswith("call:"):
        return main(words)
    try:
        say(CALLS[words[0].removeprefix("call:")](Path(words[1])))
        return 0
    except Exception as error:
        return ending(error, False, None)


def _streams() -> tuple[io.TextIOWrapper, io.TextIOWrapper]:
    sys.stdout, sys.stderr = (io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace") for _ in range(2))
    return sys.stdout, sys.stderr


def _text(stream: io.TextIOWrapper) -> str:
    stream.flush()
    return stream.buffer.getvalue().decode("utf-8", "replace")  # type: ignore[attr-defined]


def serve() -> None:
    asked, answers = sys.stdin, os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 1)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import handbench.bench.check
    import handbench.metrics.compat.compare
    import handbench.reports  # noqa: F401  (loaded before the clock runs)

    answers.write("ready\n")
    answers.flush()
    for line in asked:
        question: dict[str, Any] = json.loads(line)
        os.chdir(question["folder"])
        os.environ.update(question["environment"])
        out, err = _streams()
        try:
            code = attempt(question["words"])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 2
        except BaseException as error:  # got past the only way out
            code = 70
            sys.stderr.write(f"{type(error).__name__}: {error}")
        answers.write(json.dumps({"code": code, "out": _text(out)[:200_000], "err": _text(err)[:200_000]}) + "\n")
        answers.flush()


if __name__ == "__main__":
    serve()
