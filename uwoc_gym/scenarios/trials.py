"""Worlds in which the choice of policy matters, each Random with one difficulty; all else is as in Random.

In all three an episode lasts 60 s, with actions at 20 Hz, and the reward is that of `uwoc_gym.TrackingEnv`.

## Underactuated

No force to the side, as torpedo hulls have it: who is to go there has to turn first, and not too fast. The action is
``surge-yaw``; the observation is that of Random, 20 entries, of which the last action in sway stays 0.

| Num | Action      | Min | Max | Unit at ±1 |
|-----|-------------|-----|-----|------------|
| 0   | surge force | -1  | 1   | 2000 N     |
| 1   | yaw moment  | -1  | 1   | 500 N m    |

## Tide

Actuators of the size that real vehicles have, in a current of 0.3 to 0.6 m/s; the pulses are a tenth as strong as in
Random. The Munk moment (m22 - m11) u v of a hull that is pushed askew exceeds the yaw moment, so that who pushes it
sideways after the ship is turned across the stream and left behind. The observation is that of Random, 20 entries.

| Num | Action      | Min | Max | Unit at ±1 |
|-----|-------------|-----|-----|------------|
| 0   | surge force | -1  | 1   | 250 N      |
| 1   | sway force  | -1  | 1   | 250 N      |
| 2   | yaw moment  | -1  | 1   | 60 N m     |

## LateFix

The ship is known by fixes alone: one every 2 s, 0.5 s late, with errors of 0.3 m along each axis and 0.05 rad; its
velocity and acceleration aren't told. Ships are twice as quick as in Random and turn tightly. The observation has the
groups ``fix``, ``velocity``, ``heading``, ``last-action`` and ``link``, 16 entries.

| Num | Action      | Min | Max | Unit at ±1 |
|-----|-------------|-----|-----|------------|
| 0   | surge force | -1  | 1   | 2000 N     |
| 1   | sway force  | -1  | 1   | 2000 N     |
| 2   | yaw moment  | -1  | 1   | 500 N m    |
"""

from __future__ import annotations

from uwoc_gym.scenario import Scenario, name_scenario

_RANDOM = Scenario.named("Random")

name_scenario(
    "Underactuated",
    "Random without a sway force: the action is surge and yaw, as torpedo hulls have them",
    _RANDOM.merged({"vehicle.max_sway_force_n": 0.0, "action": "surge-yaw"}),
)

name_scenario(
    "Tide",
    "Random with the forces of real vehicles in a current of 0.3 to 0.6 m/s, where the Munk moment of a hull askew "
    "exceeds the yaw moment",
    _RANDOM.merged(
        {
            "vehicle": {"max_surge_force_n": 250.0, "max_sway_force_n": 250.0, "max_yaw_moment_nm": 60.0},
            "sea.pulses[*].force_x_n *=": 0.1,
            "sea.pulses[*].force_y_n *=": 0.1,
            "sea.pulses[*].moment_nm *=": 0.1,
            "sea.current.speed_mps": (0.3, 0.6),
        }
    ),
)

name_scenario(
    "LateFix",
    "Random with the ship known by a fix every 2 s, 0.5 s late and noisy, and ships twice as quick that turn tightly",
    _RANDOM.merged(
        {
            "ship[*].speed_mps *=": 2.0,
            "ship[*].rate_rad_s *=": 2.0,
            # A random path, whose turns get quicker.
            "ship[0]": {"wander": (0.5, 0.9), "shortest_period_s": 5.0, "longest_period_s": 15.0},
            # Both ways round a circle.
            "ship[2].radius_m *=": 0.5,
            "ship[3].radius_m *=": 0.5,
            "ship[5].spacing_m *=": 0.5,
            "observation.groups": ("fix", "velocity", "heading", "last-action", "link"),
        }
    ),
)
