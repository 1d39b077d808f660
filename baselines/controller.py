"""The scripted controllers' law and the interface that they share with learned policies.

    τ = Rᵀ(ϱ) [M(η) η̈_ref + C(ν,η) η̇_ref + D(ν,η) η̇_ref + K_p(·) η̃ + K_v(·) ν̃]        (paper, sec. 3.2)

with the errors η̃ = η_ref − η and ν̃ = η̇_ref − η̇ in the earth frame. A controller sees observations only.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.gains import Gains
from uwoc_gym.baselines.gains import gains as named_gains
from uwoc_gym.baselines.observers import CarriedFixes, Observer, as_seen
from uwoc_gym.given import SettingError, shown
from uwoc_gym.scenario import Scenario, as_scenario
from uwoc_gym.task.action import AXES
from uwoc_gym.task.observation import Measured, unpack

Array = npt.NDArray[np.float64]


def gain(error: npt.ArrayLike, a: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike) -> Array:
    """The law's gain k(e) = a |e|^(mu-1) for |e| >= b, a b^(mu-1) for |e| < b (paper, sec. 3.2).

    The paper prints ≥ in both branches; the second can only be <.

    Args:
        error: Errors, shape (..., 3) for x, y and yaw, or any shape that broadcasts with the gains.
        a: Gain at an error of one unit, > 0.
        b: Error below which the gain stays constant, > 0, in the error's unit.
        mu: Exponent, in [0, 1].
    """
    size = np.maximum(np.abs(np.asarray(error, dtype=float)), b)
    result: Array = a * size ** (np.asarray(mu, dtype=float) - 1.0)
    return result


def _turn(vector: Array, cosine: Array, sine: Array) -> Array:
    """Turn the first two components of (..., 3) by an angle."""
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, vector[..., 2]], axis=-1)


class Controller:
    """The nonlinear PD law with model feedforward, batched over observations.

    Args:
        gains: A gain set or the name of one; or a sequence of N of them, one for each of N observations.
        scenario: The scenario, or the name of one, that gives the vehicle's nominal model, the actuators' limits and
            the observation's scales. What the plant departs from the nominal model by stays unknown to the law.

    Raises:
        SettingError: There is no gain set or scenario of that name, or the scenario's observations leave out what the
            law needs.

    Where the ship is known by fixes alone, the law flies on what `CarriedFixes` makes of them. Axes without a force or
    an action are left alone.
    """

    def __init__(self, gains: str | Gains | Sequence[str | Gains], scenario: str | Scenario = "Nominal") -> None:
        several: Sequence[Any] | None = gains if isinstance(gains, Sequence) and not isinstance(gains, str) else None
        given: Sequence[Any] = [gains] if several is None else several
        if not given or not all(isinstance(each, (str, Gains)) for each in given):
            raise SettingError(
                f"gains = {shown(gains)} is not allowed; it must be a Gains, a gain set's name, or several of them."
            )
        self.gain_sets = tuple(named_gains(each) if isinstance(each, str) else each for each in given)
        axis: Any = 0 if several is None else slice(None)
        self._numbers = {
            name: np.array([getattr(each, name) for each in self.gain_sets])[axis]
            for name in ("a_p", "b_p", "mu_p", "a_v", "b_v", "mu_v")
        }
        self._informed = np.array([[each.feedforward] for each in self.gain_sets])[axis]
        chosen = as_scenario(scenario)
        self._check_interface(chosen)
        self._observe: Observer = as_seen if "ship" in chosen.observation.groups else CarriedFixes(chosen)
        self.vehicle = chosen.vehicle.nominal()
        self.force_limits = self.vehicle.force_limits
        self._axes = list(AXES[chosen.action])
        self.observation_settings = chosen.observation
        self._inertia = self.vehicle.inertia

    def _check_interface(self, scenario: Scenario) -> None:
        """Refuse a scenario that doesn't show the law what it needs."""
        needed = ["velocity", "heading"]
        if "fix" not in scenario.observation.groups:
            needed = ["ship", *needed, *(["ship-acceleration"] if self._informed.any() else [])]
        for group in needed:
            if group not in scenario.observation.groups:
                without = " or a gain set without feedforward" if group == "ship-acceleration" else ""
                raise SettingError(
                    f"The law needs the observation group {group!r}, which the scenario leaves out; choose groups with "
                    f"it{without}."
                )

    def force(self, observation: npt.ArrayLike) -> Array:
        """The force that the law asks for, before the actuators' limits, if the ship is observed at all times.

        Args:
            observation: Shape (..., size), size 20 unless the scenario chooses other groups.

        Returns:
            Surge force [N], sway force [N] and yaw moment [N m] in the AUV's body frame, float64 of shape (..., 3).

        Raises:
            ValueError: The observation's last axis has another size, or there are N gain sets and not N observations.
        """
        return self.law(unpack(observation, self.observation_settings))

    def law(self, measured: Measured) -> Array:
        """The force that the law asks for where the ship's state is ``measured``; as `force` otherwise."""
        # Which entries are there has been checked.
        seen: Any = measured
        cosine, sine = seen.heading[..., 0], seen.heading[..., 1]
        # The gains belong to the earth's axes, so that errors turn there and the force turns back.
        offset = np.concatenate([seen.relative_position, seen.yaw_error[..., None]], axis=-1)
        error = _turn(offset, cosine, sine)
        drift = _turn(seen.relative_velocity, cosine, sine)
        g = self._numbers
        pull = gain(error, g["a_p"], g["b_p"], g["mu_p"]) * error + gain(drift, g["a_v"], g["b_v"], g["mu_v"]) * drift
        tau = _turn(pull, cosine, -sine)
        if self._informed.any():
            tau = tau + np.where(self._informed, self._feedforward(seen), 0.0)
        return tau

    def _feedforward(self, seen: Any) -> Array:
        """The model's force along the ship's path: M a − M r S w + C(ν) w + D(ν) w, all in the body frame.

        That is Rᵀ [M(η) η̈_ref + C(ν,η) η̇_ref + D(ν,η) η̇_ref], with the ship's acceleration a and velocity w as seen
        from the body and S w = (−w₂, w₁, 0). The term in S comes from Rᵀ Ṙ = r S.
        """
        velocity = seen.velocity
        ship = velocity + seen.relative_velocity
        rate = velocity[..., 2]
        turning = np.stack([-rate * ship[..., 1], rate * ship[..., 0], np.zeros_like(rate)], axis=-1)
        model = self.vehicle
        resistance = model.coriolis_force(velocity, ship) + model.damping(velocity) * ship
        result: Array = self._inertia * (seen.ship_acceleration - turning) + resistance
        return result

    def predict(
        self,
        observation: npt.ArrayLike,
        state: tuple[npt.NDArray[Any], ...] | None = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[np.float32], tuple[npt.NDArray[Any], ...] | None]:
        """The action for an observation, called as in Stable-Baselines3.

        Args:
            observation: Shape (size,) or (N, size), size 20 unless the scenario chooses other groups.
            state: What the last call gave back, None at first. Only where the ship is known by fixes has the law a
                memory.
            episode_start: Which of N episodes begin with the observation, (N,).
            deterministic: Not used: the law has no randomness.

        Returns:
            The action, float32 in [-1, 1] of shape (actions,) or (N, actions), the force over the actuators' limits;
            and the state for the next call.

        Raises:
            ValueError: The observation has another shape.
        """
        obs = np.asarray(observation)
        if obs.ndim not in (1, 2):
            size = self.observation_settings.size
            raise ValueError(f"observation has shape {obs.shape}; it must be ({size},) or (N, {size}).")
        seen, state = self._observe(unpack(np.atleast_2d(obs), self.observation_settings), state, episode_start)
        force, limits = self.law(seen)[:, self._axes], self.force_limits[self._axes]
        share = np.divide(force, limits, out=np.zeros_like(force), where=limits > 0.0)
        action = np.clip(share, -1.0, 1.0).astype(np.float32)
        return (action[0] if obs.ndim == 1 else action), state


class NLPDController(Controller):
    """The law with the gains that were calibrated to the paper's nominal NLPD row, unless others are given.

    Examples:
        >>> controller = NLPDController()
        >>> action, _ = controller.predict(np.zeros((8, 20), np.float32))
        >>> action.shape
        (8, 3)
    """

    def __init__(
        self, gains: str | Gains | Sequence[str | Gains] = "nlpd", scenario: str | Scenario = "Nominal"
    ) -> None:
        super().__init__(gains, scenario)


class PDController(Controller):
    """The law with every exponent at 1, by default with the paper's gains and feedforward.

    Raises:
        SettingError: As `Controller`, or a mu of the gain set isn't 1.
    """

    def __init__(self, gains: str | Gains | Sequence[str | Gains] = "pd", scenario: str | Scenario = "Nominal") -> None:
        super().__init__(gains, scenario)
        for gain_set, name in itertools.product(self.gain_sets, ("mu_p", "mu_v")):
            exponents = getattr(gain_set, name)
            if exponents != (1.0, 1.0, 1.0):
                raise SettingError(
                    f"Gains.{name} = {exponents!r} is not allowed for a PDController; every exponent must be 1 "
                    "(NLPDController takes those below)."
                )
