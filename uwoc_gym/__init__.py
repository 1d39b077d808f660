"""Gymnasium environments of an AUV that keeps an optical link to a moving ship.

Importing this package registers the environment IDs; ``gym.make("uwoc_gym:uwoc/Nominal-v0")`` does so by itself.
"""

from uwoc_gym.current import Current
from uwoc_gym.ending import EpisodeSettings
from uwoc_gym.env import TrackingEnv
from uwoc_gym.link import Cone, OpticalLink
from uwoc_gym.observation import ObservationSettings, unpack
from uwoc_gym.parameters import Range, SettingError
from uwoc_gym.pulses import Pulse
from uwoc_gym.registry import ENV_IDS, register_envs
from uwoc_gym.reward import RewardSettings
from uwoc_gym.scenario import SCENARIOS, Scenario
from uwoc_gym.sea import Sea
from uwoc_gym.sensors import Sensors
from uwoc_gym.ship import (
    CarriedOnPath,
    CirclePath,
    LawnMowerPath,
    PaperPath,
    RandomPath,
    RecordedPath,
    ShipPath,
    StraightPath,
)
from uwoc_gym.sim.fleet import Fleet
from uwoc_gym.start import Start
from uwoc_gym.vector_env import TrackingVectorEnv
from uwoc_gym.vehicle import Vehicle

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
    "register_envs",
    "unpack",
]

register_envs()
