"""Scenarios: everything that defines an episode, frozen, validated and convertible to JSON."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from uwoc_gym.current import Current
from uwoc_gym.ending import EpisodeSettings
from uwoc_gym.link import OpticalLink
from uwoc_gym.observation import ObservationSettings
from uwoc_gym.parameters import Number, Parameters, SettingError, child, closest, number
from uwoc_gym.pulses import Pulse
from uwoc_gym.reward import RewardSettings
from uwoc_gym.sea import Sea
from uwoc_gym.sensors import Sensors
from uwoc_gym.ship import (
    SHIP_PATHS,
    CarriedOnPath,
    CirclePath,
    LawnMowerPath,
    PaperPath,
    RandomPath,
    ShipPath,
    StraightPath,
)
from uwoc_gym.start import Start
from uwoc_gym.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class Scenario(Parameters):
    """All that defines an episode.

    Any physical number may be a pair ``(low, high)``: each episode then draws it uniformly from its own seed. ``ship``
    may be one path or several, of which each episode draws one.

    Examples:
        >>> heavy = Scenario.named("Nominal").merged({"vehicle": {"mass_scale": (0.8, 1.2)}})
        >>> Scenario.from_json(heavy.to_json()) == heavy
        True
    """

    link: OpticalLink = child(OpticalLink(), (OpticalLink,), "the optical link")
    vehicle: Vehicle = child(Vehicle(), (Vehicle,), "the AUV")
    ship: ShipPath | tuple[ShipPath, ...] = child(
        PaperPath(), SHIP_PATHS, "the ship's path, or alternatives to draw from", one_or_many=True
    )
    sea: Sea = child(Sea(), (Sea,), "pulses and current")
    sensors: Sensors = child(Sensors(), (Sensors,), "measurement noise")
    start: Start = child(Start(), (Start,), "the AUV's state at time 0")
    depth_m: Number | None = number(
        None,
        "m",
        "the AUV's depth; None for the height of the cone",
        positive=True,
        optional=True,
        source="paper, sec. 4: the cone's height",
    )
    episode: EpisodeSettings = child(EpisodeSettings(), (EpisodeSettings,), "time grid and end")
    reward: RewardSettings = child(RewardSettings(), (RewardSettings,), "weights of the reward")
    observation: ObservationSettings = child(ObservationSettings(), (ObservationSettings,), "observation scales")

    def _check(self) -> None:
        for path in self.ship_paths:
            if path.end_time_s < self.episode.duration_s * (1.0 - 1e-9):
                raise SettingError(
                    f"Scenario.ship: the recorded path ends at {path.end_time_s:g} s, before the episode of "
                    f"{self.episode.duration_s:g} s; record at least that long or lower episode.duration_s."
                )

    @property
    def ship_paths(self) -> tuple[ShipPath, ...]:
        """The alternatives that an episode's path is drawn from."""
        return self.ship if isinstance(self.ship, tuple) else (self.ship,)

    @classmethod
    def named(cls, name: str) -> Scenario:
        """The named scenario.

        Raises:
            SettingError: There is no scenario of that name; the nearest one is given.
        """
        if name not in SCENARIOS:
            raise SettingError(f"There is no scenario {name!r}; {closest(name, list(SCENARIOS))}")
        return SCENARIOS[name]

    def known(self, integration_step_s: float | None = None) -> Scenario:
        """What the maker of a policy knows of the scenario: the nominal model, limits, periods, reward and scales.

        Nothing is drawn, nothing disturbs, sensors are exact, ranges are at their middle, and the ship's path is
        unknown: it is `CarriedOnPath`, at rest until `Fleet.believe` says otherwise.

        Args:
            integration_step_s: A coarser integration step, for planning [s].

        Raises:
            SettingError: The control period isn't a whole multiple of the step.
        """
        step = {} if integration_step_s is None else {"integration_step_s": integration_step_s}
        return replace(
            self.midpoint(),
            vehicle=self.vehicle.nominal(),
            ship=CarriedOnPath(),
            sea=Sea(),
            sensors=Sensors(),
            episode=self.episode.merged(step),
        )

    def to_json(self) -> str:
        """The scenario as a JSON text that `from_json` reads back to an equal scenario."""
        return json.dumps(self.to_dict(), indent=2)

    def digest(self) -> str:
        """16 hexadecimal digits that tell scenarios apart: equal for equal settings, whatever they are called."""
        text = json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @classmethod
    def from_json(cls, text: str) -> Scenario:
        """Read a scenario from JSON.

        Raises:
            SettingError: The text isn't a JSON object, a key is unknown or a value isn't allowed.
        """
        try:
            data = json.loads(text)
        except json.JSONDecodeError as error:
            raise SettingError(f"The scenario isn't valid JSON: {error}.") from None
        if not isinstance(data, Mapping):
            raise SettingError("The scenario's JSON must be an object.")
        return cls.from_dict(data)


def as_scenario(value: str | Scenario | Mapping[str, Any], base: Scenario | None = None) -> Scenario:
    """A scenario from its name, from itself, or from overrides merged into ``base``.

    Raises:
        SettingError: The name or a key is unknown, or a value isn't allowed.
    """
    if isinstance(value, Scenario):
        return value
    if isinstance(value, str):
        return Scenario.named(value)
    return (base or Scenario()).merged(value)


_PULSE = Sea(pulses=(Pulse(),))

# What `uwoc-gym calibrate case-1` and `case-2` found. White noise means little without its sampling time, which is the
# paper's; the first minute holds all that the tables can be about.
_AS_SAMPLED = EpisodeSettings(duration_s=60.0, control_period_s=0.005)
_FOUND_PULSE_I = Sea(pulses=(Pulse(force_x_n=540.2, force_y_n=100.5, moment_nm=428.1),))
_FOUND_NOISE_I = Sensors(position_std_m=0.5488, yaw_std_rad=0.9865, velocity_std_mps=0.3543, yaw_rate_std_rad_s=0.3023)
_FOUND_PULSE_II = Sea(pulses=(Pulse(force_x_n=573.0, force_y_n=279.6, moment_nm=389.3),))
_FOUND_NOISE_II = Sensors(position_std_m=0.5122, yaw_std_rad=0.9889, velocity_std_mps=0.8117, yaw_rate_std_rad_s=0.4409)

SCENARIOS: dict[str, Scenario] = {
    "Nominal": Scenario(),
    "CurrentPulse": Scenario(sea=_PULSE),
    "MassError": Scenario(sea=_PULSE, vehicle=Vehicle(mass_scale=1.2)),
    "StrongPulse": Scenario(sea=Sea(pulses=(Pulse(force_x_n=1500.0, force_y_n=1500.0, moment_nm=1500.0),))),
    "PaperCaseI": Scenario(sea=_FOUND_PULSE_I, sensors=_FOUND_NOISE_I, episode=_AS_SAMPLED),
    "PaperCaseII": Scenario(
        vehicle=Vehicle(mass_scale=1.2), sea=_FOUND_PULSE_II, sensors=_FOUND_NOISE_II, episode=_AS_SAMPLED
    ),
    "Random": Scenario(
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
}
"""The named scenarios: the paper's nominal run, Case I and Case II as printed; Case I with a stronger pulse; both cases
with the pulse and the noise that `uwoc-gym calibrate` found to explain their tables, for actions every 0.005 s; and one
that draws everything."""
