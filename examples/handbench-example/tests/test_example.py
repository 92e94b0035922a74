"""The laws of the method and the values of the metric. Needs the package: `pip install -e .`"""

import numpy as np
from handbench_example.ball import BallCapture
from handbench_example.lambert import create
from handbench_example.mae import MAE
from handbench_example.protocol import PROTOCOL

from handbench.bench.check import check_method
from handbench.metrics import Pair


def test_the_method_obeys_the_laws() -> None:
    verdicts = {verdict.law: verdict for verdict in check_method(create(), PROTOCOL, BallCapture())}
    assert len(verdicts) == 6 and all(verdict.holds for verdict in verdicts.values()), verdicts


def test_the_mesh_is_where_the_picture_is() -> None:
    capture = BallCapture()
    frame = capture.frames()[0]
    seen = capture.observe(frame)
    rows, columns = np.nonzero(seen.alpha)
    pixels = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) @ np.linalg.inv(frame.camera.K).T
    in_camera = pixels * seen.depth[rows, columns, None]
    world = (in_camera - frame.camera.world_to_camera[:, 3]) @ frame.camera.world_to_camera[:, :3]
    nearest = np.linalg.norm(world[:, None] - frame.mesh.vertices, axis=-1).min(axis=1)
    assert nearest.max() < 0.006 and seen.alpha.mean() > 0.3


def test_the_metric_is_a_mean() -> None:
    truth, mask = np.zeros((4, 4, 3)), np.ones((4, 4))
    metric = MAE.with_options({"space": "linear"})
    assert metric([Pair(truth + 0.25, truth, mask)])[0].value == 0.25
    assert metric.signature.startswith("example-mae|region:mask|space:linear")
