"""MANO: the hand model that much of the field uses, read from the file that its authors license.

Nothing of MANO comes with handbench. Whoever holds MANO_RIGHT.pkl or MANO_LEFT.pkl names the file, or its folder, in
HANDBENCH_MANO. `unpickle.py` reads the pickle and nothing that a pickle could do beside; `files.py` checks it and keeps
it as .npz; `model.py` is the hand.
"""

from __future__ import annotations

from .files import ENVIRONMENT, ManoFile, find_mano, read_mano
from .model import TIPS, ManoHand, create

__all__ = ["ENVIRONMENT", "TIPS", "ManoFile", "ManoHand", "create", "find_mano", "read_mano"]
