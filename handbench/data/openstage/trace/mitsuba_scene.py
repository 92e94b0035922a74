"""Surfaces, cameras and lights as Mitsuba describes them.

The surface is the principled BSDF of Burley ("Physically Based Shading at Disney", 2012) with textured base colour
and roughness, no transmission, and fine relief by bump mapping.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, assert_never

import mitsuba as mi
import numpy as np

from ....errors import InputError
from ....render.uv.surface import mesh_normals
from ....scene import Array, Camera, Directional, Environment, Known, Mesh, Point


@dataclass(frozen=True, eq=False)
class TracedSurface:
    """What is traced: a mesh with smooth normals, albedo (R, R, 3) linear, roughness (R, R); row 0 = top.

    normals (V, 3): smooth vertex normals, computed from the faces if None. specular: the principled BSDF's
    reflectance knob (0.42 is an index of refraction of 1.45, dry skin). bump (R, R): relief in
    metres too fine for the mesh, which tilts the shading normal. mean_free_path (R, R, 3) or (3,): how far light
    travels under the surface, the diffuse mean free path in metres per channel, 0 where nothing scatters; None: light
    leaves where it arrives (the surface model).
    """

    mesh: Mesh
    albedo: Array
    roughness: Array
    normals: Array | None = None
    specular: float = 0.42
    bump: Array | None = None
    mean_free_path: Array | None = None


def sensor(camera: Camera) -> dict[str, Any]:
    """A camera as a Mitsuba perspective sensor with a box filter. Needs square pixels."""
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    if abs(fx - fy) > 1e-3 * fx or abs(camera.K[0, 1]) > 1e-6:
        raise InputError(
            f"camera {camera.name!r}: scalar_rgb needs square pixels without skew, K is {camera.K.tolist()}"
        )
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])  # Mitsuba looks along +z with +x left and +y up
    pose[:3, 3] = camera.centre
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * fx)))),
        "fov_axis": "x",
        "principal_point_offset_x": float(0.5 - camera.K[0, 2] / camera.width),
        "principal_point_offset_y": float(0.5 - camera.K[1, 2] / camera.height),
        "near_clip": 1e-3,
        "to_world": mi.ScalarTransform4f(pose.tolist()),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def emitter(light: Known) -> dict[str, Any]:
    """A single light as a Mitsuba emitter; environments are interpolated between texels there."""
    match light:
        case Directional():
            return {
                "type": "directional",
                "direction": (-light.direction).tolist(),
                "irradiance": {"type": "rgb", "value": light.irradiance.tolist()},
            }
        case Point():
            return {
                "type": "point",
                "position": light.position.tolist(),
                "intensity": {"type": "rgb", "value": light.intensity.tolist()},
            }
        case Environment():
            return {"type": "envmap", "bitmap": mi.Bitmap(np.array(light.radiance))}
        case _:
            assert_never(light)


def shape(surface: TracedSurface) -> Any:
    """A Mitsuba mesh: vertices are repeated where one has several UVs."""
    topology = surface.mesh.topology
    uvs, uv_faces = topology.unwrapped
    pairs = topology.faces.ravel().astype(np.int64) * len(uvs) + uv_faces.ravel()
    unique, corner = np.unique(pairs, return_inverse=True)
    vertex, uv = unique // len(uvs), unique % len(uvs)
    normals = surface.normals
    if normals is None:
        normals = mesh_normals(surface.mesh)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(surface))
    mesh = mi.Mesh(
        "surface",
        len(unique),
        len(topology.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = surface.mesh.vertices[vertex].astype(np.float32).ravel()
    parameters["vertex_normals"] = normals[vertex].astype(np.float32).ravel()
    parameters["vertex_texcoords"] = uvs[uv].astype(np.float32).ravel()
    parameters["faces"] = corner.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def _bsdf(surface: TracedSurface) -> dict[str, Any]:
    smooth = {
        "type": "principled",
        "base_color": _texture(surface.albedo),
        "roughness": _texture(surface.roughness[..., None]),
        "specular": float(surface.specular),
    }
    if surface.bump is None:
        return smooth
    return {"type": "bumpmap", "relief": _texture(surface.bump[..., None]), "bsdf": smooth}


def _texture(image: Array) -> dict[str, Any]:
    """A bilinear texture; Mitsuba's V runs down, so rows are turned."""
    return {
        "type": "bitmap",
        "data": mi.TensorXf(np.ascontiguousarray(image[::-1], dtype=np.float32)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }
