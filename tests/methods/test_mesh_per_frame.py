"""A reader that makes a mesh, and a topology, of its own for every frame costs nothing extra."""

from __future__ import annotations

from dataclasses import replace

import pytest

from handbench.methods.kit.views import views
from handbench.methods.reflectance import physical
from handbench.recording import Recording
from handbench.render.see.rays import RayScene
from handbench.scene import Frame, Mesh, Topology, needed


def _own(frame: Frame) -> Frame:
    mesh = needed(frame.mesh, "mesh")
    old = mesh.topology
    topology = Topology(old.faces.copy(), needed(old.uvs, "uv").copy(), needed(old.uv_faces, "uv").copy())
    return replace(frame, mesh=Mesh(mesh.vertices.copy(), topology))


def test_ray_scenes_are_as_many_for_meshes_made_for_every_frame(
    training: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    whole = RayScene.__init__

    def counted(self: RayScene, vertices, faces) -> None:
        made.append(len(vertices))
        whole(self, vertices, faces)

    monkeypatch.setattr(RayScene, "__init__", counted)
    few = [frame for frame in training.frames if frame.kind == "full" or frame.lighting in ("olat-00", "olat-01")]
    frames = {frame.key: frame for frame in few}
    own = Recording(map(_own, few), lambda frame: training.observe(frames[frame.key]))
    counts = []
    for recording in (Recording(few, training.observe), own) * 2:
        made.clear()
        views(recording, 64)
        physical.create(changes={"texture": "64"}).train(recording)
        counts.append(len(made))
    assert counts[2] == counts[3] > 0, "atlases are made by the first"
    assert counts[1] <= counts[0]
