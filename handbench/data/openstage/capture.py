"""Reader of a folder that the generator made: any of the open captures."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...recording import Need
from ...scene import Array, Camera, Directional, Environment, Frame, Group, Light, Mesh, Observation, Point, Pose
from ...scene import Topology as _Topology
from ..capture import Capture
from .inventory import olat_name, recorded
from .manifest import FILE, Manifest, read_manifest
from .reading import Files
from .thumbnails import PictureDifference, difference


class OpenCapture(Capture):
    """A generated capture; groups and fully lit frames are the exact weighted sums of single-light images.

    Its digest is that of the recipe: what two machines make of one recipe is the same capture. That a file is what was
    generated here is checked when it is first read.
    """

    hand = "openhand"

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / FILE
        self._manifest = manifest = read_manifest(path)
        try:
            self.name = f"{manifest['capture']}-{manifest['preset']['name']}"
            self.digest = manifest["recipe"]
            self._weights = {
                entry["name"]: np.asarray(entry["weights"])
                for entry in manifest["lightings"]
                if entry["weights"] is not None
            }
            pixels = max(camera["height"] * camera["width"] for camera in manifest["cameras"])
            self._files = Files(folder, recorded(folder, manifest), pixels)
            self._poses = {
                (person["name"], pose["name"]): (person, pose)
                for person in manifest["subjects"]
                for pose in person["poses"]
            }
            self._topology = self._read_topology()
            self._keypoints: dict[str, Array] = {}
            self._frames = tuple(self._build())
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(f"{path} is damaged ({error} is missing or wrong); make the capture again") from error
        self._full = lru_cache(256)(self._sum)  # sums of all lights, which every method's mean textures are made from
        self._scan = lru_cache(8)(self._read_scan)

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        devices = (shot["device"] for _, pose in self._poses.values() for shot in pose["shots"])
        parts: dict[Need, bool] = {"depth": True, "normal": not any(devices)}
        parts |= {"keypoints": bool(self._keypoints), "scan": self._manifest["meshes"] == "scan"}
        return super().offers | {part for part, there in parts.items() if there}

    @property
    def remarks(self) -> tuple[str, ...]:
        if "difference" not in self._manifest:
            return ()
        told = self._manifest["difference"]  # None as well where the package had no pictures when it was made
        off = PictureDifference(**told) if told else difference(self._manifest, self.folder)
        if off is None:
            return ("the package has no pictures of this size to compare its own with",)
        return (f"{off.views} of its pictures differ by at most {off.largest:.3%} from those of the package",)

    def observe(self, frame: Frame) -> Observation:
        camera = frame.camera
        size, folder = (camera.height, camera.width), f"{frame.subject}/{frame.pose_name}/{camera.name}"
        if frame.kind == "full":
            image = self._full(folder, frame.lighting, *size)
        elif frame.lighting in self._weights:
            image = self._sum(folder, frame.lighting, *size)
        else:
            image = self._files.image(f"{folder}/{frame.lighting}.exr", *size).astype(np.float32)
        maps = self._files.geometry(f"{folder}/geometry.exr", *size)
        scan = self._scan(frame.pose_key) if self._manifest["meshes"] == "scan" else None
        return Observation(image, **maps, keypoints=self._keypoints.get(frame.key), scan=scan)

    def truth(self, frame: Frame) -> Frame:
        person, pose = self._poses[frame.subject, frame.pose_name]
        if person["shape"] is None:
            return frame
        from ...hand.openhand import OpenHand

        shape, posed = np.asarray(person["shape"]), _pose(pose)
        return replace(frame, pose=posed, shape=shape, mesh=OpenHand.load().mesh(shape, posed, _level(self._manifest)))

    def _sum(self, folder: str, lighting: str, height: int, width: int) -> Array:
        weights = self._weights[lighting]
        image = np.zeros((height, width, 3), np.float32)
        for i in np.flatnonzero(weights):
            image += np.float32(weights[i]) * self._files.image(f"{folder}/{olat_name(int(i))}.exr", height, width)
        image.flags.writeable = False  # the fully lit ones are shared
        return image

    def _read_topology(self) -> _Topology | None:
        if self._manifest["meshes"] is None:
            return None
        arrays = self._files.arrays("topology.npz")
        return _Topology(arrays["faces"], arrays["uvs"], arrays["uv_faces"])

    def _read_scan(self, pose_key: str) -> Mesh:
        assert self._topology is not None
        return Mesh(self._files.arrays(f"{pose_key}/scan.npy"), _Topology(self._topology.faces))

    def _build(self) -> list[Frame]:
        manifest = self._manifest
        cameras = {c["name"]: Camera(**{**c, "K": np.asarray(c["K"])}) for c in manifest["cameras"]}
        olats = [Directional(np.asarray(o["direction"]), np.asarray(o["irradiance"])) for o in manifest["olat"]]
        lights = {entry["name"]: (entry["kind"], self._light(entry, olats)) for entry in manifest["lightings"]}
        frames = []
        for person, pose in self._poses.values():
            key = f"{person['name']}/{pose['name']}"
            topology = self._topology if manifest["meshes"] == "tracked" else None
            mesh = None if topology is None else Mesh(self._files.arrays(f"{key}/tracked.npy"), topology)
            shape = person["estimated_shape"] or person["shape"]
            true, estimate = _pose(pose), pose["estimate"] and _pose(pose["estimate"])
            for shot in pose["shots"]:
                told = estimate if shot["estimated"] else true
                for camera in shot["cameras"] or cameras:
                    for name in shot["lightings"] or lights:
                        kind, light = lights[name]
                        who, when = (person["name"], pose["name"], name), (shot["segment"], kind, shape, pose["moment"])
                        frames.append(Frame(*who, told, mesh, cameras[camera], light, *when))
                        if camera in shot["keypoints"]:
                            self._keypoints[frames[-1].key] = np.asarray(shot["keypoints"][camera])
        return frames

    def _light(self, entry: dict[str, Any], olats: list[Directional]) -> Light:
        name, weights = entry["name"], entry["weights"]
        if (point := entry.get("point")) is not None:
            return Point(np.asarray(point["position"]), np.asarray(point["intensity"]))
        if weights is None:
            return Environment(name.removeprefix("env-"), self._files.radiance(f"environments/{name}.exr"))
        members = tuple(olat.scaled(w) if w != 1 else olat for olat, w in zip(olats, weights, strict=True) if w > 0)
        return members[0] if len(members) == 1 else Group(members)


def _pose(told: dict[str, Any]) -> Pose:
    return Pose(told["joints"], told["rotation"], told["translation"])


def _level(manifest: Manifest) -> int:
    """Of the true meshes: coarse ones, which are compared vertex by vertex."""
    return manifest["mesh_level"] if manifest["meshes"] == "tracked" else 1
