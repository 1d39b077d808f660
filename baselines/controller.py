"""The law's interface, shared by PD and NLPD: a policy that knows observations and the nominal vehicle, no more."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from uwoc_gym.baselines.gains import Gains, gains

from uwoc_gym.observation import unpack
from uwoc_gym.scenario import Scenario, as_scenario

Array = npt.NDArray[np.float64]


class Controller:
    """Trajectory tracking by the paper's law (section 3.2), batched over any leading axes of the observation.

        τ = Rᵀ(ϱ) [M(η) η̈_ref + C(ν,η) η̇_ref + D(ν,η) η̇_ref + K_p(η̃) η̃ + K_v(ν̃) ν̃]

    with errors η̃ = η_ref − η and ν̃ = η̇_ref − η̇ in the earth frame and the ship's motion as the reference. The model
    terms use the nominal vehicle, whatever the true one is.

    Args:
        gain_set: A gain set or its name.
        scenario: The scenario, or its name, whose nominal vehicle, actuator limits and observation scales apply.

    Raises:
        SettingError: There is no gain set or scenario of that name.
    """

    def __init__(self, gain_set: str | Gains, scenario: str | Scenario = "Nominal") -> None:
        known = as_scenario(scenario)
        self.gains = gains(gain_set) if isinstance(gain_set, str) else gain_set
        self.vehicle = known.vehicle.nominal()
        self._seen = known.observation
        self._limits = self.vehicle.force_limits

    def force(self, observation: npt.ArrayLike) -> Array:
        """The body-frame force τ that the law asks for, before any limit.

        Args:
            observation: Shape (..., 20).

        Returns:
            Surge force [N], sway force [N] and yaw moment [N m], shape (..., 3).

        Raises:
            ValueError: The observation has another length.
        """
        seen = unpack(observation, self._seen)
        cosine, sine = seen.heading[..., 0], seen.heading[..., 1]
        position = np.concatenate([_to_earth(seen.relative_position, cosine, sine), seen.yaw_error[..., None]], axis=-1)
        moving = seen.relative_velocity
        velocity = np.concatenate([_to_earth(moving[..., :2], cosine, sine), moving[..., 2:]], axis=-1)
        g = self.gains
        pull = _gain(position, g.a_p, g.b_p, g.mu_p) * position + _gain(velocity, g.a_v, g.b_v, g.mu_v) * velocity
        force = np.concatenate([_to_earth(pull[..., :2], cosine, -sine), pull[..., 2:]], axis=-1)
        if g.feedforward:
            force += self._feedforward(seen.velocity, moving + seen.velocity, seen.ship_acceleration)
        return force

    def _feedforward(self, velocity: Array, reference: Array, acceleration: Array) -> Array:
        """M η̈_ref + C η̇_ref + D η̇_ref, written in the body frame; there C(ν,η) becomes C(ν) − M r S."""
        rate = velocity[..., 2]
        turning = np.stack([-rate * reference[..., 1], rate * reference[..., 0], np.zeros_like(rate)], axis=-1)
        inertial = self.vehicle.inertia * (acceleration - turning)
        return inertial + self.vehicle.coriolis_force(velocity, reference) + self.vehicle.damping(velocity) * reference

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """The action, as Stable-Baselines3 models give it; the law has no memory and no randomness.

        Args:
            observation: Shape (20,) or (N, 20).
            state: Passed through.
            episode_start: Ignored.
            deterministic: Ignored.

        Returns:
            Actions in [-1, 1] of shape (3,) or (N, 3), float32, and ``state``.

        Raises:
            ValueError: The observation has another length.
        """
        share = self.force(observation) / self._limits
        return np.clip(share, -1.0, 1.0).astype(np.float32), state


def _to_earth(vector: Array, cosine: Array, sine: Array) -> Array:
    """Turn body-frame vectors (..., 2) by the heading; with the sine negated, earth-frame ones back."""
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _gain(error: Array, a: tuple[float, ...], b: tuple[float, ...], mu: tuple[float, ...]) -> Array:
    """k(e) = a |e|^(μ − 1), constant where |e| < b (paper, theorem 1, with the second condition as meant)."""
    result: Array = np.asarray(a) * np.maximum(np.abs(error), b) ** (np.asarray(mu) - 1.0)
    return result
