"""Surfaces, cameras and lights as Mitsuba describes them: what the tracer is held to.

Mitsuba is used to check pictures, never to make them.
"""

from __future__ import annotations

from typing import Any, assert_never

import mitsuba as mi
import numpy as np

from ....errors import InputError
from ....render.uv.surface import mesh_normals
from ....scene import Array, Camera, Directional, Environment, Known, Mesh, Point
from .gloss import BROADER, WEIGHTS
from .surface import TracedSurface


def sensor(camera: Camera) -> dict[str, Any]:
    """A camera as a Mitsuba perspective sensor with a box filter. Needs square pixels."""
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    if abs(fx - fy) > 1e-3 * fx or abs(camera.K[0, 1]) > 1e-6:
        raise InputError(f"camera {camera.name!r}: Mitsuba needs square pixels without skew, K is {camera.K.tolist()}")
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


def shape(mesh: Mesh, **properties: Any) -> Any:
    """A Mitsuba mesh with smooth normals and properties like its bsdf; vertices are repeated for several UVs."""
    topology = mesh.topology
    uvs, uv_faces = topology.unwrapped
    pairs = topology.faces.ravel().astype(np.int64) * len(uvs) + uv_faces.ravel()
    unique, corner = np.unique(pairs, return_inverse=True)
    vertex, uv = unique // len(uvs), unique % len(uvs)
    given = mi.Properties()
    for name, value in properties.items():
        given[name] = mi.load_dict(value)
    made = mi.Mesh(
        "surface", len(unique), len(topology.faces), has_vertex_normals=True, has_vertex_texcoords=True, props=given
    )
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mesh.vertices[vertex].astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh_normals(mesh)[vertex].astype(np.float32).ravel()
    parameters["vertex_texcoords"] = uvs[uv].astype(np.float32).ravel()
    parameters["faces"] = corner.astype(np.uint32).ravel()
    parameters.update()
    return made


def matte(surface: TracedSurface) -> dict[str, Any]:
    """The surface without lobes: Lambert's reflection of its albedo, with its relief."""
    return _with_relief(surface, {"type": "diffuse", "reflectance": _texture(surface.albedo)})


def lobes(surface: TracedSurface) -> dict[str, Any]:
    """The surface without pigment: its two specular lobes, with its relief."""
    both = {
        f"lobe_{k}": {
            "type": "principled",
            "base_color": {"type": "rgb", "value": 0.0},
            "roughness": _texture(np.minimum(surface.roughness * wide, 1.0)[..., None]),
            "specular": float(surface.specular),
        }
        for k, wide in enumerate((1.0, BROADER))
    }
    return _with_relief(surface, {"type": "blendbsdf", "weight": WEIGHTS[1], **both})


def _with_relief(surface: TracedSurface, bsdf: dict[str, Any]) -> dict[str, Any]:
    if surface.bump is None:
        return {"type": "twosided", "bsdf": bsdf}
    return {"type": "bumpmap", "relief": _texture(surface.bump[..., None]), "bsdf": bsdf}


def _texture(image: Array) -> dict[str, Any]:
    """A bilinear texture; Mitsuba's V runs down, so rows are turned."""
    return {
        "type": "bitmap",
        "data": mi.TensorXf(np.ascontiguousarray(image[::-1], dtype=np.float32)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }
