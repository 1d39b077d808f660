"""Worlds in which the choice of policy matters, each Random with one difficulty."""

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
