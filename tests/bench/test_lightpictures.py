"""Pictures of lights: a lamp stands where it is, an environment is itself, what is not known has none."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from handbench.bench.lightpictures import HEIGHT, WIDTH, light_pictures, panorama
from handbench.light.environment import texels
from handbench.registry import CAPTURES
from handbench.scene import Directional, Environment, Group, Point, Unknown

HERE = np.array([0.1, -0.2, 0.3])
UP_RIGHT = np.array([1.0, 1.0, 0.5]) / 1.5


@pytest.mark.parametrize(
    "light", [Directional(UP_RIGHT, np.ones(3)), Point(HERE + 0.4 * UP_RIGHT, np.ones(3))], ids=["far", "near"]
)
def test_a_lamp_is_white_where_it_is_and_nowhere_else(light):
    picture = panorama(light, HERE)
    row, column = texels(UP_RIGHT, HEIGHT, WIDTH)
    assert picture[row, column] == pytest.approx(1.0)
    assert 0.001 < (picture > 0.5).mean() < 0.02
    assert picture[row, (column + WIDTH // 2) % WIDTH].max() < 0.1


def test_of_two_lamps_the_nearer_is_brighter():
    left, right = np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])
    picture = panorama(Group((Point(HERE + 0.5 * left, np.ones(3)), Point(HERE + right, np.ones(3)))), HERE)
    near, far = (picture[texels(each, HEIGHT, WIDTH)].max() for each in (left, right))
    assert near == pytest.approx(1.0) and 0.5 < far < 0.6, "a quarter of the light, shown in sRGB"


def test_an_environment_is_exposed_by_itself_and_what_is_unknown_is_not_drawn():
    radiance = np.full((16, 32, 3), 7.0)
    radiance[:8] = 700.0
    picture = panorama(Environment("sky", radiance), HERE)
    assert picture[: HEIGHT // 2 - 1].min() > 0.85 and picture[HEIGHT // 2 + 1 :].max() < 0.2
    assert (
        panorama(Unknown("lab"), HERE) is None
        and panorama(Group((Directional(UP_RIGHT, np.ones(3)), Unknown("lab"))), HERE) is None
    )


def test_lightings_share_a_picture_unless_frames_of_one_are_lit_otherwise():
    frames = [frame for frame in CAPTURES.load("openstage")("mini").frames() if frame.kind == "olat"]
    pictures = dict(light_pictures(frames))
    assert set(pictures) == {frame.lighting for frame in frames}
    other = replace(frames[0], light=Directional(-UP_RIGHT, np.ones(3)))
    same = [frame for frame in frames[1:] if frame.lighting == other.lighting][:1]
    found = dict(light_pictures([other, *same]))
    assert set(found) == {other.key, same[0].key}
    assert Image.open(io.BytesIO(found[other.key])).size == (WIDTH, HEIGHT)


def test_a_near_lamp_is_drawn_from_where_the_hand_is_if_that_is_known():
    frame, *_ = CAPTURES.load("openstage")("mini").frames()
    lamp = Point(frame.pose.translation + np.array([0.0, 0.3, 0.0]), np.ones(3))
    there = replace(frame, lighting="lamp", light=lamp)
    moved = replace(frame.pose, translation=frame.pose.translation + np.array([0.3, 0.3, 0.0]))
    elsewhere = replace(there, pose_name="elsewhere", pose=moved)
    found = dict(light_pictures([there, elsewhere]))
    assert found.keys() == {there.key, elsewhere.key} and found[there.key] != found[elsewhere.key]
    nowhere = replace(there, pose=None, mesh=None)
    assert dict(light_pictures([nowhere])) == {}, "nobody knows where the lamp is seen"
    assert len(dict(light_pictures([replace(nowhere, light=Directional(UP_RIGHT, np.ones(3)))]))) == 1
