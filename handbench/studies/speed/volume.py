"""Rays through an implicit hand: what each skip saves and changes, and how the cost grows with rays and samples."""

from __future__ import annotations

import time
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from ...method import Progress, silent
from ...methods.palm.config import PalmConfig
from ...methods.palm.drawing import pixel_rays
from ...methods.palm.model import PalmModel
from ...methods.palm.posed import PosedHand, render
from ...scene import Camera
from ...skips import NONE, Skips, skipping
from .record import Skipped
from .truth import relative_rmse

SWITCHES = ("outside_box", "empty_space", "saturated", "weightless")
"""The skips of `render.volume` and of PALM-Net's march."""

TOGETHER, PLAIN = "without these four", "plain: nor any other, roots from all bones, steps of 1 mm"
GOALS = {TOGETHER: 5.0, PLAIN: 10.0}
"""How many times the time of all skips these should take at least."""

_AT_ONCE = 4096  # rays
_TEXTURE = 0.3  # deviation of the tables of the colours that are drawn: as rough as learned ones
_FAR = 1.0  # metres from the camera to the hand


@dataclass(frozen=True, eq=False)
class PersonView:
    """A hand at rest, and the rays (R, 3) of a picture of it; what is made once a pose is there already."""

    posed: PosedHand
    origins: Tensor
    towards: Tensor

    @staticmethod
    @torch.no_grad()
    def of(model: PalmModel, height: int) -> PersonView:
        """A picture of `height` rows, three quarters as wide."""
        width = 3 * height // 4
        rest = torch.zeros(3)
        shape = torch.tensor(np.asarray(model.hand.neutral())).float()
        posed = PosedHand(model, model.codes(0), shape, torch.zeros(len(model.hand.parents), 3), rest, rest)
        _ = posed.shell, posed.deformation.nearest
        middle = posed.box.double().numpy().mean(axis=0)
        focal = 3.2 * height
        K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        turn = np.diag([1.0, -1.0, -1.0])
        place = np.array([0.0, 0.0, _FAR]) - turn @ middle
        camera = Camera("front", width, height, K, np.c_[turn, place])
        towards = pixel_rays(camera, camera.whole)[1]
        return PersonView(posed, torch.from_numpy(camera.centre.copy()).float().expand(len(towards), 3), towards)

    @torch.no_grad()
    def drawn(self, every: int = 1, config: PalmConfig | None = None) -> tuple[float, Tensor]:
        """Seconds of CPU that each `every`-th ray takes, and their colours."""
        posed = self.posed
        if config is not None:
            posed, model = posed.moved(), copy(posed.model)
            posed.model, model.config = model, config
        begin = time.process_time()
        pieces = [
            render(posed, self.origins[part], self.towards[part]).radiance(posed)
            for part in torch.arange(0, len(self.towards), every).split(_AT_ONCE)
        ]
        return time.process_time() - begin, torch.cat(pieces)


def textured(model: PalmModel) -> PalmModel:
    """The model with colours that differ from place to place: an untrained radiance field is grey."""
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(2)
        for table in model.radiance_field.encoding.parameters():
            nn.init.normal_(table, std=_TEXTURE)
    return model.requires_grad_(False)


def skipped(view: PersonView, progress: Progress = silent) -> tuple[Skipped, ...]:
    """All skips, each one off, all four off, and the same equations in their plainest form.

    Slow ones are timed on some of the rays, beside all skips on the same. Errors are relative RMSE from the picture
    with all skips.
    """
    config = view.posed.model.config
    every = Skips()
    view.drawn(4)
    took, picture = _least(view, 1)
    found = [Skipped("all skips", 0.0, took)]
    one_off = [(f"without {name}", replace(every, **{name: False}), 4, config) for name in SWITCHES]
    all_off = replace(every, **dict.fromkeys(SWITCHES, False))
    plain = replace(config, bones=0, step=1e-3)
    cases = [*one_off, (TOGETHER, all_off, 4, config), (PLAIN, NONE, 16, plain)]
    for done, (label, chosen, thin, changed) in enumerate(cases, start=1):
        fast, _ = _least(view, thin)
        with skipping(chosen):
            slow, other = view.drawn(thin, changed)
        error = relative_rmse(other.double().numpy(), picture[::thin].double().numpy())
        found.append(Skipped(label, error, took * slow / fast, GOALS.get(label)))
        progress(done, len(cases))
    return tuple(found)


def _least(view: PersonView, every: int) -> tuple[float, Tensor]:
    """The quickest of three pictures with all skips, of each `every`-th ray."""
    with skipping(Skips()):
        return min((view.drawn(every) for _ in range(3)), key=lambda found: found[0])
