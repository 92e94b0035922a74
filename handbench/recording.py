"""Frames as a method sees them: those that it may see, and of each no more than is given."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, Literal, get_args

from .errors import InputError
from .scene import Frame, FrameKind, Light, Mesh, Observation, Query, Topology, Uncalibrated, Unknown, leaves

Part = Literal[
    "image", "alpha", "camera", "depth", "normal", "uv", "keypoints", "scan", "pose", "shape", "mesh", "light"
]
"""What can be given of a frame. "uv" is the UVs of meshes and the UV maps of pictures; "mesh" is a tracked mesh."""
PARTS: frozenset[Part] = frozenset(get_args(Part))

Need = Literal[Part, FrameKind, "olat or group"]
"""What a method can need and a capture offer: parts of frames, and kinds of them."""
NEEDS: frozenset[Need] = frozenset(get_args(Need))


def offered(frames: Iterable[Frame]) -> frozenset[Need]:
    """What frames tell that they have, by themselves: what their pictures have beside colour only a capture can say."""
    frames = tuple(frames)
    parts: dict[Need, bool] = {
        "mesh": all(frame.mesh is not None for frame in frames),
        "uv": all(frame.mesh is not None and frame.mesh.topology.uvs is not None for frame in frames),
        "pose": all(frame.pose is not None for frame in frames),
        "shape": all(frame.shape is not None for frame in frames),
        "camera": not any(isinstance(frame.camera, Uncalibrated) for frame in frames),
        "light": not any(isinstance(single, Unknown) for light in _lights(frames) for single in leaves(light)),
    }
    parts |= {"image": True, "alpha": True}
    return frozenset(part for part, there in parts.items() if there) | kinds_of(frames)


def kinds_of(frames: Iterable[Frame]) -> frozenset[Need]:
    """The kinds of frames that there are, as words of `Need`."""
    kinds: set[Need] = {frame.kind for frame in frames}
    return frozenset(kinds | {"olat or group"} if kinds & {"olat", "group"} else kinds)


def _lights(frames: Iterable[Frame]) -> Iterable[Light]:
    return {id(frame.light): frame.light for frame in frames}.values()


class Recording:
    """The frames that a method may see, and the way to their images.

    `frames` are without the parts that are not given: no pose, shape or mesh, or one without UVs; an `Uncalibrated`
    camera; an `Unknown` light, and then the lighting's name is replaced too. `observe(frame)` reads (and may cache)
    the images of one of them, again without what is not given; the arrays are read-only.
    """

    def __init__(
        self, frames: Iterable[Frame], observe: Callable[[Frame], Observation], gives: frozenset[Part] = PARTS
    ) -> None:
        recorded = tuple(frames)
        self.gives = gives
        self.frames = _withheld(recorded, gives)
        self.observe = _reader(dict(zip((f.key for f in self.frames), recorded, strict=True)), observe, gives)

    @property
    def subjects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(frame.subject for frame in self.frames))

    def where(self, keep: Callable[[Frame], bool]) -> Recording:
        """The recording of the frames for which `keep(frame)` is true."""
        part = copy(self)
        part.frames = tuple(filter(keep, self.frames))
        return part

    def of_subject(self, subject: str) -> Recording:
        return self.where(lambda frame: frame.subject == subject)

    def of_kind(self, *kinds: FrameKind) -> Recording:
        return self.where(lambda frame: frame.kind in kinds)


def without_geometry(query: Query, gives: frozenset[Part]) -> Query:
    """A query whose mesh is given, or left out, as those of a recording are."""
    return replace(query, mesh=_mesh(query.mesh, gives))


def _mesh(mesh: Mesh | None, gives: frozenset[Part]) -> Mesh | None:
    if mesh is None or "mesh" not in gives:
        return None
    if "uv" in gives or mesh.topology.uvs is None:
        return mesh
    return Mesh(mesh.vertices, Topology(mesh.topology.faces))


def _withheld(frames: Sequence[Frame], gives: frozenset[Part]) -> tuple[Frame, ...]:
    """The frames without what is not given; what they shared they still share."""
    if gives == PARTS:
        return tuple(frames)
    meshes = {id(frame.mesh): frame.mesh for frame in frames}
    cameras = {id(frame.camera): frame.camera for frame in frames}
    names: dict[str, str] = {}
    lights: dict[str, Light] = {}
    given_meshes = {key: _mesh(mesh, gives) for key, mesh in meshes.items()}
    if "camera" not in gives:
        cameras = {key: Uncalibrated(c.name, c.width, c.height) for key, c in cameras.items()}
    if "light" not in gives:  # frames elsewhere tell the light of a name, so the names go too
        names = {name: f"light-{i}" for i, name in enumerate(dict.fromkeys(frame.lighting for frame in frames))}
        lights = {name: Unknown(given) for name, given in names.items()}
    return tuple(
        replace(
            frame,
            mesh=given_meshes[id(frame.mesh)],
            camera=cameras[id(frame.camera)],
            light=lights.get(frame.lighting, frame.light),
            lighting=names.get(frame.lighting, frame.lighting),
            pose=frame.pose if "pose" in gives else None,
            shape=frame.shape if "shape" in gives else None,
        )
        for frame in frames
    )


def _reader(
    recorded: dict[str, Frame], observe: Callable[[Frame], Observation], gives: frozenset[Part]
) -> Callable[[Frame], Observation]:
    """Reads the images of the recorded frames by their keys: whatever frame it is asked for, it tells no other."""
    withheld: dict[str, Any] = dict.fromkeys({"alpha", "depth", "normal", "uv", "keypoints", "scan"} - gives)

    def read(frame: Frame) -> Observation:
        if frame.key not in recorded:
            raise InputError(f"frame {frame.key} is not one of this recording; observe only the frames it hands over")
        found = observe(recorded[frame.key])
        return replace(found, **withheld) if withheld else found

    return read
