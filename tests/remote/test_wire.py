"""Messages: what goes in comes out, shared things once, and nothing but messages is believed."""

from __future__ import annotations

import gc
import socket

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from handbench.remote.wire import Channel, Closed, Codec, Garbled
from handbench.scene import Camera, Directional, Environment, Group, Mesh, Observation, Point, Pose, Query, Topology

ARRAYS = hnp.arrays(
    st.sampled_from([np.float16, np.float32, np.float64, np.int32, np.uint8, np.bool_]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
PLAIN = st.none() | st.booleans() | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False) | st.text()
VALUES = st.recursive(
    PLAIN | ARRAYS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)
)


@pytest.fixture
def ends():
    one, other = socket.socketpair()
    channels = Channel(one), Channel(other)
    yield channels
    for channel in channels:
        channel.close()


def same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray) and not other.flags.writeable
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return list(one) == list(other) and all(map(same, one.values(), other.values()))
    return type(one) is type(other) and one == other


@settings(max_examples=150, deadline=None)
@given(VALUES)
def test_values_come_as_they_went(value):
    one, other = socket.socketpair()
    channels = Channel(one), Channel(other)
    channels[0].send(value)
    assert same(value, channels[1].receive())
    for channel in channels:
        channel.close()


def scene() -> Query:
    topology = Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    lights = (Directional([0, 0, 1], [1, 2, 3]), Point([1, 2, 3], [0.1, 0.2, 0.3]))
    light = Group((*lights, Environment("hall", np.full((2, 4, 3), 1 / 3))))
    camera = Camera("front", 8, 6, [[8, 0, 4], [0, 8, 3], [0, 0, 1]], np.eye(3, 4))
    return Query("s01", "pose-0", "group-0", Pose(np.ones((2, 3)) / 7), Mesh(np.eye(3), topology), camera, light)


def test_a_scene_comes_exactly_and_read_only(ends):
    asked = scene()
    ends[0].send(asked)
    got = ends[1].receive()
    assert got.key == asked.key and got.pose.joints.tobytes() == asked.pose.joints.tobytes()
    assert [type(light) for light in got.light.lights] == [Directional, Point, Environment]
    assert got.light.lights[2].radiance.tobytes() == asked.light.lights[2].radiance.tobytes()
    assert not got.mesh.vertices.flags.writeable and got.camera.K.dtype == np.float64


def test_what_is_shared_goes_once_and_keeps_its_identity(ends):
    asked = scene()
    first, again = (Query(*fields) for fields in [tuple(vars(asked).values())] * 2)
    ends[0].send([first, again])
    one, two = ends[1].receive()
    ends[0].send(first)
    three = ends[1].receive()
    assert one.mesh is two.mesh is three.mesh and one.light is three.light and one.mesh.topology is three.mesh.topology
    assert len(Codec().encode([first, again])[1]) == len(Codec().encode(first)[1])


def test_what_is_gone_here_is_forgotten_there(ends):
    sender, receiver = (channel._codec for channel in ends)
    asked = scene()
    ends[0].send(asked)
    ends[1].receive()
    assert len(receiver._known) == len(sender._sent) == 8
    del asked
    gc.collect()
    assert not sender._sent
    ends[0].send(None)
    ends[1].receive()
    assert not receiver._known
    another = scene()  # may get the identities of the old ones
    ends[0].send(another)
    assert ends[1].receive().mesh.vertices.tobytes() == another.mesh.vertices.tobytes()


def test_observations_with_and_without_maps(ends):
    seen = Observation(np.full((4, 5, 3), 0.1), np.ones((4, 5)), depth=np.full((4, 5), 0.5))
    ends[0].send({"done": seen})
    got = ends[1].receive()["done"]
    assert got.normal is None and got.depth.tobytes() == seen.depth.tobytes()


@pytest.mark.parametrize("value", [object(), 1j, np.array(["a"]), np.array([object()]), {1, 2}])
def test_what_has_no_form_is_refused_before_anything_is_sent(ends, value):
    with pytest.raises(TypeError, match="cannot be sent"):
        ends[0].send([1, value])
    ends[0].send("after")
    assert ends[1].receive() == "after"


def test_the_end_of_the_other_side_is_seen(ends):
    ends[0].close()
    with pytest.raises(Closed):
        ends[1].receive()
    with pytest.raises(Closed):
        ends[1].send(np.zeros(10**6))


@pytest.mark.parametrize(
    "raw",
    [
        b"\xff" * 8,
        (2).to_bytes(8, "little") + b"[]",
        (4).to_bytes(8, "little") + b"\xff\xfe\0\0",
        (43).to_bytes(8, "little") + b'{"gone":[],"content":{"same":9},"arrays":[]}'[:43],
    ],
)
def test_garbage_is_no_message(raw):
    one, other = socket.socketpair()
    one.sendall(raw)
    with pytest.raises(Garbled):
        Channel(other).receive()
    one.close(), other.close()
