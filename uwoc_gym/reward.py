"""The reward: a weighted sum of named terms, each of which appears in `info`.

With the default weights a step at the ship's position and heading, with the actuators at rest, gives 1, so that an
episode's return over its number of steps is the share of what is possible.
"""

from __future__ import annotations

from dataclasses import dataclass

from uwoc_gym.compiled import inlined
from uwoc_gym.elementary import fma
from uwoc_gym.parameters import Parameters, number

TERMS = ("bit_rate", "in_cone", "position", "heading", "effort")
"""Names of the reward terms; `info` has each as ``reward_<name>``."""


@dataclass(frozen=True, kw_only=True)
class RewardSettings(Parameters):
    """Weights of the reward terms and the scales of the shaping ones.

    =========  ==================================================  ==========
    Term       Value before weighting                              Range
    =========  ==================================================  ==========
    bit_rate   log bit rate between the threshold (0) and the      0 to 1
               on-axis rate at the AUV's depth (1)
    in_cone    1 inside the cone                                   0 or 1
    position   1 / (1 + horizontal distance / position_scale_m)    0 to 1
    heading    1 / (1 + \\|yaw error\\| / heading_scale_rad)         0 to 1
    effort     −(mean square of the clipped action)                −1 to 0
    =========  ==================================================  ==========
    """

    bit_rate: float = number(0.4, "1", "weight of the bit rate", low=0.0, randomisable=False)
    in_cone: float = number(0.3, "1", "weight of being inside the cone", low=0.0, randomisable=False)
    position: float = number(0.2, "1", "weight of being near the cone's axis", low=0.0, randomisable=False)
    heading: float = number(0.1, "1", "weight of sharing the ship's heading", low=0.0, randomisable=False)
    effort: float = number(0.05, "1", "weight of the actuators' effort", low=0.0, randomisable=False)
    position_scale_m: float = number(1.0, "m", "distance at which `position` halves", positive=True, randomisable=False)
    heading_scale_rad: float = number(
        0.5, "rad", "yaw error at which `heading` halves", positive=True, randomisable=False
    )

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest reward of a step."""
        return -self.effort, self.bit_rate + self.in_cone + self.position + self.heading


@inlined
def reward_terms(
    level, in_cone, distance, yaw_error, surge, sway, yaw,
    w_rate, w_cone, w_position, w_heading, w_effort, position_scale, heading_scale,
):  # fmt: skip
    """The weighted terms, in the order of `TERMS`, from the link's state, the errors and the clipped action."""
    return (
        w_rate * level,
        w_cone * in_cone,
        w_position * position_scale / (position_scale + distance),
        w_heading * heading_scale / (heading_scale + abs(yaw_error)),
        -(w_effort / 3.0) * fma(surge, surge, fma(sway, sway, yaw * yaw)),
    )
