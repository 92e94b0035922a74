"""A camera's places, points and rays agree with each other and with pinhole geometry worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handbench.errors import InputError
from handbench.scene import Box, Camera

K = np.array([[50.0, 2.0, 4.0], [0.0, 40.0, 3.0], [0.0, 0.0, 1.0]])
PLAIN = Camera("plain", 8, 6, K, np.eye(3, 4))


def camera(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Camera:
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return Camera("c", 8, 6, K, np.column_stack([rotation, shift]))


def test_a_point_is_seen_where_the_pinhole_says() -> None:
    # x = 50 * 0.1 / 2 + 2 * 0.2 / 2 + 4, y = 40 * 0.2 / 2 + 3
    places, depth = PLAIN.project([[0.1, 0.2, 2.0]])
    assert np.allclose(places, [[6.7, 7.0]]) and np.array_equal(depth, [2.0])


def test_what_is_not_ahead_has_no_place() -> None:
    places, depth = PLAIN.project([[[0.0, 0.0, 0.0], [0.1, 0.2, -2.0]], [[0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]])
    assert np.array_equal(np.isnan(places).all(axis=-1), [[True, True], [False, False]])
    assert np.array_equal(depth, [[0.0, -2.0], [1.0, 1.0]])


@given(
    turn=st.tuples(*3 * [st.floats(-3, 3)]),
    shift=st.tuples(*3 * [st.floats(-2, 2)]),
    places=st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0.1, 5)), min_size=1, max_size=4),
)
def test_unproject_undoes_project(turn, shift, places) -> None:
    one, told = camera(turn, shift), np.array(places)
    found, depth = one.project(one.unproject(told[:, :2], told[:, 2]))
    assert np.allclose(found, told[:, :2], atol=1e-6) and np.allclose(depth, told[:, 2])


@pytest.mark.parametrize("supersample", [1, 3])
def test_rays_go_through_the_middle_of_every_part_of_a_pixel(supersample: int) -> None:
    one = camera((0.3, -0.8, 0.1), (0.2, 0.1, 1.0))
    rays = one.rays(supersample)
    assert rays.shape == (6 * supersample, 8 * supersample, 3)
    places, depth = one.project(one.centre + 1.7 * rays)
    x, y = ((np.arange(n * supersample) + 0.5) / supersample for n in (8, 6))
    assert np.allclose(places[..., 0], x) and np.allclose(places[..., 1], y[:, None]) and np.allclose(depth, 1.7)
    part = one.rays(supersample, Box(2, 1, 5, 4))
    assert np.array_equal(part, rays[supersample : 4 * supersample, 2 * supersample : 5 * supersample])
    some = np.array([0, 9, 30, 47])  # of 6 rows of 8 pixels, row by row
    parts = rays.reshape(6, supersample, 8, supersample, 3).swapaxes(1, 2).reshape(48, -1, 3)
    assert np.array_equal(one.pixel_rays(some, supersample), parts[some])
    assert one.rays(dtype=np.float32).dtype == np.float32


def test_a_box_holds_every_pixel_that_is_covered() -> None:
    corners = np.array([[0.0, 0.0, 2.0], [0.05, 0.0, 2.0], [0.0, 0.04, 2.0]])
    assert PLAIN.box(corners) == Box(4, 3, 6, 4)  # x from 4 to 5.25, y from 3 to 3.8
    assert PLAIN.box(corners + np.array([1.0, 0.0, 0.0])).pixels == 0
    assert PLAIN.box(corners * np.array([100.0, 100.0, 1.0])) == Box(4, 3, 8, 6)
    assert PLAIN.box(corners - np.array([0.0, 0.0, 2.0])) == PLAIN.whole == Box(0, 0, 8, 6)


def test_a_scaled_k_is_refused() -> None:
    with pytest.raises(InputError, match=r"the last row of K is \[0.0, 0.0, 2.0\], expected \[0, 0, 1\]"):
        Camera("c", 8, 6, 2 * K, np.eye(3, 4))
