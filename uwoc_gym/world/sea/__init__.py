"""All that moves in the water: pulses and the current."""

from __future__ import annotations

from dataclasses import dataclass

from uwoc_gym.parameters import Parameters, child
from uwoc_gym.world.sea.current import Current
from uwoc_gym.world.sea.pulses import Pulse


@dataclass(frozen=True, kw_only=True)
class Sea(Parameters):
    """All that pushes the AUV besides its own actuators."""

    pulses: tuple[Pulse, ...] = child((), (Pulse,), "force pulses, any number", many=True)
    current: Current = child(Current(), (Current,), "the current")
