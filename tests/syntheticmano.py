"""Files of MANO's structure without anything of MANO in them: made from the open hand, pickled as MANO's are."""

from __future__ import annotations

import functools
import pickle
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
from scipy.spatial import cKDTree

from handbench.hand.openhand import OpenHand

NAMES = ("wrist", *(f"{finger}{k}" for finger in ("index", "middle", "little", "ring", "thumb") for k in (1, 2, 3)))
PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
AXES = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # rows: where the open hand's x, y and z are in MANO's space
TIPS = (744, 320, 443, 554, 671)
WRIST = np.array([0.0957, 0.0064, 0.0062])


def in_manos_axes(points: np.ndarray) -> np.ndarray:
    return points @ AXES + WRIST


@functools.cache
def arrays(side: str = "right") -> dict[str, np.ndarray]:
    """The arrays of a right hand; of a left one as MANO's own file has them, with the right one's x in its shapes."""
    hand, rng = OpenHand.load(), np.random.default_rng(0)
    own, faces = _surface(hand)
    at = own @ AXES.T  # back in the open hand's axes
    near = cKDTree(hand.rest_position(0)).query(at)[1]
    names = hand.joint_names
    joints = np.array([hand.points[names.index(name)] for name in NAMES])
    weights = np.zeros((778, 16))
    for j, name in enumerate(names):
        kept = name
        while kept not in NAMES:
            above = hand.parents[names.index(kept)]
            kept = names[above] if above >= 0 else "wrist"
        weights[:, NAMES.index(kept)] += hand.weights(0)[near, j]
    regressor = np.zeros((16, 778))
    for j, joint in enumerate(joints):
        chosen = cKDTree(at).query(joint, 24)[1]
        system = np.concatenate([at[chosen].T, np.ones((1, 24))])
        regressor[j, chosen] = np.linalg.lstsq(system, np.append(joint, 1.0), rcond=None)[0]
    shapes = np.zeros((778, 3, 20))
    shapes[:, :, 0] = 0.04 * (own - own.mean(axis=0))
    for k in range(1, 20):
        shapes[:, :, k] = 0.3 * (hand.template.shapes[k % len(hand.template.shapes)][near] @ AXES)
        shapes[:, :, k] += 1e-4 * np.sin(40 * own[:, [k % 3]] + k)
    bend = np.zeros((15, 3))
    bend[:, 2] = 0.3
    mean = (bend + 0.05 * rng.standard_normal((15, 3))).ravel()
    posed = 1e-4 * np.sin(rng.uniform(10, 60, (135, 3)) @ own.T).T[:, None, :] * rng.standard_normal((1, 3, 135))
    table = np.array([[2**32 - 1, *PARENTS[1:]], range(16)], np.int64)
    found = {
        "v_template": own + WRIST,
        "shapedirs": shapes,
        "posedirs": posed,
        "J_regressor": regressor,
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": table,
        "f": faces.astype(np.uint32),
        "hands_components": np.linalg.qr(rng.standard_normal((45, 45)))[0],
        "hands_mean": mean,
    }
    if side == "left":
        mirror = np.array([-1.0, 1.0, 1.0])
        signs = np.tile(np.outer(mirror, mirror).ravel(), 15)
        found["v_template"] = found["v_template"] * mirror
        found["posedirs"] = found["posedirs"] * mirror[:, None] * signs  # but not its shapes: that is the fault
        found["f"] = found["f"][:, ::-1].copy()
        found["hands_mean"] = (mean.reshape(15, 3) * [1, -1, -1]).ravel()
        found["hands_components"] = (found["hands_components"].reshape(45, 15, 3) * [1, -1, -1]).reshape(45, 45)
    return found


def _surface(hand: OpenHand) -> tuple[np.ndarray, np.ndarray]:
    """The open hand with MANO's numbers of vertices and triangles, in MANO's axes, wrist at the origin."""
    from handbench.lean import open3d

    o3d = open3d()

    faces = hand.topology(0).faces
    faces = faces[(hand.rest_position(0)[faces][..., 1] > -0.02).all(axis=1)]  # MANO is open at the wrist
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(hand.rest_position(0).copy()), o3d.utility.Vector3iVector(faces.copy())
    )
    mesh = mesh.simplify_quadric_decimation(1440)
    mesh.remove_unreferenced_vertices()
    vertices, faces = np.asarray(mesh.vertices).tolist(), np.asarray(mesh.triangles).tolist()
    while True:  # MANO's rim has 16 edges: ears are closed until it has
        edges = {(face[i], face[(i + 1) % 3]) for face in faces for i in range(3)}
        rim = dict(edge for edge in edges if edge[::-1] not in edges)
        if len(rim) <= 16:
            break
        start = min(rim)
        faces.append([rim[rim[start]], rim[start], start])
    while len(vertices) < 778:  # the largest triangle in three
        corners = np.array(vertices)[np.array(faces)]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        n = int(area.argmax())
        (a, b, c), m = faces[n], len(vertices)
        vertices.append(corners[n].mean(axis=0).tolist())
        faces[n] = [a, b, m]
        faces += [[b, c, m], [c, a, m]]
    assert len(vertices) == 778 and len(faces) == 1538
    place = np.arange(778)  # finger tips get the numbers that they have in MANO
    for tip, number in zip(hand.points[len(hand.joint_names) :], TIPS, strict=True):
        nearest = int(np.linalg.norm(np.array(vertices)[place] - tip, axis=1).argmin())
        place[[nearest, number]] = place[[number, nearest]]
    return np.array(vertices)[place] @ AXES, np.argsort(place)[np.array(faces)]


class _Fake:
    """An object of a class that is pickled under another name."""


def pickled(table: dict[str, Any], chumpy: bool = True) -> bytes:
    """A pickle, protocol 2, in which shapes are chumpy's Select of Ch and the regressor is scipy's csc matrix."""
    saved = {name: sys.modules.get(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")}
    made = dict(table)
    try:
        for module, kind in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")):
            sys.modules[module] = types.ModuleType(module)
            setattr(sys.modules[module], kind, type(kind, (_Fake,), {"__module__": module}))
        sys.modules["chumpy"] = types.ModuleType("chumpy")
        if chumpy and made["shapedirs"].shape[-1] == 20:
            whole = sys.modules["chumpy.ch"].Ch()
            whole.__dict__.update(x=made["shapedirs"], dterms=("x",))
            chosen = sys.modules["chumpy.reordering"].Select()
            first = np.arange(made["shapedirs"].size).reshape(778, 3, 20)[:, :, :10]
            chosen.__dict__.update(a=whole, idxs=first.ravel(), preferred_shape=(778, 3, 10))
            made["shapedirs"] = chosen
            made["J_regressor"] = scipy.sparse.csc_matrix(made["J_regressor"])
        return pickle.dumps(made, protocol=2)
    finally:
        for name, module in saved.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module


def write(folder: Path) -> Path:
    """MANO_RIGHT.pkl and MANO_LEFT.pkl in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for side in ("right", "left"):
        (folder / f"MANO_{side.upper()}.pkl").write_bytes(pickled(arrays(side)))
    return folder
