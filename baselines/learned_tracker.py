"""The ship's motion from late fixes by a recurrent network that has seen many ships sail.

At each fix a gated recurrent unit (Cho et al., "Learning Phrase Representations using RNN Encoder-Decoder for
Statistical Machine Translation", EMNLP 2014) takes in how the ship has moved since the last one, seen from its own
heading, and gives the coefficients of a way: place and heading as polynomials of the time since the ping, in the frame
of the fix. Velocity and acceleration are their slopes. Where the AUV was isn't among what it takes in: that would tell
it what the law that flew in training believed.

`uwoc-gym tracker` trains it; here NumPy is enough.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.observers import DeadReckoning, Memory, completed, turned, wrapped
from uwoc_gym.given import SettingError, shown
from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import Measured

Array = npt.NDArray[np.float64]

SHIPPED = Path(__file__).parent / "tuned" / "LateFix" / "tracker.npz"
"""The weights that come with the package, of ships as they sail in `LateFix`."""

TIME_S, WAY_M = 2.0, 4.0
"""Units in which the network is told of times and ways."""

LONGEST_S = 3.0
"""Age of a fix from which on the ship is taken to go straight on, as a polynomial would not."""

PLACE, HEADING = 5, 4
"""Coefficients of the polynomials of place, along each axis, and of heading."""

FEATURES = 6
"""Numbers that a fix is told by: see `told`."""

OUTPUTS = 2 * PLACE + HEADING


class Weights(NamedTuple):
    """The network: gates as PyTorch orders them (reset, update, new), then two layers."""

    gates_in: Array
    """(3 H, FEATURES)"""
    gates_in_bias: Array
    gates_own: Array
    """(3 H, H)"""
    gates_own_bias: Array
    hidden: Array
    """(H, H)"""
    hidden_bias: Array
    out: Array
    """(OUTPUTS, H)"""
    out_bias: Array

    @property
    def size(self) -> int:
        """Units H."""
        return len(self.hidden)

    def step(self, features: Array, state: Array) -> Array:
        """The state, (N, H), after fixes, (N, FEATURES), from the one before."""
        reset, update, new = np.split(features @ self.gates_in.T + self.gates_in_bias, 3, axis=1)
        own_reset, own_update, own_new = np.split(state @ self.gates_own.T + self.gates_own_bias, 3, axis=1)
        reset, update = _sigmoid(reset + own_reset), _sigmoid(update + own_update)
        found: Array = (1.0 - update) * np.tanh(new + reset * own_new) + update * state
        return found

    def way(self, state: Array) -> Array:
        """The coefficients of what follows, (N, OUTPUTS), for states, (N, H); see `motion`."""
        found: Array = np.tanh(state @ self.hidden.T + self.hidden_bias) @ self.out.T + self.out_bias
        return found


def read_weights(path: str | Path) -> Weights:
    """The weights in a .npz file.

    Raises:
        SettingError: It can't be read, or doesn't hold them.
    """
    if path == SHIPPED:
        return _shipped()
    try:
        with np.load(path, allow_pickle=False) as file:
            found = Weights(*(np.asarray(file[name], dtype=float) for name in Weights._fields))
        size = found.size
        shapes = [(3 * size, FEATURES), (3 * size,), (3 * size, size), (3 * size,)]
        shapes += [(size, size), (size,), (OUTPUTS, size), (OUTPUTS,)]
        if [each.shape for each in found] != shapes:
            raise ValueError("its arrays don't fit together")
        if not all(np.isfinite(each).all() for each in found):
            raise ValueError("it holds what isn't finite")
    # NumPy raises anything on what is damaged, from a BadZipFile to a SyntaxError.
    except Exception as error:
        text = " ".join(str(error).split())
        raise SettingError(
            f"weights = {shown(str(path))} is not allowed: {text[:200]}; it must be a tracker.npz of uwoc-gym tracker."
        ) from None
    return found


@cache
def _shipped() -> Weights:
    return read_weights(str(SHIPPED))


def told(ship: Array, before: Array, since_s: Array, first: npt.NDArray[np.bool_]) -> Array:
    """What the network is told of fixes, (..., FEATURES).

    Args:
        ship: Poses at the pings, (..., 3) [m, m, rad].
        before: Those of the fixes before.
        since_s: Time between the two pings, (...) [s].
        first: Whether there is no fix before, (...).
    """
    way, turn = _seen_from(ship, before)
    found = np.concatenate(
        [way / WAY_M, np.stack([turn, since_s / TIME_S, np.zeros_like(turn), np.cos(turn)], axis=-1)], axis=-1
    )
    found[first] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]
    return found


def _seen_from(ship: Array, other: Array) -> tuple[Array, Array]:
    """How far a ship is from another place, seen from its heading, (..., 2) [m]; and the turn since then, (...)."""
    way = turned((ship - other)[..., :2].reshape(-1, 2), -ship[..., 2].reshape(-1))
    return way.reshape(*ship.shape[:-1], 2), wrapped(ship[..., 2] - other[..., 2])


def motion(coefficients: Any, age_s: Any) -> tuple[list[Any], list[Any], list[Any], Any, Any]:
    """Place, velocity and acceleration along both axes of the fix's frame, and heading and its rate since the fix.

    By plain operators, so that it is the same for NumPy's arrays and PyTorch's tensors.

    Args:
        coefficients: (..., OUTPUTS), by rising powers of the time in `TIME_S`: along x, along y, heading.
        age_s: Time since the ping, (...) [s].
    """
    over_s = (age_s - LONGEST_S).clip(0.0)
    turns = over_s == 0.0
    time = (age_s - over_s) / TIME_S
    axes = [[coefficients[..., PLACE * axis + i] for i in range(PLACE)] for axis in range(2)]
    heading = [coefficients[..., 2 * PLACE + i] for i in range(HEADING)]
    slopes = [_slope(axis) for axis in axes]
    velocity = [_value(axis, time) / TIME_S for axis in slopes]
    return (
        [_value(axis, time) + over_s * along for axis, along in zip(axes, velocity, strict=True)],
        velocity,
        [turns * _value(_slope(axis), time) / TIME_S**2 for axis in slopes],
        _value(heading, time),
        turns * _value(_slope(heading), time) / TIME_S,
    )


def _value(powers: list[Any], time: Any) -> Any:
    found = powers[-1]
    for each in reversed(powers[:-1]):
        found = each + time * found
    return found


def _slope(powers: list[Any]) -> list[Any]:
    return [i * each for i, each in enumerate(powers)][1:]


class LearnedTracker:
    """An observer (see `uwoc_gym.baselines.observers`) that believes in the ship's motion.

    Args:
        scenario: What is known of the scenario.
        weights: The network, or its file.

    Raises:
        SettingError: The scenario's ship isn't known by fixes alone, or the file doesn't hold weights.
    """

    def __init__(self, scenario: Scenario, weights: Weights | str | Path = SHIPPED) -> None:
        self._weights = weights if isinstance(weights, Weights) else read_weights(weights)
        self._reckon = DeadReckoning(scenario)

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """See `uwoc_gym.baselines.observers.Observer`."""
        reckoned, own = (None, None) if memory is None else (memory[:5], memory[5:])
        heard, reckoned = self._reckon(seen, reckoned, begun)
        assert reckoned is not None
        lanes = len(heard.ship)
        if own is None:
            sizes = ((3,), (), (self._weights.size,), (OUTPUTS,))
            own = tuple(np.zeros((lanes, *size)) for size in sizes)
        ship, ping_s, state, coefficients = own
        some = np.flatnonzero(heard.told)
        if some.size:
            first = heard.begun[some]
            features = told(heard.ship[some], ship[some], heard.ping_s[some] - ping_s[some], first)
            state[some] = self._weights.step(features, np.where(first[:, None], 0.0, state[some]))
            coefficients[some] = self._weights.way(state[some])
            ship[some], ping_s[some] = heard.ship[some], heard.ping_s[some]
        return completed(seen, heard.place, *_now(coefficients, ship, heard.age_s)), (*reckoned, *own)


def _sigmoid(value: Array) -> Array:
    return 0.5 + 0.5 * np.tanh(0.5 * value)


def _now(coefficients: Array, ship: Array, age_s: Array) -> tuple[Array, Array, Array]:
    """Pose, velocity and acceleration, each (N, 3), in the frame of `Heard`."""
    *axes, heading, rate = motion(coefficients, age_s)
    still = np.zeros_like(age_s)
    way, course, gain = (turned(np.stack(each, axis=1), ship[:, 2]) for each in axes)
    return (
        np.column_stack([ship[:, :2] + way, ship[:, 2] + heading]),
        np.column_stack([course, rate]),
        np.column_stack([gain, still]),
    )
