"""The scripted controllers' law.

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
from uwoc_gym.baselines.law import Law, Tracker, several
from uwoc_gym.given import SettingError, shown
from uwoc_gym.scenario import Scenario

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


class Controller(Law):
    """The nonlinear PD law with model feedforward, batched over observations.

    Args:
        gains: A gain set or the name of one; or a sequence of N of them, one for each of N observations.
        scenario: As in `Law`.
        filtered: As in `Law`.

    Raises:
        SettingError: There is no gain set or scenario of that name, or the scenario's observations leave out what the
            law needs.
    """

    def __init__(
        self,
        gains: str | Gains | Sequence[str | Gains],
        scenario: str | Scenario = "Nominal",
        filtered: bool | Tracker = False,
    ) -> None:
        given = several(gains)
        if not given or not all(isinstance(each, (str, Gains)) for each in given):
            raise SettingError(
                f"gains = {shown(gains)} is not allowed; it must be a Gains, a gain set's name, or several of them."
            )
        self.gain_sets = tuple(named_gains(each) if isinstance(each, str) else each for each in given)
        axis: Any = 0 if given is not gains else slice(None)
        self._numbers = {
            name: np.array([getattr(each, name) for each in self.gain_sets])[axis]
            for name in ("a_p", "b_p", "mu_p", "a_v", "b_v", "mu_v")
        }
        self._informed = np.array([[each.feedforward] for each in self.gain_sets])[axis]
        needed = dict.fromkeys(("ship", "velocity", "heading"), "")
        if self._informed.any():
            needed["ship-acceleration"] = " or a gain set without feedforward"
        super().__init__(scenario, filtered, needed)

    def force_for(self, seen: Any) -> Array:
        """See `Law.force_for`."""
        cosine, sine = seen.heading[..., 0], seen.heading[..., 1]
        # The gains belong to the earth's axes, so that errors turn there and the force turns back.
        offset = np.concatenate([seen.relative_position, seen.yaw_error[..., None]], axis=-1)
        error = _turn(offset, cosine, sine)
        drift = _turn(seen.relative_velocity, cosine, sine)
        g = self._numbers
        pull = gain(error, g["a_p"], g["b_p"], g["mu_p"]) * error + gain(drift, g["a_v"], g["b_v"], g["mu_v"]) * drift
        tau = _turn(pull, cosine, -sine)
        if self._informed.any():
            tau = tau + np.where(self._informed, self.feedforward(seen), 0.0)
        return tau


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
