"""From pictures to the texture: what cameras saw at the texels of a posed mesh, and the mean of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from ...scene import Array, Camera
from ..see.posedmesh import PosedMesh
from ..see.rays import RayScene
from .atlas import Atlas
from .surface import unit_rows

_EDGE = 0.99  # a texel whose pixel is covered less is at the silhouette: background would bleed in


@dataclass(frozen=True)
class Projected:
    """What one picture shows of a texture: colour (C, N) at the covered texels of an atlas, and weight (N,).

    The weight is the cosine between normal and direction to the camera, so that grazing views count little; it is zero
    where the camera did not see the texel.
    """

    colour: Array
    weight: Array


@dataclass(frozen=True)
class Averaged:
    """The weighted mean colour (C, N) of several pictures, zero where none saw the texel; the sum of the weights (N,),
    and by how many pictures each texel was seen, `views` (N,)."""

    colour: Array
    weight: Array
    views: Array

    @property
    def seen(self) -> Array:
        """Which texels any picture saw, (N,) bool."""
        return self.views > 0


@dataclass(frozen=True)
class TexelSurface:
    """Positions and unit normals (N, 3) of the covered texels of one posed mesh, and its rays."""

    position: Array
    normal: Array
    scene: RayScene

    @staticmethod
    def of(mesh: PosedMesh, atlas: Atlas) -> TexelSurface:
        return TexelSurface(atlas.interpolate(mesh.vertices), unit_rows(atlas.interpolate(mesh.normals)), mesh.rays)

    def project(self, camera: Camera, image: Array, alpha: Array, steepest: float = 0.0) -> Projected:
        """What a picture (H, W, C) with a mask (H, W) shows of the texture.

        Seen are texels that face the camera, lie wholly inside the mask and are hidden by nothing; those whose cosine
        is at most `steepest` do not count.
        """
        to_camera = unit_rows(camera.centre - self.position)
        cosine = (self.normal * to_camera).sum(axis=1)
        places, _ = camera.project(self.position)
        behind = np.isnan(places)  # the camera: counts as outside the picture
        pixel = np.where(behind, -1.0, places)[:, ::-1].T - 0.5  # row, column of pixel centres
        covered = map_coordinates(alpha, pixel, order=1, cval=0.0)
        facing = np.flatnonzero((cosine > steepest) & (covered > _EDGE))
        origin = self.position[facing] + self.scene.epsilon * self.normal[facing]
        hidden = self.scene.occluded(origin, camera.centre - origin, far=1.0)
        weight = np.zeros(len(cosine))
        weight[facing[~hidden]] = cosine[facing[~hidden]]
        channels = [map_coordinates(channel, pixel, order=1, cval=0.0) for channel in np.moveaxis(image, -1, 0)]
        return Projected(np.stack(channels), weight)


def averaged(pictures: Iterable[Projected]) -> Averaged:
    """The mean of what pictures show of one texture; there must be at least one picture."""
    total, weight, views = np.zeros(()), np.zeros(()), np.zeros((), dtype=np.int64)
    for picture in pictures:
        total = total + picture.colour * picture.weight
        weight = weight + picture.weight
        views = views + (picture.weight > 0)
    return Averaged(np.divide(total, weight, out=np.zeros_like(total), where=weight > 0), weight, views)
