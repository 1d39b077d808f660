"""The single environment: a fleet of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from uwoc_gym.given import as_numbers, shown
from uwoc_gym.parameters import FlagSpec
from uwoc_gym.scenario import Scenario
from uwoc_gym.sim import paper
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES, info_names
from uwoc_gym.spaces import (
    FRAME,
    Described,
    ScenarioLike,
    action_space,
    build_scenario,
    check_options,
    check_render_mode,
    check_render_size,
    check_seed,
    episode_scenario,
    import_rendering,
    observation_space,
    one_of,
)

Observation = npt.NDArray[np.float32]

_REWARD, _TERMINATED, _TRUNCATED = (MEASURE_NAMES.index(name) for name in ("reward", "terminated", "truncated"))
step_one: Any = paper.step_one
_FLOAT32 = np.dtype(np.float32)
_ARRAY = np.ndarray
_LANE = np.zeros(1, dtype=np.int64)


class TrackingEnv(Described, gym.Env[Observation, Observation]):
    """Keep an AUV inside the cone of light below a moving ship.

    ## Description

    An AUV with an optical transmitter works at constant depth below a ship that carries the receiver. The link reaches
    its threshold bit rate (10 Mbit/s at a bit error rate of 1e-4, under solar noise) only inside a cone below the ship,
    and hundreds of times as much on its axis. The agent applies forces to the AUV so that it enters the cone soon,
    stays in it under pulses, currents, wrong masses and noisy sensors, and keeps close to the axis and to the ship's
    heading. Equations and defaults are those of N'Doye, Zhang, Alouini and Laleg-Kirati, "Establishing and
    Maintaining a Reliable Optical Wireless Communication in Underwater Environment".

    ## Action Space

    `Box(-1, 1, (3,), float32)`; finite numbers beyond the bounds are clipped.

    | Num | Action       | Min | Max | Unit at ±1       |
    |-----|--------------|-----|-----|------------------|
    | 0   | surge force  | -1  | 1   | 2000 N           |
    | 1   | sway force   | -1  | 1   | 2000 N           |
    | 2   | yaw moment   | -1  | 1   | 500 N m          |

    With `scenario={"action": "surge-yaw"}` there is no force to the side: the actions are surge force and yaw moment.

    ## Observation Space

    `Box((20,), float32)`: what the sensors say, noise included, in the AUV's body frame. An entry times its scale is
    the value in its unit; `uwoc_gym.task.observation.unpack` does that. "Ahead" is along surge, "starboard" along sway.

    | Num | Observation                                  | Min | Max | Unit    | Scale |
    |-----|----------------------------------------------|-----|-----|---------|-------|
    | 0   | ship position ahead                          | -5  | 5   | m       | 4     |
    | 1   | ship position to starboard                   | -5  | 5   | m       | 4     |
    | 2   | cosine of ship heading relative to AUV       | -1  | 1   | 1       | 1     |
    | 3   | sine of ship heading relative to AUV         | -1  | 1   | 1       | 1     |
    | 4   | ship velocity relative to AUV, ahead         | -5  | 5   | m/s     | 1     |
    | 5   | ship velocity relative to AUV, to starboard  | -5  | 5   | m/s     | 1     |
    | 6   | ship yaw rate relative to AUV                | -5  | 5   | rad/s   | 1     |
    | 7   | surge velocity                               | -5  | 5   | m/s     | 1     |
    | 8   | sway velocity                                | -5  | 5   | m/s     | 1     |
    | 9   | yaw rate                                     | -5  | 5   | rad/s   | 1     |
    | 10  | ship acceleration ahead                      | -5  | 5   | m/s^2   | 0.5   |
    | 11  | ship acceleration to starboard               | -5  | 5   | m/s^2   | 0.5   |
    | 12  | ship yaw acceleration                        | -5  | 5   | rad/s^2 | 0.5   |
    | 13  | cosine of own heading                        | -1  | 1   | 1       | 1     |
    | 14  | sine of own heading                          | -1  | 1   | 1       | 1     |
    | 15  | last action, surge                           | -1  | 1   | 1       | 1     |
    | 16  | last action, sway                            | -1  | 1   | 1       | 1     |
    | 17  | last action, yaw                             | -1  | 1   | 1       | 1     |
    | 18  | bit rate, log scale from threshold to on-axis| 0   | 1   | 1       | 1     |
    | 19  | inside the cone                              | 0   | 1   | 1       | 1     |

    The entries come in groups, of which `scenario={"observation": {"groups": [...]}}` chooses, in any order; space and
    `unpack` follow the choice.

    | Group             | Entries                                      |
    |-------------------|----------------------------------------------|
    | ship              | 0 to 6                                       |
    | velocity          | 7 to 9                                       |
    | ship-acceleration | 10 to 12                                     |
    | heading           | 13 to 14                                     |
    | last-action       | 15 to 17                                     |
    | link              | 18 to 19                                     |
    | time              | share of the episode gone, from 0 to 1       |
    | fix               | see below                                    |

    A fix says where the ship was at its ping, seen from the AUV. What the AUV has done since isn't in it;
    `uwoc_gym.baselines.observers` works that out. `uwoc_gym.world.auv.fixes` says when fixes come, and how exactly.

    | Entry of fix                                                  | Min | Max | Unit | Scale |
    |---------------------------------------------------------------|-----|-----|------|-------|
    | last fix: ship position ahead at its ping                     | -5  | 5   | m    | 4     |
    | last fix: ship position to starboard at its ping              | -5  | 5   | m    | 4     |
    | last fix: cosine of ship heading relative to AUV at its ping  | -1  | 1   | 1    | 1     |
    | last fix: sine of ship heading relative to AUV at its ping    | -1  | 1   | 1    | 1     |
    | time since the ping of the last fix                           | 0   | 5   | s    | 4     |
    | last fix arrived with this observation                        | 0   | 1   | 1    | 1     |

    ## Rewards

    A weighted sum of five terms, each of which is in `info` as `reward_<name>` after weighting; see
    `uwoc_gym.RewardSettings`. With the default weights the highest reward of a step is 1.

    | Term     | Weight | Value                                                                    |
    |----------|--------|--------------------------------------------------------------------------|
    | bit_rate | 0.4    | log bit rate, 0 at the threshold or below, 1 at the on-axis rate          |
    | in_cone  | 0.3    | 1 inside the cone, else 0                                                |
    | position | 0.2    | 1 / (1 + horizontal distance / 1 m)                                      |
    | heading  | 0.1    | 1 / (1 + yaw error / 0.5 rad)                                            |
    | effort   | 0.05   | −(mean square of the action)                                             |

    ## Starting State

    The AUV at (5 m, 5 m, yaw 0), at rest, and the ship at (0, 10 m) in `Nominal` and all cases; near the ship, with
    everything drawn from the seed, in `Random`, `Underactuated`, `Tide` and `LateFix`. `reset(options={"pose": (x, y,
    yaw), "velocity": (surge, sway, yaw rate), "scenario": {...}})` sets the start [m, rad, m/s, rad/s; earth frame] and
    merges overrides for one episode; `"parameters": {"sea.pulses[0].force_x_n": 800.0}` sets numbers that the scenario
    would draw.

    ## Episode End

    Terminated when the horizontal distance to the ship exceeds `episode.lost_distance_m` (20 m): the link is lost
    beyond recovery. Truncated after `episode.duration_s`: 150 s, or 60 s in `PaperCaseI`, `PaperCaseII` and wherever
    everything is drawn; `max_episode_steps` can shorten that, and so does closing the window. At the end
    `info["is_success"]` says whether the AUV was inside the cone throughout the last third of the episode, and before,
    whether it has been so for the last third of the time flown.

    `info` holds at every step `bit_rate_bps` at the target bit error rate, `snr` and `ber` at the threshold rate,
    `range_m`, `pointing_error_rad`, `in_cone`, `cost` (1 outside the cone, else 0), the reward terms and `is_success`,
    all of the true state.

    ## Arguments

    - `scenario`: overrides as a nested mapping, `{"vehicle": {"mass_scale": 1.2}}`, or a whole `Scenario` or its name.
    - `control_period_s`: time between actions [s], by default 0.05, or 0.005 in `PaperCaseI` and `PaperCaseII`.
    - `integration_step_s`: integration step [s], by default 0.005; the control period is a whole multiple of it.
    - `render_mode`: "rgb_array" for pictures from `render()`, which need no display, or "human" for a window, which
      shows each step at its time. Both need pygame (extra `render`). Once the user has closed the window, the step
      under way and the first step of any later episode are truncated, so that loops run out; `close()` ends that.
    - `render_size`: width and height of the pictures [px], by default (1280, 720); below 320 × 180 they are plain
      pictures of cone, ship and AUV from above, for agents that learn from pixels.
    - `info_arrays`: whether the values of `info` are NumPy arrays of no dimension, as TorchRL's reader of `info` wants
      them, instead of plain numbers and flags, by default False: they cost a microsecond a step.
    - `scenario_digest`: the digest that the scenario should have, as a spec records it; a warning says if it hasn't.

    ## Version History

    - v0: first release.

    Raises:
        SettingError: A setting is unknown or not allowed.
        ValueError: The render mode or size isn't allowed.
        DependencyNotInstalled: "human" needs pygame, which isn't installed.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        scenario: ScenarioLike | None = None,
        control_period_s: float | None = None,
        integration_step_s: float | None = None,
        render_mode: str | None = None,
        scenario_name: str = "Nominal",
        render_size: tuple[int, int] = FRAME,
        scenario_digest: str | None = None,
        info_arrays: bool = False,
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.render_size = check_render_size(render_size)
        self.renderer: Any = None
        self._window: Any = None
        if render_mode == "human":
            import_rendering()
        self.scenario = build_scenario(scenario, scenario_name, control_period_s, integration_step_s, scenario_digest)
        self.action_space = action_space(self.scenario)
        self.observation_space = observation_space(self.scenario)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.scenario.episode.control_period_s)}
        self._fleet = Fleet(self.scenario, 1, Autoreset.DISABLED)
        self._info_arrays = FlagSpec().parse(info_arrays, "info_arrays")
        self._running = False
        self._action_shape = (len(self.scenario.actions),)
        self._observation_size = self.scenario.observation.size
        self._read_fleet()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Fixes this and the following episodes. Without one, an ``np_random`` that was assigned does.
            options: ``pose`` (3,), ``velocity`` (3,), ``scenario`` overrides and ``parameters``, a dict of numbers to
                take instead of drawing them (by their names in `parameters`, within the scenario's ranges), for this
                episode only.

        Raises:
            ValueError: The seed isn't a whole number of at least 0, or an option is unknown, of the wrong shape, out of
                range or not finite; nothing has changed.
        """
        seed, given, wanted = self._checked(seed, options)
        super().reset(seed=seed)
        fresh = self._fresh_seed()
        if fresh is not None:
            self._fleet.seed(_LANE, [fresh])
        if wanted is not self._fleet.scenario:
            self._fleet.configure(wanted)
            self._read_fleet()
        observation = np.empty((1, self._observation_size), dtype=np.float32)
        self._fleet.reset(observation, None, given.get("pose"), given.get("velocity"), given.get("parameters"))
        self._compile_step()
        self._running = True
        if self.render_mode is not None:
            self._begin_pictures()
        return observation[0], self._info(self._measures())

    def check_reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Refuse what `reset` would refuse, and change nothing.

        Raises:
            ValueError: As of `reset`.
        """
        self._checked(seed, options)

    def _checked(self, seed: Any, options: Any) -> tuple[int | None, Mapping[str, Any], Scenario]:
        """Seed, options and scenario of a reset."""
        seed = check_seed(seed)
        given = check_options(options, ("pose", "velocity", "parameters", "scenario"))
        wanted = self.scenario
        if given.get("scenario") is not None:
            wanted = episode_scenario(self.scenario, given["scenario"])
        self._fleet.check_start(wanted, given.get("pose"), given.get("velocity"), given.get("parameters"))
        return seed, given, wanted

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply an action, of shape (3,) unless the scenario's kind is another, for one control period.

        Raises:
            ResetNeeded: No episode is running.
            ValueError: The action has another shape or isn't finite; nothing has moved.
        """
        if not self._running:
            raise gym.error.ResetNeeded("the episode has ended or not begun; call reset() before step().")
        observation = np.empty(self._observation_size, _FLOAT32)
        # At a few microseconds a step every look at the action counts. Numba's dispatcher is given arrays of the usual
        # type alone: others cost it 0.1 ms to refuse, and a list that is nested deeply enough crashes it.
        if type(action) is not _ARRAY or action.dtype is not _FLOAT32:
            action = self._as_action(action)
        try:
            status = step_one(self._memory, action, observation)
        except (TypeError, ValueError):
            # It is read-only, or its numbers don't lie in a row.
            status = paper.WRONG_SIZE
        if status:
            action = self._as_action(action)
            status = step_one(self._memory, action, observation)
            if status:
                self._fleet.refuse(status, action.reshape(1, -1))
        values = self._measures()
        terminated = values[_TERMINATED] > 0.0
        truncated = values[_TRUNCATED] > 0.0
        if self.render_mode is not None:
            truncated = self._picture() or truncated
        info = self._info(values)
        if terminated or truncated:
            self._running = False
            if self._fleet.diverged[0]:
                info["diverged"] = np.array(True) if self._info_arrays else True
        return observation, values[_REWARD], terminated, truncated, info

    def _as_action(self, action: Any) -> Observation:
        array = as_numbers(action, self._action_shape)
        if array is None:
            count = self._action_shape[0]
            raise ValueError(
                f"action = {shown(action)} is not allowed; it must be {count} finite numbers, shape ({count},)."
            )
        # Of the type that is compiled for: contiguous, and not read-only.
        return np.minimum(np.maximum(array, -1.0), 1.0).astype(_FLOAT32)

    def _compile_step(self) -> None:
        """Compile the step for the arrays that it is meant for, and for no others, if this hasn't been done."""
        if step_one.signatures:
            return
        nothing = np.full(self._action_shape, np.nan, dtype=_FLOAT32)
        step_one(self._memory, nothing, np.empty(self._observation_size, _FLOAT32))
        step_one.disable_compile()

    def _read_fleet(self) -> None:
        """Keep at hand what every step needs of the fleet, until it is configured anew."""
        self._memory = self._fleet.memory
        self._measures: Callable[[], list[float]] = self._fleet.single.tolist
        self._info = _info_maker(info_names(self._fleet.scenario), self._info_arrays)

    def state(self) -> dict[str, Any]:
        """The true state by name.

        Returns:
            ``time_s`` [s]; ``pose`` (3,) [m, m, rad] and ``velocity`` (3,) [m/s, m/s, rad/s] of the AUV, the first in
            the earth frame, the second in the body frame; ``depth_m``; ``ship_pose``, ``ship_velocity``,
            ``ship_acceleration`` (3,) in the earth frame; ``current`` (2,) [m/s]; ``force`` (3,) applied in the last
            step [N, N, N m]; ``bit_rate_bps``, ``snr``, ``ber``, ``range_m``, ``pointing_error_rad``, ``in_cone`` and
            the cone's ``slant_height_m``.
        """
        return one_of(self._fleet.state(), 0)

    def terms(self) -> dict[str, Any]:
        """The terms of the last step's reward by name, weighted, as `info` has them as ``reward_<name>``."""
        return one_of(self._fleet.terms(), 0)

    def parameters(self) -> dict[str, Any]:
        """What the present episode has drawn for each number and choice of the scenario, by its path.

        ``ship`` is the place of its path among the scenario's; of the others numbers are not a number, choices empty.
        """
        return one_of(self._fleet.drawn(), 0)

    def push(self, impulse: npt.ArrayLike) -> None:
        """Give the AUV a shove: change its velocity at once.

        Args:
            impulse: Along surge, along sway and about yaw, shape (3,) [N s, N s, N m s]; the velocity changes by the
                impulse over the AUV's true masses. The next observation shows it.

        Raises:
            ResetNeeded: No episode is running.
            ValueError: The impulse has another shape or isn't finite; nothing has moved.
        """
        if not self._running:
            raise gym.error.ResetNeeded("the episode has ended or not begun; call reset() before push().")
        self._fleet.push(_LANE, impulse)

    def snapshot(self) -> npt.NDArray[np.void]:
        """The whole state, what is going to happen included: one record, shape (1,); see `Fleet.snapshot`."""
        return self._fleet.snapshot()

    def restore(self, rows: npt.NDArray[np.void]) -> Observation:
        """Go on from a `snapshot`, of this environment or another, and return the observation there.

        Raises:
            ValueError: It isn't one record of this scenario's layout; nothing has changed.
        """
        self._fleet.restore(rows)
        # The episodes to come are those of the snapshot as well.
        self._generator = self.np_random
        self._compile_step()
        self._running = not self._fleet.ended[0]
        if self.render_mode is not None:
            self._begin_pictures()
        observation: Observation = self._fleet.observe()[0]
        return observation

    def render(self) -> Any:
        """The picture of the present state, uint8 of shape (height, width, 3), in the mode "rgb_array".

        In the mode "human", in which each `reset` and `step` shows the state by itself, shows it again and returns
        None. In both modes trail, charts and data delivered reach back to the `reset` that follows the first call,
        or to the first call itself.

        Raises:
            ResetNeeded: Nothing has been reset yet.
            DependencyNotInstalled: pygame isn't installed.
            NoDisplayError: There is no display for the mode "human".
        """
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing without a render mode; make the environment with "rgb_array".')
            return None
        if not self._fleet.begun:
            raise gym.error.ResetNeeded("there is nothing to draw yet; call reset() before render().")
        if self.renderer is None:
            self._make_renderer()
        if self.render_mode == "rgb_array":
            return self.renderer.frame()
        self._show()
        return None

    def _make_renderer(self) -> None:
        rendering = import_rendering()
        name = self.spec.id if self.spec is not None else type(self).__name__
        self.renderer = rendering.Renderer(self._fleet.scenario, self.render_size, name)
        self.renderer.begin(self.state(), self.parameters())

    def _begin_pictures(self) -> None:
        if self.renderer is not None:
            self.renderer.configure(self._fleet.scenario)
            self.renderer.begin(self.state(), self.parameters())
        elif self.render_mode == "human":
            self._make_renderer()
        if self.render_mode == "human":
            self._show()

    def _picture(self) -> bool:
        """Take the state into the pictures, if anyone looks at them; returns whether the window has been closed."""
        if self.renderer is not None:
            self.renderer.record(self.state())
        if self.render_mode == "human":
            self._show()
        return self._window is not None and bool(self._window.closed)

    def _show(self) -> None:
        if self._window is None:
            self._window = import_rendering().Window(self.render_size, self.renderer.title)
        if not self._window.closed:
            self._window.show(self.renderer.draw(), self.metadata["render_fps"])

    def close(self) -> None:
        """Close the window, if there is one; the next `reset` in the mode "human" opens another."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def __getstate__(self) -> dict[str, Any]:
        # Pictures belong to the process that draws them.
        unlike = {"renderer": None, "_window": None, "_memory": None, "_measures": None, "_info": None}
        return {**self.__dict__, **unlike}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._read_fleet()
        if self._running:
            self._compile_step()


@lru_cache
def _info_maker(names: tuple[str, ...], arrays: bool) -> Callable[[list[float]], dict[str, Any]]:
    """A function that makes the info of one step from the fleet's measures.

    It is written out from the names as one dict display: anything else takes twice as long at every step.

    Args:
        names: What it is to hold.
        arrays: Whether as arrays of no dimension, instead of plain numbers and flags.
    """
    values = [f"v{i}" for i in range(len(MEASURE_NAMES))]
    shown = [
        f"{name!r}: {values[i]}{' > 0.0' if name in FLAGS else ''}"
        for i, name in enumerate(MEASURE_NAMES)
        if name in names
    ]
    source = f"def info(values):\n    {', '.join(values)} = values\n    return {{{', '.join(shown)}}}\n"
    made: dict[str, Any] = {}
    exec(source, made)
    maker: Callable[[list[float]], dict[str, Any]] = made["info"]
    if arrays:
        return lambda values: {name: np.array(value) for name, value in maker(values).items()}
    return maker
