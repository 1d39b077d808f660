"""Gymnasium environments of an AUV that keeps an optical link to a moving ship.

Importing this package registers the environment IDs; ``gym.make("uwoc_gym:uwoc/Nominal-v0")`` does so by itself.
"""

from uwoc_gym.env import TrackingEnv
from uwoc_gym.parameters import Range, SettingError
from uwoc_gym.registry import ENV_IDS, register_envs
from uwoc_gym.scenario import SCENARIOS, Scenario, name_scenario
from uwoc_gym.sim.fleet import Fleet
from uwoc_gym.task.ending import EpisodeSettings
from uwoc_gym.task.observation import ObservationSettings, unpack
from uwoc_gym.task.reward import RewardSettings
from uwoc_gym.vector_env import TrackingVectorEnv
from uwoc_gym.world.auv.horizontal import Vehicle
from uwoc_gym.world.auv.sensors import Sensors
from uwoc_gym.world.auv.start import Start
from uwoc_gym.world.optics.link import Cone, OpticalLink
from uwoc_gym.world.sea import Sea
from uwoc_gym.world.sea.current import Current
from uwoc_gym.world.sea.pulses import Pulse
from uwoc_gym.world.ship.paths import (
    CarriedOnPath,
    CirclePath,
    LawnMowerPath,
    PaperPath,
    RandomPath,
    RecordedPath,
    ShipPath,
    StraightPath,
)

__version__ = "0.1.0"

__all__ = [
    "ENV_IDS",
    "SCENARIOS",
    "CarriedOnPath",
    "CirclePath",
    "Cone",
    "Current",
    "EpisodeSettings",
    "Fleet",
    "LawnMowerPath",
    "ObservationSettings",
    "OpticalLink",
    "PaperPath",
    "Pulse",
    "RandomPath",
    "Range",
    "RecordedPath",
    "RewardSettings",
    "Scenario",
    "Sea",
    "Sensors",
    "SettingError",
    "ShipPath",
    "Start",
    "StraightPath",
    "TrackingEnv",
    "TrackingVectorEnv",
    "Vehicle",
    "name_scenario",
    "register_envs",
    "unpack",
]

register_envs()
