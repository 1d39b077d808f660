"""The ship's motion from late fixes: several models of how ships sail, each a Kalman filter, weighted by likelihood.

* heading, steady: the ship goes where it heads, at a speed that drifts slowly;
* heading, changing: the same with a speed that changes, an exponentially correlated acceleration;
* free: any course, with an exponentially correlated acceleration along each axis (Singer's model).

A filter of a second kind follows the heading and its rate. Given the headings at two pings, the way between them is an
arc whose chord is linear in the speed, so that plain Kalman filters do. The models' weights follow the likelihoods of
their innovations, with forgetting (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", sec. 8.2.3 and 11.6). What comes out is the mean of the models, carried on from the ping to now.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.kalman import Belief, belief, chosen, correct, matrix, predict
from uwoc_gym.baselines.numbers import fixed
from uwoc_gym.baselines.observers import DeadReckoning, Heard, Memory, completed, wrapped
from uwoc_gym.parameters import Parameters
from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import Measured

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TrackerSettings(Parameters):
    """How ships are thought to sail; densities of noise are per square root of a second."""

    position_std_m: float = fixed(0.3, "m", "error of a fix along each axis", 0.001, 100.0)
    yaw_std_rad: float = fixed(0.055, "rad", "error of the ship's heading, own compass included", 0.001, 3.0)
    speed_mps: float = fixed(0.9, "m/s", "speed before anything is known", 0.0, 30.0)
    speed_std_mps: float = fixed(0.7, "m/s", "its deviation", 0.001, 30.0)
    steady_mps: float = fixed(0.005, "m/s/√s", "drift of a steady speed", 0.0, 10.0)
    changing_mps2: float = fixed(0.15, "m/s²", "deviation of a changing speed's acceleration", 0.0, 10.0)
    changing_s: float = fixed(1.0, "s", "its correlation time", 0.01, 1000.0)
    free_mps2: float = fixed(0.2, "m/s²", "deviation of the acceleration of a free course", 0.0, 10.0)
    free_s: float = fixed(10.0, "s", "its correlation time", 0.01, 1000.0)
    turning_rad_s2: float = fixed(0.05, "rad/s²/√Hz", "density of the yaw acceleration", 0.0, 10.0)
    kept: float = fixed(0.98, "1", "share of the models' log weights that is kept at a fix", 0.0, 1.0)


FLOOR = 1e-3
"""Least weight of a model, from which it can come back."""

_TURNING_RAD_S = 0.3
"""Deviation of the yaw rate before anything is known."""


def _along(yaw: Array, turn: Array) -> Array:
    """Mean direction, (N, 2), of a way whose heading turns evenly by ``turn`` [rad]: its chord over its length."""
    middle = yaw + 0.5 * turn
    found: Array = np.sinc(turn / (2.0 * np.pi))[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
    return found


def _steady(time: Array, density: float) -> tuple[Array, Array]:
    """Transition and noise of (way, speed) over times, (N,) [s], with a speed that drifts."""
    step = matrix([[1.0, time], [0.0, 1.0]], time.size)
    noise = matrix([[time**3 / 3.0, time**2 / 2.0], [time**2 / 2.0, time]], time.size)
    return step, density**2 * noise


def _singer(time: Array, deviation: float, correlation_s: float) -> tuple[Array, Array]:
    """Transition and noise of (way, speed, acceleration) with an exponentially correlated acceleration.

    Singer, "Estimating Optimal Tracking Filter Performance for Manned Maneuvering Targets", IEEE Trans. Aerospace and
    Electronic Systems 6(4), 1970, with time in units of the correlation time.
    """
    t, tau = time / correlation_s, correlation_s
    e = np.exp(-t)
    step = matrix([[1.0, time, tau**2 * (t - 1.0 + e)], [0.0, 1.0, tau * (1.0 - e)], [0.0, 0.0, e]], time.size)
    q11 = tau**4 * (1.0 - e**2 + 2.0 * t + 2.0 * t**3 / 3.0 - 2.0 * t**2 - 4.0 * t * e)
    q12 = tau**3 * (e**2 + 1.0 - 2.0 * e + 2.0 * t * e - 2.0 * t + t**2)
    q13 = tau**2 * (1.0 - e**2 - 2.0 * t * e)
    q22 = tau**2 * (4.0 * e - 3.0 - e**2 + 2.0 * t)
    q23 = tau * (e**2 + 1.0 - 2.0 * e)
    noise = matrix([[q11, q12, q13], [q12, q22, q23], [q13, q23, 1.0 - e**2]], time.size)
    return step, deviation**2 * noise


def _led(along: Array, step: Array, noise: Array) -> tuple[Array, Array]:
    """Transition and noise of (x, y, speed, ...) of a ship that goes ``along``, from those of (way, speed, ...)."""
    lanes, size = len(along), step.shape[1]
    lift = np.zeros((lanes, size + 1, size))
    lift[:, :2, 0] = along
    lift[:, 2:, 1:] = np.eye(size - 1)
    lower = np.concatenate([np.zeros((size - 1, 2)), np.eye(size - 1)], axis=1)
    led = lift @ step[:, :, 1:] @ lower
    led[:, 0, 0] = led[:, 1, 1] = 1.0
    return led, lift @ noise @ lift.swapaxes(1, 2)


def _both(axis: Array) -> Array:
    """What holds for one axis, (N, n, n), for two that stand side by side, (N, 2n, 2n): x, y, vx, vy, ..."""
    found: Array = np.einsum("nij,kl->nikjl", axis, np.eye(2)).reshape(len(axis), 2 * axis.shape[1], -1)
    return found


class _Track(NamedTuple):
    """What is believed of N ships; every entry begins with N."""

    ping_s: Array
    weights: Array
    yaw: Belief
    models: tuple[Belief, ...]
    """Steady and changing speed along the heading, (x, y, speed, ...); free, (x, y, vx, vy, ax, ay)."""


def _flat(track: _Track) -> tuple[Array, ...]:
    return (track.ping_s, track.weights, *track.yaw, *(part for model in track.models for part in model))


def _track(parts: Sequence[Array]) -> _Track:
    ping_s, weights, *beliefs = parts
    yaw, *models = (Belief(*beliefs[i : i + 2]) for i in range(0, len(beliefs), 2))
    return _Track(ping_s, weights, yaw, tuple(models))


class ShipTracker:
    """An observer (see `uwoc_gym.baselines.observers`) that believes in the ship's motion.

    Args:
        scenario: What is known of the scenario.
        settings: How ships are thought to sail.
    """

    def __init__(self, scenario: Scenario, settings: TrackerSettings | None = None) -> None:
        self.settings = settings or TrackerSettings()
        self._reckon = DeadReckoning(scenario)

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """See `uwoc_gym.baselines.observers.Observer`."""
        reckoned, parts = (None, None) if memory is None else (memory[:5], memory[5:])
        heard, reckoned = self._reckon(seen, reckoned, begun)
        assert reckoned is not None
        if parts is None or heard.begun.any():
            parts = chosen(heard.begun, _flat(self.begin(heard)), parts)
        later = heard.told & ~heard.begun
        if later.any():
            parts = chosen(later, _flat(self.learn(_track(parts), heard.ship, heard.ping_s)[0]), parts)
        return completed(seen, heard.place, *self._now(_track(parts), heard.age_s)), (*reckoned, *parts)

    def begin(self, heard: Heard) -> _Track:
        """Nothing but a first fix is known."""
        s, lanes = self.settings, len(heard.ship)
        x, y, yaw = heard.ship.T
        near = [s.position_std_m] * 2
        anyhow = float(np.hypot(s.speed_mps, s.speed_std_mps))
        changing = [s.speed_std_mps, s.changing_mps2]
        return _Track(
            heard.ping_s,
            np.full((lanes, 3), 1.0 / 3.0),
            belief([yaw, 0.0], [s.yaw_std_rad, _TURNING_RAD_S], lanes),
            (
                belief([x, y, s.speed_mps], [*near, s.speed_std_mps], lanes),
                belief([x, y, s.speed_mps, 0.0], [*near, *changing], lanes),
                belief([x, y, *[0.0] * 4], [*near, anyhow, anyhow, s.free_mps2, s.free_mps2], lanes),
            ),
        )

    def learn(self, track: _Track, ship: Array, ping_s: Array) -> tuple[_Track, Array]:
        """Take in a fix of each of N ships.

        Args:
            track: What is believed.
            ship: Their poses at the pings, (N, 3) [m, m, rad].
            ping_s: The times of the pings, (N,) [s].

        Returns:
            What is believed now, and each model's innovation squared in its own covariance (NIS), (N, 3).
        """
        s = self.settings
        time = np.maximum(ping_s - track.ping_s, 1e-3)
        ahead = predict(track.yaw, *_steady(time, s.turning_rad_s2))
        error = wrapped(ship[:, 2:] - ahead.mean[:, :1])
        yaw, _, _ = correct(ahead, error, np.eye(1, 2), np.array([[s.yaw_std_rad**2]]))
        turn = yaw.mean[:, 0] - track.yaw.mean[:, 0]
        along = _along(track.yaw.mean[:, 0], turn)
        across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        blur = np.einsum("n,ni,nj->nij", (yaw.cov[:, 0, 0] + track.yaw.cov[:, 0, 0]) / 4.0, across, across)
        singer = _singer(time, s.free_mps2, s.free_s)
        ways = (
            _led(along, *_steady(time, s.steady_mps)),
            _led(along, *_singer(time, s.changing_mps2, s.changing_s)),
            (_both(singer[0]), _both(singer[1])),
        )
        models, scores, squares = [], [], []
        for model, (step, noise) in zip(track.models, ways, strict=True):
            size = model.mean.shape[1]
            if size < 6:
                # A heading that is wrong puts the ship beside its way.
                noise[:, :2, :2] += blur * np.square(model.mean[:, 2] * time)[:, None, None]
            before = predict(model, step, noise)
            innovation = ship[:, :2] - before.mean[:, :2]
            after, score, square = correct(before, innovation, np.eye(2, size), np.eye(2) * s.position_std_m**2)
            models.append(after)
            scores.append(score)
            squares.append(square)
        logs = s.kept * np.log(track.weights) + np.stack(scores, axis=1)
        weights = np.maximum(np.exp(logs - logs.max(axis=1, keepdims=True)), FLOOR)
        weights /= weights.sum(axis=1, keepdims=True)
        return _Track(ping_s, weights, yaw, tuple(models)), np.stack(squares, axis=1)

    def _now(self, track: _Track, age_s: Array) -> tuple[Array, Array, Array]:
        """Pose, velocity and acceleration, each (N, 3), some time after the ping."""
        s = self.settings
        heading, rate = track.yaw.mean[:, 0], track.yaw.mean[:, 1]
        yaw = heading + rate * age_s
        along = _along(heading, rate * age_s)
        bow = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        beam = np.stack([-bow[:, 1], bow[:, 0]], axis=-1)
        steady, changing, free = (model.mean for model in track.models)
        still = np.zeros_like(age_s)
        found = []
        for mean, (step, _) in (
            (np.column_stack([steady, still]), _singer(age_s, 0.0, s.changing_s)),
            (changing, _singer(age_s, 0.0, s.changing_s)),
        ):
            way, speed, gain = (step @ np.column_stack([still, mean[:, 2:]])[..., None])[..., 0].T
            found.append(
                np.concatenate(
                    [
                        mean[:, :2] + way[:, None] * along,
                        speed[:, None] * bow,
                        gain[:, None] * bow + (speed * rate)[:, None] * beam,
                    ],
                    axis=1,
                )
            )
        found.append((_both(_singer(age_s, 0.0, s.free_s)[0]) @ free[..., None])[..., 0])
        mean = np.einsum("nk,kni->ni", track.weights, np.array(found))
        return (
            np.column_stack([mean[:, :2], yaw]),
            np.column_stack([mean[:, 2:4], rate]),
            np.column_stack([mean[:, 4:], still]),
        )
