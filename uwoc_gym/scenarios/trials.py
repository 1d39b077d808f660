"""Worlds in which the choice of policy matters, each Random with one difficulty."""

from __future__ import annotations

import math
from dataclasses import replace

from uwoc_gym.scenario import SCENARIOS, name_scenario
from uwoc_gym.world.ship.paths import CirclePath, LawnMowerPath, PaperPath, RandomPath, StraightPath

_RANDOM = SCENARIOS["Random"]

name_scenario(
    "Underactuated",
    "Random without a sway force: the action is surge and yaw, as torpedo hulls have them",
    replace(_RANDOM, vehicle=replace(_RANDOM.vehicle, max_sway_force_n=0.0), action="surge-yaw"),
)

name_scenario(
    "Tide",
    "Random with the forces of real vehicles in a current of 0.3 to 0.6 m/s, where the Munk moment of a hull askew "
    "exceeds the yaw moment",
    replace(
        _RANDOM,
        vehicle=replace(_RANDOM.vehicle, max_surge_force_n=250.0, max_sway_force_n=250.0, max_yaw_moment_nm=60.0),
        sea=replace(
            _RANDOM.sea,
            pulses=tuple(
                replace(pulse, force_x_n=(-100.0, 100.0), force_y_n=(-100.0, 100.0), moment_nm=(-35.0, 35.0))
                for pulse in _RANDOM.sea.pulses
            ),
            current=replace(_RANDOM.sea.current, speed_mps=(0.3, 0.6)),
        ),
    ),
)

name_scenario(
    "LateFix",
    "Random with the ship known by a fix every 2 s, 0.5 s late and noisy, and ships twice as quick that turn tightly",
    replace(
        _RANDOM,
        ship=(
            RandomPath(speed_mps=(0.8, 2.0), wander=(0.5, 0.9), shortest_period_s=5.0, longest_period_s=15.0),
            PaperPath(radius_m=(6.0, 12.0), rate_rad_s=(-0.2, 0.2), swing_rad=(-math.pi / 2, math.pi / 2)),
            CirclePath(radius_m=(3.0, 7.5), speed_mps=(0.6, 2.0), turn="starboard"),
            CirclePath(radius_m=(3.0, 7.5), speed_mps=(0.6, 2.0), turn="port"),
            StraightPath(course_rad=(-math.pi, math.pi), speed_mps=(0.0, 2.0)),
            LawnMowerPath(
                course_rad=(-math.pi, math.pi),
                leg_length_m=(8.0, 20.0),
                spacing_m=(3.0, 5.0),
                speed_mps=(0.6, 1.6),
            ),
        ),
        observation=replace(_RANDOM.observation, groups=("fix", "velocity", "heading", "last-action", "link")),
    ),
)
