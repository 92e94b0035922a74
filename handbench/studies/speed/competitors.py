"""What the core is measured against: naive torch and Mitsuba's `direct` integrator, on the same mesh and light."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...data.openstage.trace.llvm import VECTORISED, choose_variant
from ...errors import Unsupported
from ...light.environment import to_directional
from ...light.lightset import LightSet
from ...render.see.raster import Raster, rasterise
from ...render.see.visibility import visibility
from ...render.shade.shading import Model
from ...render.uv.atlas import Atlas
from ...render.uv.surface import surface_maps, vertex_normals
from ...scene import Array, Environment, Mesh
from ...skips import NONE, skipping
from .naive import naive_features
from .scene import Scene

_FINE = 8
"""Texels of Mitsuba's map along each side of one of ours: it interpolates between texels, ours are constant."""

_LARGEST = 512
"""Rows of Mitsuba's map at most."""


class Naive:
    """Whole maps in plain torch: every texel, every light of a grid, every shadow ray, on the product's ray tracer."""

    def __init__(self, scene: Scene, texture: int, grid: tuple[int, int]) -> None:
        self._scene, self._texture = scene, texture
        self._atlas = Atlas.of(scene.mesh.topology, texture)
        nothing = np.zeros((0, 3))
        self._lights = LightSet(*to_directional(scene.environment, *grid, dark=True), nothing, nothing)
        self._known: tuple[Tensor, Tensor, Tensor, Raster]

    def new_pose(self, mesh: Mesh) -> Array:
        """The picture (H, W, 3) of a mesh of which nothing is kept."""
        self.learn(mesh)
        return self.known_pose()

    def learn(self, mesh: Mesh) -> None:
        """Keep a pose: its maps, its shadows, its raster."""
        maps = surface_maps(mesh, self._atlas)
        normal, position = self._atlas.gather(maps.normal), self._atlas.gather(maps.position)
        with skipping(NONE):
            seen = torch.from_numpy(visibility(mesh, self._atlas, self._lights.directions))
        self._known = normal, position, seen, rasterise(mesh, self._scene.camera)

    def known_pose(self) -> Array:
        """The picture of the pose that is kept."""
        normal, position, seen, raster = self._known
        rough = torch.full((self._atlas.count,), self._scene.roughness or 1.0)
        model: Model = "diffuse" if self._scene.roughness is None else "brdf"
        with torch.no_grad():
            centre = self._scene.camera.centre
            diffuse, specular = naive_features(normal, position, rough, centre, self._lights, seen, model)
            colour = torch.from_numpy(self._scene.albedo / np.pi).float()[:, None] * diffuse + specular
            picture = raster.sample(self._atlas.dilate(self._atlas.scatter(colour)))
        return picture.permute(1, 2, 0).numpy()


class Mitsuba:
    """A Lambert scene in Mitsuba's LLVM variant, with the same smooth normals and a box filter.

    Scenes with a roughness have no counterpart: Mitsuba knows neither the masking term nor the Fresnel term of the
    BRDF. Two settings of its own: "default" is the independent sampler with one light sample and one BSDF sample;
    "tuned" is the multi-jittered sampler with light samples alone, which is several times better here. Raises
    `Unsupported` where no LLVM library works.
    """

    def __init__(self, scene: Scene, setting: str) -> None:
        if choose_variant() != VECTORISED:
            raise Unsupported("Mitsuba's LLVM variant needs an LLVM library that works; install libllvm19")
        sampler, bsdf_samples = {"default": ("independent", 1), "tuned": ("multijitter", 0)}[setting]
        import mitsuba as mi

        mi.set_variant(VECTORISED)
        from ...data.openstage.trace.mitsuba_scene import sensor

        view = sensor(scene.camera)
        view["sampler"] = {"type": sampler}
        self._mi = mi
        self._scene: Any = mi.load_dict(
            {
                "type": "scene",
                "integrator": {
                    "type": "direct",
                    "emitter_samples": 1,
                    "bsdf_samples": bsdf_samples,
                    "hide_emitters": True,
                },
                "sensor": view,
                "emitter": {"type": "envmap", "bitmap": mi.Bitmap(bitmap(scene.environment))},
                "hand": _mesh(mi, scene),
            }
        )
        self._parameters: Any = mi.traverse(self._scene)
        self._seed = 0

    def pose(self, mesh: Mesh) -> None:
        """Take over another pose: vertices, smooth normals, and the ray tracer's tree."""
        normals = vertex_normals(mesh.vertices, mesh.topology.faces)
        self._parameters["hand.vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        self._parameters["hand.vertex_normals"] = normals.astype(np.float32).ravel()
        self._parameters.update()

    def picture(self, samples: int) -> Array:
        """The picture (H, W, 3) of so many samples a pixel; each call draws new ones."""
        self._seed += 1
        rendered = self._mi.render(self._scene, spp=samples, seed=self._mi.UInt32(self._seed))
        return np.asarray(rendered, dtype=np.float32)[..., :3]


def bitmap(environment: Environment) -> Array:
    """The constant texels of a map as Mitsuba's interpolated map shows them, up to a narrow ramp at their borders.

    Mitsuba's rows reach from pole to pole, with the first and the last on the poles themselves: a row on a border is
    the mean of both sides, so that ramps lie evenly about borders. Columns lie evenly about them anyway.
    """
    height, _width = environment.radiance.shape[:2]
    fine = max(1, min(_FINE, _LARGEST // height))
    radiance = np.repeat(environment.radiance, fine, axis=1)
    node = np.arange(height * fine + 1)
    above, below = np.maximum(node - 1, 0) // fine, np.minimum(node // fine, height - 1)
    return (radiance[above] + radiance[below]) / 2


def _mesh(mi: Any, scene: Scene) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(a) for a in scene.albedo]}}
    )
    mesh, faces = scene.mesh, scene.mesh.topology.faces
    shape = mi.Mesh("hand", len(mesh.vertices), len(faces), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = vertex_normals(mesh.vertices, faces).astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
