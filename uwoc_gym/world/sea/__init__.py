"""All that moves in the water: pulses and the current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwoc_gym.parameters import Parameters, child
from uwoc_gym.world.sea.current import Current
from uwoc_gym.world.sea.pulses import Pulse


@dataclass(frozen=True, kw_only=True)
class Sea(Parameters):
    """All that pushes the AUV besides its own actuators."""

    pulses: tuple[Pulse, ...] = child((), (Pulse,), "force pulses, any number", many=True)
    current: Current = child(Current(), (Current,), "the current")

    @property
    def strongest_push(self) -> npt.NDArray[np.float64]:
        """The most that pulses which can overlap add up to, along surge, sway and about yaw, shape (3,) [N, N, N m]."""
        windows = [(np.min(each.start_s), np.max(each.start_s) + np.max(each.duration_s)) for each in self.pulses]
        most = np.zeros(3)
        for moment, _ in windows:
            acting = [each for each, (begin, end) in zip(self.pulses, windows, strict=True) if begin <= moment <= end]
            most = np.maximum(most, np.sum([each.strongest for each in acting], axis=0))
        return most
