"""Pictures of a hand in a pose: where it scatters light to a camera, and what that looks like under any light."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from handbench.errors import InputError, Unsupported
from handbench.method import PosedAvatar
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster, rasterise
from handbench.scene import Array, Box, Camera, Environment, Light, Mesh, Pose, Prediction, Unknown, Viewpoint, needed

from ..kit.picture import pictured
from .gathering import Gatherer, Gathering
from .person import Person
from .posed import PosedHand, render
from .scattering import LIFT, Scattering
from .visibility import BODY_SCALE, HAND_SCALE, DensityOccluder, MeshOccluder, Occluder

_OWN_LIGHT = (16, 32)
"""Texels of the map in which an avatar's own light is looked up."""

_GRAZING = 0.02
"""Least cosine between what is seen and the viewer."""


@dataclass(frozen=True)
class DrawingSettings:
    """How a posed hand becomes a picture.

    places      "surface": first hits of a mesh of the field, one place a pixel; "volume": the march, `scatter` places a
                pixel drawn by its weights (seed and released code)
    spacing     of the mesh in metres; supersample: rays along a pixel that tell its alpha on the mesh
    visibility  "mesh": rays against it; "march": the density at hand scale; "body-march": as released
    """

    places: Literal["surface", "volume"] = "surface"
    scatter: int = 4
    spacing: float = 2e-3
    supersample: int = 3
    visibility: Literal["mesh", "march", "body-march"] = "mesh"
    gathering: Gathering = field(default_factory=Gathering)

    def __post_init__(self) -> None:
        if self.scatter < 1 or self.supersample < 1 or not self.spacing > 0.0:
            raise InputError(
                f"palm-net: {self.scatter} places and {self.supersample} rays a pixel, a mesh of {self.spacing} m "
                "between nodes; give at least 1 of both, and metres above 0"
            )


class SeenPlaces(NamedTuple):
    """What a camera sees of a hand in a pose: the places that scatter, and the pixel (R) of each of their rays."""

    places: Scattering
    pixel: Tensor


class Hits(NamedTuple):
    """What the P pixels that see a mesh see of it, each by the middle one of its rays that meet the mesh."""

    pixel: Array
    """(P,), flat."""
    x: Tensor
    """Canonical places (P, 3)."""
    point: Tensor
    """Places in the world (P, 3), metres."""
    normal: Tensor
    """The mesh's unit normals (P, 3), which may face away at outlines: see `facing`."""
    view: Tensor
    """Unit directions to the camera (P, 3)."""
    alpha: Tensor
    """The share of a pixel's rays that meet the mesh (P,)."""


def hits(canonical: Tensor, raster: Raster) -> Hits:
    """What each pixel sees of the raster's mesh, whose vertices are at canonical (V, 3) in canonical space."""
    pixel, first, count = np.unique(raster.pixel, return_index=True, return_counts=True)
    chosen = first + count // 2
    share = torch.from_numpy(raster.barycentric[chosen])[..., None]
    faces = raster.mesh.topology.faces[raster.face[chosen]].astype(np.int64)
    x = (share * canonical[torch.from_numpy(faces)]).sum(dim=1)
    point = (share.double() * torch.from_numpy(raster.mesh.vertices[faces])).sum(dim=1).float()
    normal = torch.from_numpy(raster.normal[chosen]).float()
    view = torch.nn.functional.normalize(torch.from_numpy(raster.camera.centre).float() - point, dim=1)
    return Hits(pixel, x, point, normal, view, torch.from_numpy(raster.alpha.reshape(-1)[pixel]))


def surface_view(posed: PosedHand, canonical: Tensor, raster: Raster) -> SeenPlaces:
    """One place for each pixel that sees the raster's mesh, whose vertices are at canonical (V, 3) in canonical space.

    Normals are the mesh's: those of the field jump where its tables' cells of a millimetre meet, and a picture would
    show them as streaks.
    """
    hit = hits(canonical, raster)
    seen = (hit.point + LIFT * hit.normal, facing(hit.normal, hit.view), hit.view, posed.material(hit.x))
    places = Scattering(len(hit.pixel), torch.arange(len(hit.pixel)), hit.alpha, *seen)
    return SeenPlaces(places, torch.from_numpy(hit.pixel.astype(np.int64)))


def facing(normal: Tensor, view: Tensor) -> Tensor:
    """Unit normals (N, 3) that face the viewer, view (N, 3) unit: what is seen does, and a smooth normal near an
    outline may not, which would be black."""
    missing = (_GRAZING - (normal * view).sum(dim=1, keepdim=True)).clamp_min(0.0)
    return torch.nn.functional.normalize(normal + missing * view, dim=1)


def volume_view(posed: PosedHand, camera: Camera, scatter: int) -> SeenPlaces:
    """At most `scatter` places for each pixel of the posed hand's box, drawn by the weights of a march."""
    low, high = posed.box.double().numpy()
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    pixel, towards = pixel_rays(camera, camera.box(corners))
    origins = torch.from_numpy(camera.centre).float().expand(len(towards), 3)
    rendering = render(posed, origins, towards, posed.model.config.marching, None)
    return SeenPlaces(Scattering.of(posed, rendering).drawn(scatter), torch.from_numpy(pixel))


def pixel_rays(camera: Camera, box: Box) -> tuple[Array, Tensor]:
    """The pixels (R,) of a box, flat, and the unit directions (R, 3) through their middles."""
    rows, columns = np.mgrid[box.top : box.bottom, box.left : box.right]
    rays = camera.rays(1, box).reshape(-1, 3)
    towards = torch.from_numpy(rays / np.linalg.norm(rays, axis=1, keepdims=True)).float()
    return (rows * camera.width + columns).ravel(), towards


@dataclass(frozen=True, eq=False)
class PosedPerson:
    """A person's hand in a pose, whoever looks: the field, its mesh in the world with the vertices' canonical places,
    and what hides light."""

    posed: PosedHand
    mesh: PosedMesh
    canonical: Tensor
    occluder: Occluder
    own_light: Environment

    @staticmethod
    def of(person: Person, pose: Pose, drawing: DrawingSettings) -> PosedPerson:
        posed = person.posed(pose)
        surface = posed.surface(drawing.spacing)
        mesh = PosedMesh(surface.mesh)
        own = person.light.to_environment(*_OWN_LIGHT)
        return PosedPerson(posed, mesh, surface.canonical, _occluder(posed, mesh, drawing), own)

    def holds(self, point: Array) -> bool:
        """Whether a point (3,) of the world is inside; one beside the mesh is told without a search for its roots."""
        if (point < self.mesh.vertices.min(axis=0)).any() or (point > self.mesh.vertices.max(axis=0)).any():
            return False
        return bool(self.posed.sdf(torch.from_numpy(point[None]).float()) < 0.0)


class PosedPalm(PosedAvatar):
    """A person's hand in a pose before a camera: the places that scatter light, their materials, and what hides it."""

    def __init__(self, body: PosedPerson, camera: Camera, drawing: DrawingSettings) -> None:
        self._body, self._camera, self._drawing = body, camera, drawing
        if body.holds(camera.centre):
            raise Unsupported(f"camera {camera.name!r} is inside the hand; move it away")
        self._raster = rasterise(body.mesh, camera, drawing.supersample)
        if drawing.places == "surface":
            view = surface_view(body.posed, body.canonical, self._raster)
        else:
            view = volume_view(body.posed, camera, drawing.scatter)
        self._pixel = view.pixel
        self._alpha = self._image(view.places.total(torch.ones(len(view.places.ray), 1)).clamp_max(1.0))[..., 0]
        self._gatherer = Gatherer(view.places, body.occluder, drawing.gathering)

    @staticmethod
    def of(person: Person, viewpoint: Viewpoint, drawing: DrawingSettings) -> PosedPalm:
        """The hand of a person. Raises `Unsupported` for a pose that is not given or that a hand cannot take, and for a
        camera inside the hand."""
        return PosedPalm(PosedPerson.of(person, needed(viewpoint.pose, "pose"), drawing), viewpoint.camera, drawing)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedPalm(self._body, camera, self._drawing)

    def relight(self, light: Light) -> Prediction:
        """Under a known light; under an unknown one by the light that was found in the enrolled picture."""
        known = self._body.own_light if isinstance(light, Unknown) else light
        drawn = pictured(self._raster, self._image(self._gatherer.colours(known)))
        return replace(drawn, alpha=self._alpha.numpy(), mesh=Mesh(self._body.mesh.vertices, self._body.mesh.topology))

    def _image(self, values: Tensor) -> Tensor:
        """An image (H, W, C) of values (R, C) at the rays' pixels."""
        size = (self._camera.height, self._camera.width)
        flat = torch.zeros(size[0] * size[1], values.shape[1])
        return flat.index_copy(0, self._pixel, values).reshape(*size, -1)


def _occluder(posed: PosedHand, mesh: PosedMesh, drawing: DrawingSettings) -> Occluder:
    if drawing.visibility == "mesh":
        return MeshOccluder(mesh)
    march = HAND_SCALE if drawing.visibility == "march" else BODY_SCALE
    return DensityOccluder(posed.density, march)
