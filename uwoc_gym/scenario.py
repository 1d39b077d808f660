"""Scenarios: everything that defines an episode, frozen, validated and convertible to JSON."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uwoc_gym.given import from_json, shown
from uwoc_gym.parameters import Number, Parameters, SettingError, child, choice, closest, number
from uwoc_gym.task.action import AXES, KINDS
from uwoc_gym.task.ending import EpisodeSettings
from uwoc_gym.task.observation import ObservationSettings
from uwoc_gym.task.reward import RewardSettings
from uwoc_gym.world.auv.fixes import Fixes
from uwoc_gym.world.auv.horizontal import FASTEST, Vehicle
from uwoc_gym.world.auv.limits import Motion
from uwoc_gym.world.auv.sensors import Sensors
from uwoc_gym.world.auv.start import Start
from uwoc_gym.world.optics.link import LOWEST_CONE_M, OpticalLink
from uwoc_gym.world.sea import Sea
from uwoc_gym.world.ship.paths import (
    SHIP_PATHS,
    CarriedOnPath,
    PaperPath,
    ShipPath,
)


@dataclass(frozen=True, kw_only=True)
class Scenario(Parameters):
    """All that defines an episode.

    Any physical number may be a pair ``(low, high)``: each episode then draws it uniformly from its own seed. A choice
    may be a list of names, and ``ship`` several paths, of which each episode draws one.

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
    fixes: Fixes = child(Fixes(), (Fixes,), "late acoustic fixes of the ship, where they are observed", since="0.2.0")
    start: Start = child(Start(), (Start,), "the AUV's state at time 0")
    depth_m: Number | None = number(
        None,
        "m",
        "the AUV's depth; None for the height of the cone",
        low=0.01,
        high=10000.0,
        optional=True,
        source="paper, sec. 4: the cone's height",
    )
    episode: EpisodeSettings = child(EpisodeSettings(), (EpisodeSettings,), "time grid and end")
    reward: RewardSettings = child(RewardSettings(), (RewardSettings,), "weights of the reward")
    observation: ObservationSettings = child(
        ObservationSettings(), (ObservationSettings,), "what is observed, and its scales"
    )
    action: str = choice("wrench", tuple(KINDS), "kind of action", randomisable=False, since="0.2.0")

    def _check(self) -> None:
        for path in self.ship_paths:
            if path.end_time_s < self.episode.duration_s * (1.0 - 1e-9):
                raise SettingError(
                    f"Scenario.ship: the recorded path ends at {path.end_time_s:g} s, before the episode of "
                    f"{self.episode.duration_s:g} s; record at least that long or lower episode.duration_s."
                )
        self._check_fixes()
        motion = self.motion
        if not (motion.velocity <= FASTEST).all():
            speeds = ", ".join(f"{each:.3g}" for each in motion.velocity)
            raise SettingError(
                "Scenario.vehicle is not allowed: with these masses, dampings, forces, ranges and this duration it "
                f"gets as fast as {speeds} in surge [m/s], sway [m/s] and yaw [rad/s]; each must be at most "
                f"{FASTEST:g}."
            )
        longest = motion.longest_step(motion.rate)
        if self.episode.integration_step_s > longest * (1.0 + 1e-9):
            raise SettingError(
                f"EpisodeSettings.integration_step_s = {self.episode.integration_step_s!r} is not allowed: with these "
                f"masses, dampings, forces and ranges the motion changes at up to {motion.rate:.3g} 1/s, which the "
                f"integrator doesn't follow; it must be at most {self.episode.step_within(longest)!r} [s]."
            )
        self._check_reach()

    def _check_fixes(self) -> None:
        """Refuse more than one ping in a control period, of which only one could be observed."""
        if self.observation.fixes and np.min(self.fixes.period_s) < self.episode.control_period_s:
            raise SettingError(
                f"Fixes.period_s = {self.fixes.period_s!r} is not allowed: fixes come between actions; it must be at "
                f"least EpisodeSettings.control_period_s = {self.episode.control_period_s!r} [s]."
            )

    def _check_reach(self) -> None:
        """Refuse what nobody can solve: light that doesn't reach the AUV, a start at which the link counts as lost."""
        slant = self.link.smallest_cone().slant_height_m
        if slant < LOWEST_CONE_M:
            raise SettingError(
                f"OpticalLink.threshold_bit_rate_bps = {self.link.threshold_bit_rate_bps!r} is not allowed: with this "
                f"link no light reaches it beyond {slant:.2g} m; the cone's slant height must be at least "
                f"{LOWEST_CONE_M} m, which a lower bit rate gives [bit/s]."
            )
        if self.depth_m is not None and np.max(self.depth_m) > slant:
            raise SettingError(
                f"Scenario.depth_m = {self.depth_m!r} is not allowed: it reaches below the cone, where the link never "
                f"holds; with this link it must be at most {slant:.4g} [m]."
            )
        farthest = max(self._start_distance(path) for path in self.ship_paths)
        if farthest >= self.episode.lost_distance_m:
            raise SettingError(
                f"Start.x_m = {self.start.x_m!r}, y_m = {self.start.y_m!r} is not allowed: an episode can begin "
                f"{farthest:.4g} m from the ship, where the link is lost at once; it must be nearer than "
                f"EpisodeSettings.lost_distance_m = {self.episode.lost_distance_m!r} [m]."
            )

    def _start_distance(self, path: ShipPath) -> float:
        """The farthest from the ship that an episode on that path can begin [m]; 0 if that isn't known."""
        ships = np.zeros((1, 2)) if self.start.relative_to_ship else path.starts()
        own = [(x, y) for x in np.ravel(self.start.x_m) for y in np.ravel(self.start.y_m)]
        return float(max((np.hypot(*(ships - place).T).max() for place in own if len(ships)), default=0.0))

    @property
    def motion(self) -> Motion:
        """How fast the AUV moves through the water, and how fast that changes, over all that episodes draw."""
        water = self.sea.current.fastest_mps * np.array([1.0, 1.0, 0.0])
        force = self.vehicle.force_limits + self.sea.strongest_push
        return Motion(self.vehicle, force, self.start.fastest + water, self.episode.duration_s)

    @property
    def ship_paths(self) -> tuple[ShipPath, ...]:
        """The alternatives that an episode's path is drawn from."""
        return self.ship if isinstance(self.ship, tuple) else (self.ship,)

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions, in their order."""
        return KINDS[self.action]

    def derived(self) -> dict[str, float]:
        """How many actions move an actuator that has a force; 1 if none does, since it is divided by."""
        moved = self.vehicle.force_limits[list(AXES[self.action])]
        return {"actuators": max(1.0, float(np.count_nonzero(moved)))}

    @property
    def draws(self) -> bool:
        """Whether episodes differ from seed to seed."""
        random = any(each.random for each in self.family() if each is not self.fixes or self.observation.fixes)
        return random or self != self.midpoint() or len(self.ship_paths) > 1

    @classmethod
    def named(cls, name: str) -> Scenario:
        """The named scenario.

        Raises:
            SettingError: There is no scenario of that name; the nearest one is given.
        """
        if not isinstance(name, str) or name not in SCENARIOS:
            raise SettingError(f"There is no scenario {shown(name)}; {closest(name, SCENARIOS)}")
        return SCENARIOS[name]

    def known(self, integration_step_s: float | None = None) -> Scenario:
        """What the maker of a policy knows of the scenario: the nominal model, limits, periods, reward and scales.

        Nothing is drawn, nothing disturbs, sensors are exact, ranges are at their middle, and the ship's path is
        unknown: it is `CarriedOnPath`, at rest until `Fleet.believe` says otherwise.

        Args:
            integration_step_s: Another integration step, for planning [s], infinite for the coarsest in which the
                integrator follows the nominal model; by default the scenario's, or a finer one that this needs.

        Raises:
            SettingError: The control period isn't a whole multiple of the step, or the integrator can't follow the
                nominal model in such steps.
        """
        vehicle = self.vehicle.nominal()
        wanted = self.episode.integration_step_s if integration_step_s is None else integration_step_s
        if integration_step_s is None or integration_step_s == math.inf:
            wanted = min(wanted, self.episode.control_period_s)
            motion = Motion(vehicle, vehicle.force_limits, self.start.fastest, self.episode.duration_s)
            longest = motion.longest_step(motion.rate)
            if wanted > longest * (1.0 + 1e-9):
                wanted = self.episode.step_within(longest)
        return replace(
            self.midpoint(),
            vehicle=vehicle,
            ship=CarriedOnPath(),
            sea=Sea(),
            sensors=Sensors(),
            fixes=self.midpoint().fixes.exact(),
            episode=self.episode.merged({"integration_step_s": wanted}),
        )

    def to_json(self) -> str:
        """The scenario as a JSON text that `from_json` reads back to an equal scenario."""
        return json.dumps(self.to_dict(), indent=2)

    def digest(self) -> str:
        """16 hexadecimal digits that tell scenarios apart: equal for equal settings, whatever they are called."""
        text = json.dumps(self.essence(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @classmethod
    def from_json(cls, text: str) -> Scenario:
        """Read a scenario from JSON.

        Raises:
            SettingError: The text isn't a JSON object, a key is unknown or a value isn't allowed.
        """
        data = from_json(text, f"The scenario {shown(text)}")
        if not isinstance(data, Mapping):
            raise SettingError(f"The scenario {shown(text)} is not allowed; its JSON must be an object.")
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


SCENARIOS: dict[str, Scenario] = {}
"""The named scenarios, which the modules of `uwoc_gym.scenarios` put here."""

DESCRIPTIONS: dict[str, str] = {}
"""What each named scenario is, in a line."""


def name_scenario(name: str, description: str, scenario: Scenario) -> None:
    """Put a scenario among the named ones; `uwoc_gym.register_envs` then gives it the ID ``uwoc/<name>-v0``.

    Args:
        name: Letters, digits, ``_``, ``.`` and ``-``.
        description: What it is, in a line.
        scenario: The scenario.

    Raises:
        SettingError: The name isn't allowed, or another scenario has it.
    """
    if not re.fullmatch(r"[\w.-]+", name):
        raise SettingError(f"name = {name!r} is not allowed; it must be of letters, digits, '_', '.' and '-'.")
    if name in SCENARIOS and SCENARIOS[name] != scenario:
        raise SettingError(f"There is another scenario called {name!r}; choose another name.")
    SCENARIOS[name] = scenario
    DESCRIPTIONS[name] = description
