"""A world that draws everything."""

from __future__ import annotations

import math

from uwoc_gym.scenario import Scenario, name_scenario
from uwoc_gym.task.ending import EpisodeSettings
from uwoc_gym.world.auv.horizontal import Vehicle
from uwoc_gym.world.auv.sensors import Sensors
from uwoc_gym.world.auv.start import Start
from uwoc_gym.world.sea import Sea
from uwoc_gym.world.sea.current import Current
from uwoc_gym.world.sea.pulses import Pulse
from uwoc_gym.world.ship.paths import CirclePath, LawnMowerPath, PaperPath, RandomPath, StraightPath

name_scenario(
    "Random",
    "everything drawn from the seed: ship's path, start, masses, pulses, current, noise; 60 s",
    Scenario(
        vehicle=Vehicle(mass_scale=(0.8, 1.2), damping_scale=(0.8, 1.2)),
        ship=(
            RandomPath(speed_mps=(0.4, 1.0), wander=(0.2, 0.7)),
            PaperPath(radius_m=(6.0, 12.0), rate_rad_s=(-0.1, 0.1), swing_rad=(-math.pi / 2, math.pi / 2)),
            CirclePath(radius_m=(6.0, 15.0), speed_mps=(0.3, 1.0), turn="starboard"),
            CirclePath(radius_m=(6.0, 15.0), speed_mps=(0.3, 1.0), turn="port"),
            StraightPath(course_rad=(-math.pi, math.pi), speed_mps=(0.0, 1.0)),
            LawnMowerPath(
                course_rad=(-math.pi, math.pi),
                leg_length_m=(8.0, 20.0),
                spacing_m=(6.0, 10.0),
                speed_mps=(0.3, 0.8),
            ),
        ),
        sea=Sea(
            pulses=(
                Pulse(
                    start_s=(5.0, 30.0),
                    duration_s=(0.5, 2.0),
                    force_x_n=(-1000.0, 1000.0),
                    force_y_n=(-1000.0, 1000.0),
                    moment_nm=(-350.0, 350.0),
                ),
                Pulse(
                    start_s=(30.0, 55.0),
                    duration_s=(0.5, 2.0),
                    force_x_n=(-1000.0, 1000.0),
                    force_y_n=(-1000.0, 1000.0),
                    moment_nm=(-350.0, 350.0),
                    frame="earth",
                ),
            ),
            current=Current(
                speed_mps=(0.0, 0.3),
                direction_rad=(-math.pi, math.pi),
                std_mps=(0.0, 0.1),
                correlation_time_s=(20.0, 60.0),
            ),
        ),
        sensors=Sensors(
            position_std_m=(0.0, 0.05),
            yaw_std_rad=(0.0, 0.02),
            velocity_std_mps=(0.0, 0.02),
            yaw_rate_std_rad_s=(0.0, 0.01),
        ),
        start=Start(
            x_m=(-6.0, 6.0),
            y_m=(-6.0, 6.0),
            yaw_rad=(-math.pi, math.pi),
            surge_mps=(-0.5, 0.5),
            sway_mps=(-0.5, 0.5),
            yaw_rate_rad_s=(-0.2, 0.2),
            relative_to_ship=True,
        ),
        episode=EpisodeSettings(duration_s=60.0),
    ),
)
