"""Make docs/hero.jpg: two people under light from the side, from behind, in the sun and indoors, and close by.

    python maintainer/make_hero.py [--folder build/hero] [--height 1024] [TILE …]

Tiles are kept in the folder, and those that are there are not made again; the picture is put together when all are.
"""

from __future__ import annotations

import argparse
import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from handbench.data.openstage.cast import person
from handbench.data.openstage.performance import traced
from handbench.data.openstage.skin import Skin, make_skin
from handbench.data.openstage.stage import environment
from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface
from handbench.hand.openhand import OpenHand, named_pose
from handbench.scene import Array, Camera, Directional, Environment, Light, Pose
from handbench.scene.colour import eight_bit

ROOT = Path(__file__).resolve().parents[1]
SPP, TEXELS, LEVEL = 32, 2048, 3
PALE, DARK = 23, 14  # two of the people that `person` knows
BACK, PALM = (0.12, 0.1, -1.0), (-0.1, 0.0, 1.0)


@dataclass(frozen=True)
class HeroTile:
    """Who, in which pose and turned how (degrees), in which light; `view`: from the target to the camera; `target`: in
    metres; `high`: metres of the scene that the picture's height covers."""

    name: str
    subject: int
    pose: str
    turned: tuple[float, float, float]
    light: str
    view: tuple[float, float, float]
    target: tuple[float, float, float] = (0.0, 0.075, 0.0)
    high: float = 0.27


TILES = (
    HeroTile("side", PALE, "rest", (0, 12, -4), "side", BACK),
    HeroTile("behind", PALE, "open", (0, -14, 3), "behind", PALM),
    HeroTile("close", PALE, "rest", (0, 12, -4), "sun", BACK, (-0.005, 0.105, 0.0), 0.11),
    HeroTile("sun", DARK, "rest", (0, 12, -4), "sun", BACK),
    HeroTile("indoor", DARK, "open", (0, -14, 3), "indoor", PALM),
    HeroTile("palm", DARK, "open", (0, -14, 3), "side-palm", PALM, (0.0, 0.085, 0.0), 0.11),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "hero", help="where tiles are kept")
    parser.add_argument("--height", type=int, default=1024, help="of a tile in pixels")
    parser.add_argument("tiles", nargs="*", metavar="TILE", help="names of tiles to make (default: all)")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    places = [arguments.folder / f"{tile.name}.png" for tile in TILES]
    surfaces: dict[tuple[int, str], TracedSurface] = {}
    tracer = PathTracer()
    for tile, place in sorted(zip(TILES, places, strict=True), key=lambda one: (one[0].subject, one[0].pose)):
        if not place.exists() and (not arguments.tiles or tile.name in arguments.tiles):
            Image.fromarray(eight_bit(_picture(tile, arguments.height, surfaces, tracer))).save(place)
            print(place, flush=True)
    if all(place.exists() for place in places):
        rows = [np.hstack([np.asarray(Image.open(place)) for place in part]) for part in (places[:3], places[3:])]
        Image.fromarray(np.vstack(rows)).save(ROOT / "docs" / "hero.jpg", quality=86)


@functools.cache
def _skin(subject: int) -> Skin:
    hand = OpenHand.load()
    someone = person(subject, hand)
    return make_skin(hand, someone.identity, someone.look, TEXELS)


def _picture(tile: HeroTile, height: int, surfaces: dict[tuple[int, str], TracedSurface], tracer: PathTracer) -> Array:
    """Linear pixels (height, 3/4 height, 3) before what lies far behind, out of focus."""
    hand = OpenHand.load()
    if (tile.subject, tile.pose) not in surfaces:
        pose = Pose(named_pose(tile.pose).joints, np.radians(tile.turned), np.zeros(3))
        mesh = hand.mesh(person(tile.subject, hand).identity, pose, LEVEL)
        surfaces[tile.subject, tile.pose] = traced(mesh, _skin(tile.subject))
    surface, camera, lights = surfaces[tile.subject, tile.pose], _camera(tile, height), _lights(tile.light)
    image = tracer.render(surface, camera, lights, spp=SPP, seed=0).sum(axis=0)
    alpha = tracer.gbuffer(surface, camera, spp=16).alpha[..., None]
    return _exposed(image + (1 - alpha) * _background(lights[-1], camera))


def _camera(tile: HeroTile, height: int) -> Camera:
    width, focal = height * 3 // 4, height / tile.high
    forward = -np.asarray(tile.view) / np.linalg.norm(tile.view)
    right = np.cross([0.0, -1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    centre = np.asarray(tile.target) - forward  # from one metre
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(tile.name, width, height, K, np.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1))


def _lights(name: str) -> list[Light]:
    """A lamp or the sun, and last the surroundings."""
    match name:
        case "side":
            return [_lamp((0.95, 0.25, -0.45), 3.4), environment("hall", 64).scaled(0.10)]
        case "side-palm":
            return [_lamp((-0.9, 0.35, 0.55), 3.2), environment("hall", 64).scaled(0.15)]
        case "behind":
            return [_lamp((0.35, 0.45, -0.85), 9.0), environment("hall", 64).scaled(0.10)]
        case "sun":
            return [_lamp((0.55, 0.7, -0.6), 5.5, (1.0, 0.93, 0.82)), environment("brightday", 64).scaled(0.6)]
        case _:
            return [environment("hall", 64)]


def _lamp(
    direction: tuple[float, float, float], irradiance: float, tint: tuple[float, float, float] = (1, 1, 1)
) -> Light:
    return Directional(np.asarray(direction) / np.linalg.norm(direction), irradiance * np.asarray(tint))


def _background(light: Light, camera: Camera) -> Array:
    """What the camera sees of the surroundings, blurred as by a wide aperture, and dimmed."""
    assert isinstance(light, Environment)
    rows, columns = light.radiance.shape[:2]
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T
    pixels[..., :2] *= 1.6  # the surroundings as a shorter lens would see them
    ray = pixels @ camera.rotation
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    row = np.arccos(np.clip(ray[..., 1], -1, 1)) / np.pi * rows - 0.5
    column = (np.arctan2(ray[..., 0], -ray[..., 2]) / (2 * np.pi) + 0.5) * columns - 0.5
    soft = gaussian_filter(np.minimum(light.radiance, 4.0), (1.2, 1.2, 0), mode=("nearest", "wrap", "nearest"))
    seen = [map_coordinates(soft[..., c], [row, column], order=1, mode="grid-wrap") for c in range(3)]
    return 0.6 * np.stack(seen, axis=-1)


def _exposed(image: Array) -> Array:
    """Bright parts rolled off, as film does."""
    shoulder = 0.6 + 0.4 * (1 - np.exp(-(image - 0.6) / 0.4))
    return np.where(image > 0.6, shoulder, image)


if __name__ == "__main__":
    main()
