"""The ablations of URHand's paper (supp. Sec. 5.2): overrides of one configuration. Another one takes one entry.

Light data: nothing heavy is imported here. `UrhandConfig` in `urhand/config.py` says what each field means.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Ablation:
    """How a variant is called in tables, what it does differently, and the fields of the configuration it sets."""

    title: str
    summary: str
    overrides: Mapping[str, Any]


ABLATIONS: dict[str, Ablation] = {
    "physical-only": Ablation("Physical branch only", "no neural branch", {"neural": False, "adversarial": 0.0}),
    "non-linear": Ablation(
        "Non-linear", "leaky ReLU after every layer of the lighting network", {"network": "non-linear"}
    ),
    "linear-consistency": Ablation(
        "Linear consistency",
        "the non-linear network, asked to be linear by a loss",
        {"network": "non-linear", "consistency": 1.0},
    ),
    "mlp-linear": Ablation(
        "MLP-based linear",
        "one linear layer from a 16 x 32 environment map, no shading features",
        {"encoder": "environment"},
    ),
    "phong": Ablation("Phong", "Phong's diffuse and specular features", {"shading": "phong"}),
    "no-specular": Ablation("w/o specular", "no specular feature", {"specular": False}),
    "no-visibility": Ablation("w/o visibility", "no shadows in the features", {"shadows": "none"}),
    "no-refiner": Ablation("w/o refiner", "the coarse mesh's normals", {"refiner": False}),
    "no-gan": Ablation("w/o L_GAN", "no adversarial loss", {"adversarial": 0.0}),
    "unaware-gan": Ablation("w/o light-aware L_GAN", "a discriminator that sees no light", {"light_aware": False}),
    "no-sparsity": Ablation("w/o L1 reg", "no L1 regularisation of the encoder's features", {"sparsity": 0.0}),
}
