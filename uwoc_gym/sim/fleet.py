"""N simulations as arrays: reset, step, observe, reward. The only place where time passes.

All environments are thin shells over `Fleet`. Its simulations lie in blocks of 32 lanes (see `records`), in one array;
one compiled function advances any number of blocks, with everything inside (see `paper`). A lane's episode is a pure
function of its seed and episode number, so it is the same bit for bit on any batch size.
"""

from __future__ import annotations

import enum
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.records import LANES, STRIDE
from uwoc_gym.compute.rng import key_from_seed
from uwoc_gym.given import as_number, as_numbers, closest, count, is_sequence, scalar, shown
from uwoc_gym.parameters import FARTHEST_M
from uwoc_gym.scenario import Scenario
from uwoc_gym.sim import layout, paper
from uwoc_gym.sim.layout import FIRST_OUT, OUT_ROWS, ROW, Drawn
from uwoc_gym.task.reward import TERM
from uwoc_gym.world.auv.horizontal import FASTEST
from uwoc_gym.world.ship.paths import CARRIED_ON

Array = npt.NDArray[np.float64]
Lanes = npt.NDArray[np.int64]


class Autoreset(enum.IntEnum):
    """What happens to a simulation after its episode has ended."""

    DISABLED = 0
    NEXT_STEP = 1
    SAME_STEP = 2


class Rollout(NamedTuple):
    """What flights of K copies came to, each of shape (K,)."""

    returns: Array
    """Sum of the rewards until the horizon or the flight's end."""
    last_reward: Array
    """Reward of the last step flown."""
    last_distance_m: Array
    """Horizontal distance to the ship after it [m]."""
    steps_in_link: npt.NDArray[np.int64]
    """Steps that ended inside the cone."""


class Fleet:
    """N simulations of one scenario, advanced together.

    Args:
        scenario: What to simulate.
        size: Number of simulations N.
        autoreset: What happens after an episode's end.
        max_episode_steps: Steps after which an episode is truncated; by default the scenario's duration.
        threads: Threads that share the blocks of 32 simulations; worth it from several thousand simulations on.

    Raises:
        ValueError: ``size``, ``threads`` or ``max_episode_steps`` isn't a whole number within its bounds
            (`uwoc_gym.given.LIMITS`).
    """

    def __init__(
        self,
        scenario: Scenario,
        size: int,
        autoreset: Autoreset = Autoreset.DISABLED,
        max_episode_steps: int | None = None,
        threads: int = 1,
    ) -> None:
        if not isinstance(scenario, Scenario):
            raise ValueError(f"scenario = {shown(scenario)} is not allowed; it must be a Scenario.")
        self.size = count("size", size, "environments")
        self.threads = count("threads", threads)
        if max_episode_steps is not None:
            max_episode_steps = count("max_episode_steps", max_episode_steps)
        self.autoreset = Autoreset(autoreset)
        self._blocks = -(-self.size // LANES)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_of = 0
        self._seeded = np.zeros(self.size, dtype=bool)
        self._unused = np.zeros((0, 0), dtype=np.float32)
        self.configure(scenario, max_episode_steps)

    def configure(self, scenario: Scenario, max_episode_steps: int | None = None) -> None:
        """Change the scenario; nothing but seeds and episode numbers is left, so reset all simulations."""
        self.scenario = scenario
        self.max_episode_steps = max_episode_steps or scenario.episode.steps
        old: layout.Memory | None = getattr(self, "_memory", None)
        self._memory = layout.build(scenario, self.size, self.max_episode_steps, self.autoreset)
        self._drawn = _drawn(scenario)
        self._state = _Entries.of(_state_rows(scenario))
        if old is not None:
            # Seeds and episodes go on. All else is 0, since nothing writes the rows of an effect that doesn't act.
            self._memory.blocks["random"]["all"] = old.blocks["random"]["all"]
        self._memory.blocks["origin"]["scenario"] = self._origin = layout.origin(scenario)

    def _get(self, group: str, name: str) -> Array:
        """A copy of one row of the blocks over all simulations, shape (N,)."""
        row: Array = self._memory.blocks[group][name][:, :LANES].reshape(-1)[: self.size]
        return row.copy()

    def _set(self, group: str, name: str, lanes: Lanes, values: npt.ArrayLike) -> None:
        self._memory.blocks[group][name][lanes // LANES, lanes % LANES] = values

    @property
    def single(self) -> Array:
        """A live view of the measures of simulation 0, shape (measures,), in the order of `MEASURE_NAMES`."""
        return self._memory.rows[0, FIRST_OUT : FIRST_OUT + OUT_ROWS, 0]

    @property
    def memory(self) -> Array:
        """All that the fleet consists of, settings included, as compiled code is given it (see `layout`)."""
        return self._memory.array

    def seed(self, lanes: npt.NDArray[np.int64], seeds: list[int]) -> None:
        """Give simulations their seeds; their next reset begins episode 0."""
        keys = np.array([key_from_seed(seed) for seed in seeds], dtype=float).reshape(-1, 2)
        self._set("random", "key_0", lanes, keys[:, 0])
        self._set("random", "key_1", lanes, keys[:, 1])
        self._set("random", "episode", lanes, -1.0)
        self._seeded[lanes] = True

    def reset(
        self,
        observations: npt.NDArray[np.float32],
        lanes: npt.NDArray[np.int64] | None = None,
        pose: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
        parameters: Mapping[str, npt.ArrayLike] | None = None,
    ) -> None:
        """Begin the next episode of each of ``lanes`` (all by default) and write its observation.

        Args:
            observations: Written to, shape (N, size); other lanes' rows stay.
            lanes: Indices of the simulations to reset.
            pose: Start pose, shape (3,) or (N, 3) [m, m, rad] in the earth frame, instead of the scenario's.
            velocity: Start velocity, shape (3,) or (N, 3) [m/s, m/s, rad/s], instead of the scenario's.
            parameters: Numbers to take instead of drawing them, by their names in `drawn`: one, or one per
                simulation. Each must lie in the range that the scenario draws from.

        Raises:
            ValueError: ``pose`` or ``velocity`` has another shape or isn't finite, or one of ``parameters`` is unknown,
                of another shape or out of range; nothing has changed.
        """
        which = self._which(lanes)
        if not self._seeded[which].all():
            raise ValueError("every simulation needs a seed before its first reset.")
        if observations.shape != (self.size, self.scenario.observation.size) or observations.dtype != np.float32:
            raise ValueError(
                f"observations have shape {observations.shape} and type {observations.dtype}; they must be of shape "
                f"({self.size}, {self.scenario.observation.size}) and float32."
            )
        poses = self._start_values("options['pose']", pose, 3)
        velocities = self._start_values("options['velocity']", velocity, 3)
        if velocity is not None:
            _check_velocity(self.scenario, "options['velocity']", velocity, velocities)
        numbers, values, paths = self._chosen({} if parameters is None else parameters, self._drawn)
        rows, only = (np.array([getattr(each, name) for each in numbers], dtype=np.int64) for name in ("row", "only"))
        self._set("random", "episode", which, self._get("random", "episode")[which] + 1.0)
        paper.reset(self._memory.array, which, 0.0, poses, velocities, paths, rows, only, values, observations)

    def check_start(
        self,
        scenario: Scenario,
        pose: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
        parameters: Mapping[str, npt.ArrayLike] | None = None,
    ) -> None:
        """Refuse what `reset` would refuse once the fleet is configured for a scenario, and change nothing.

        Raises:
            ValueError: As of `reset`.
        """
        if pose is not None:
            self._start_values("options['pose']", pose, 3)
        if velocity is not None:
            own = self._start_values("options['velocity']", velocity, 3)
            _check_velocity(scenario, "options['velocity']", velocity, own)
        if parameters is not None:
            known = self._drawn if scenario is self.scenario else _drawn(scenario)
            self._chosen(parameters, known)

    def _which(self, lanes: npt.ArrayLike | None) -> Lanes:
        """The simulations meant.

        Raises:
            ValueError: They aren't whole numbers below N.
        """
        if lanes is None:
            return np.arange(self.size)
        given = as_numbers(lanes)
        if given is None or given.ndim > 1 or not ((given >= 0) & (given < self.size) & (given == given // 1)).all():
            raise ValueError(
                f"lanes = {shown(lanes)} is not allowed; it must be whole numbers from 0 to {self.size - 1}."
            )
        return np.atleast_1d(given).astype(np.int64)

    @property
    def lane_type(self) -> np.dtype[Any]:
        """The record of the whole state of one simulation, which `snapshot` gives and `restore` takes."""
        return layout.lane_record(self.scenario)

    def snapshot(self, lanes: npt.ArrayLike | None = None) -> npt.NDArray[np.void]:
        """The whole state of simulations, what they have drawn and are going to draw included.

        Args:
            lanes: Indices of n simulations, by default all.

        Returns:
            Records of `lane_type`, shape (n,), whose fields can be read by name, as in ``rows["auv"]["x"]``.

        Raises:
            ValueError: ``lanes`` isn't allowed.
        """
        which = self._which(lanes)
        rows = np.ascontiguousarray(self._memory.rows[which // LANES, :, which % LANES])
        return rows.view(self.lane_type)[:, 0]

    def restore(self, rows: npt.NDArray[np.void], lanes: npt.ArrayLike | None = None) -> None:
        """Put simulations into a state from `snapshot`, of this fleet or another; they go on from it bit for bit.

        The other fleet's scenario must be the same: what it doesn't draw, such as limits and the reward, isn't part of
        the state.

        Args:
            rows: Records of `lane_type`, one for each of ``lanes`` or one for all of them.
            lanes: Indices of n simulations, by default all.

        Raises:
            ValueError: ``lanes`` isn't allowed, there are neither one nor n rows, or they are damaged, of another
                scenario or of another version; nothing has changed.
        """
        which = self._which(lanes)
        numbers = self._numbers_of(rows, which.size)
        self._let_flow(numbers[:, layout.CURRENT])
        self._memory.rows[which // LANES, :, which % LANES] = numbers
        self._seeded[which] = True

    def _numbers_of(self, rows: npt.NDArray[np.void], count: int) -> Array:
        """Records as plain numbers, shape (1 or count, rows)."""
        if not isinstance(rows, np.ndarray) or rows.dtype != self.lane_type:
            raise ValueError(
                "rows are not of this fleet's layout; they must come from the snapshot() of a fleet whose scenario has "
                f"{len(self.scenario.sea.pulses)} pulses, in this version of the package."
            )
        if rows.shape not in ((), (1,), (count,)):
            raise ValueError(f"rows have shape {rows.shape}; it must be (1,) or ({count},).")
        flat = np.ascontiguousarray(np.atleast_1d(rows)).view(np.float64)
        numbers = flat.reshape(-1, self._memory.rows.shape[1])
        if not (numbers[:, layout.ORIGIN] == self._origin).all():
            raise ValueError(
                "rows are of another scenario; they must come from the snapshot() of a fleet with all of this one's "
                "settings."
            )
        # Compiled code takes these for places in its memory.
        first, own = numbers[:, layout.SEGMENTS].T
        if not ((first >= 0.0) & (own >= 0.0) & (first + own <= self._memory.segments)).all():
            raise ValueError("rows are damaged: they have a ship on a path that this fleet doesn't know.")
        return numbers

    def _let_flow(self, water: Array) -> None:
        """Let currents act if there are any in what is believed or restored."""
        if water.any():
            self._memory.world["current"]["acts"] = 1.0

    def believe(
        self,
        lanes: npt.ArrayLike | None = None,
        *,
        pose: npt.ArrayLike,
        velocity: npt.ArrayLike,
        ship_pose: npt.ArrayLike,
        ship_velocity: npt.ArrayLike,
        ship_turn_rad_s: npt.ArrayLike = 0.0,
        current: npt.ArrayLike = (0.0, 0.0),
        time_s: float = 0.0,
    ) -> None:
        """Put simulations where they are believed to be, without anything that only the simulator knows.

        Best on a fleet of `Scenario.known`: all that isn't believed is what its scenario says. The ship's motion is
        carried on (see `CarriedOnPath`), the current stays as it is. Arguments but the time are for all simulations, or
        one a simulation with a first axis of length N.

        Args:
            lanes: Indices of the simulations, by default all.
            pose: The AUV's x, y and yaw in the earth frame, (3,) [m, m, rad].
            velocity: Its surge, sway and yaw rate, (3,) [m/s, m/s, rad/s].
            ship_pose: The ship's x, y and yaw, (3,) [m, m, rad].
            ship_velocity: Its velocity along x and y and its yaw rate, (3,) [m/s, m/s, rad/s].
            ship_turn_rad_s: Rate at which its course turns [rad/s].
            current: Velocity of the water in the earth frame, (2,) [m/s].
            time_s: Time in the episode [s], one for all, which is taken to the nearest whole control period.

        Raises:
            ValueError: An argument has another shape or isn't finite; nothing has changed.
        """
        which = self._which(lanes)
        poses = self._start_values("pose", pose, 3)
        velocities = self._start_values("velocity", velocity, 3)
        _check_velocity(self.scenario, "velocity", velocity, velocities)
        ship_poses = self._start_values("ship_pose", ship_pose, 3)
        ship_velocities = self._start_values("ship_velocity", ship_velocity, 3)
        water = self._start_values("current", current, 2)
        turn = as_numbers(ship_turn_rad_s, (), (self.size,))
        if turn is None:
            raise ValueError(
                f"ship_turn_rad_s = {shown(ship_turn_rad_s)} is not allowed; it must be a finite number or of shape "
                f"({self.size},)."
            )
        moment = as_number(time_s)
        period = self.scenario.episode.control_period_s
        # Beyond that doubles don't count whole periods any more.
        if moment is None or not 0.0 <= moment <= 2.0**53 * period:
            raise ValueError(f"time_s = {shown(time_s)} is not allowed; it must be a finite number of at least 0 [s].")
        step = round(moment / period)
        numbers = {
            "drawn.current.speed_mps": np.hypot(*water.T),
            "drawn.current.direction_rad": np.arctan2(water[:, 1], water[:, 0]),
            "drawn.current.std_mps": 0.0,
            "drawn.ship.kind": CARRIED_ON,
            "drawn.ship.x_m": ship_poses[:, 0],
            "drawn.ship.y_m": ship_poses[:, 1],
            "drawn.ship.course_rad": np.arctan2(ship_velocities[:, 1], ship_velocities[:, 0]),
            "drawn.ship.speed_mps": np.hypot(*ship_velocities[:, :2].T),
            "drawn.ship.turn_rad_s": turn,
            "drawn.ship.yaw_rad": ship_poses[:, 2],
            "drawn.ship.yaw_rate_rad_s": ship_velocities[:, 2],
            "drawn.ship.moment_s": step * period,
        }
        self._let_flow(water)
        rows = np.array([layout.ROW[name] for name in numbers])
        only = np.full(rows.size, -1)
        values = np.array([np.broadcast_to(value, self.size) for value in numbers.values()])
        unseen = np.empty((self.size, self.scenario.observation.size), dtype=np.float32)
        paths = np.zeros(self.size)
        paper.reset(self._memory.array, which, float(step), poses, velocities, paths, rows, only, values, unseen)

    def rollout(self, rows: npt.NDArray[np.void], actions: npt.ArrayLike) -> Rollout:
        """Fly copies of states through actions, without observations and without touching the fleet's simulations.

        A copy whose episode ends earns nothing more; the others fly on.

        Args:
            rows: Where flights begin: records of `lane_type` from `snapshot`, one for all or one for each.
            actions: Shape (K, H, 3) for K flights of up to H control periods; clipped to [-1, 1].

        Raises:
            ValueError: ``rows`` have another layout or number, or the actions another shape or aren't finite.
        """
        finite = as_numbers(actions)
        if finite is None or finite.ndim != 3 or finite.shape[2] != len(self.scenario.actions):
            raise ValueError(
                f"actions = {shown(actions)} are not allowed; they must be finite and of shape "
                f"(K, H, {len(self.scenario.actions)})."
            )
        given = np.clip(finite, -1.0, 1.0).astype(np.float32)
        count = len(given)
        found = Rollout(np.empty(count), np.empty(count), np.empty(count), np.empty(count, dtype=np.int64))
        scratch = np.zeros(self._memory.rows.shape[1] * STRIDE)
        in_time = np.ascontiguousarray(given.transpose(1, 0, 2))
        roots = self._numbers_of(rows, count)
        self._let_flow(roots[:, layout.CURRENT])
        paper.rollout(self._memory.array, scratch, roots, in_time, *found)
        return found

    def _chosen(
        self, parameters: Mapping[str, npt.ArrayLike], known: Mapping[str, Drawn]
    ) -> tuple[list[Drawn], Array, Array]:
        """The numbers that aren't to be drawn, their values by simulation, and the ship's paths by simulation."""
        if not isinstance(parameters, Mapping) or not all(isinstance(name, str) for name in parameters):
            raise ValueError(
                f"options['parameters'] = {shown(parameters)} is not allowed; it must be a mapping of names."
            )
        numbers: list[Drawn] = []
        values = np.zeros((len(parameters), self.size))
        alternatives = np.full(self.size, -1.0)
        for i, (name, value) in enumerate(parameters.items()):
            field = f"options['parameters'][{shown(name)}]"
            if name not in known:
                raise ValueError(f"{field} is not known; {closest(name, known)}")
            own = known[name]
            coded = _coded(value, own) if own.options else value
            found = as_numbers(coded, (), (self.size,))
            array = np.empty(0) if found is None else found
            fits = (own.low <= array) & (array <= own.high)
            if own.mask:
                fits &= np.isin(array, [place for place in range(own.mask.bit_length()) if own.mask >> place & 1])
            if found is None or not fits.all():
                shapes = "a number" if self.size == 1 else f"a number or of shape ({self.size},)"
                allowed = f"in the range [{own.low:g}, {own.high:g}] that the scenario draws it from"
                if own.options:
                    shapes = shapes.replace("a number", "a name")
                    allowed = "one of " + ", ".join(repr(name) for name in own.allowed)
                elif own.mask:
                    allowed = f"a whole one from 0 to {own.high:g}, the place of one of the scenario's alternatives"
                raise ValueError(f"{field} = {shown(value)} is not allowed; it must be {shapes}, {allowed}.")
            values[i] = array
            if name == "ship":
                alternatives[:] = array
            numbers.append(own)
        return numbers, values, alternatives

    @property
    def begun(self) -> bool:
        """Whether any simulation has been reset."""
        return bool((self._get("random", "episode")[self._seeded] >= 0.0).any())

    @property
    def ended(self) -> npt.NDArray[np.bool_]:
        """Whether each simulation's episode is over, shape (N,)."""
        return self._get("ending", "ended") > 0.0

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """Whether the integrator couldn't follow each simulation in the last step, shape (N,)."""
        return self._get("ending", "diverged") > 0.0

    def push(self, lanes: npt.NDArray[np.int64], impulse: npt.ArrayLike) -> None:
        """Change the AUVs' velocities at once, by an impulse over their true masses.

        Args:
            lanes: Indices of the simulations to push.
            impulse: Along surge, along sway and about yaw, shape (3,) [N s, N s, N m s].

        Raises:
            ValueError: The impulse has another shape or isn't finite, or is stronger than the integrator can follow;
                nothing has moved.
        """
        given = as_numbers(impulse, (3,))
        if given is None:
            raise ValueError(f"impulse = {shown(impulse)} is not allowed; it must be finite and of shape (3,).")
        velocities = ("surge", "sway", "yaw_rate")
        inverses = ("inverse_surge", "inverse_sway", "inverse_yaw")
        after = np.stack(
            [
                self._get("auv", velocity)[lanes] + own * self._get("auv", inverse)[lanes]
                for own, velocity, inverse in zip(given, velocities, inverses, strict=True)
            ],
            axis=-1,
        )
        _check_velocity(self.scenario, "impulse", impulse, after)
        for name, own in zip(velocities, after.T, strict=True):
            self._set("auv", name, lanes, own)

    def _start_values(self, name: str, value: npt.ArrayLike | None, width: int) -> Array:
        if value is None:
            return np.full((self.size, width), np.nan)
        array = as_numbers(value, (width,), (self.size, width))
        if array is None:
            shapes = f"({width},)" if self.size == 1 else f"({width},) or ({self.size}, {width})"
            raise ValueError(f"{name} = {shown(value)} is not allowed; it must be finite and of shape {shapes}.")
        if np.abs(array).max(initial=0.0) > FARTHEST_M:
            raise ValueError(
                f"{name} = {shown(value)} is not allowed; its numbers must be within [{-FARTHEST_M:g}, {FARTHEST_M:g}]."
            )
        # A copy: Numba compiles anew for views that can't be written to.
        return np.array(np.broadcast_to(array, (self.size, width)), order="C")

    def observe(self) -> npt.NDArray[np.float32]:
        """The present observation of every simulation, noise included, shape (N, size)."""
        observations = np.empty((self.size, self.scenario.observation.size), dtype=np.float32)
        paper.look(self._memory.array, observations)
        return observations

    def step(
        self,
        actions: npt.NDArray[np.float32],
        observations: npt.NDArray[np.float32],
        out: Array,
        flags: npt.NDArray[np.bool_],
        finals: npt.NDArray[np.float32] | None = None,
    ) -> int:
        """Advance every simulation by one control period.

        The arrays' shapes and types are the caller's promise: at this rate of calls they aren't checked.

        Args:
            actions: Shape (N, 3), float32; clipped to [-1, 1] and scaled by the actuators' limits.
            observations: Written to, shape (N, size), float32.
            out: Written to, shape (measures, N): the measures before any autoreset, in the order of `MEASURE_NAMES`.
            flags: Written to, shape (flags, N): those that are true or false, in the order of `FLAGS`.
            finals: Written to where a simulation ended and began anew in this step, shape (N, size), float32.

        Returns:
            How many episodes ended in this step.

        Raises:
            ValueError: An action isn't finite; nothing has moved.
            RuntimeError: An episode has ended and autoreset is disabled; nothing has moved.
        """
        last_observations = self._unused if finals is None else finals
        arguments = (self._memory.array, actions, observations, out, flags, last_observations)
        if self.threads == 1 or self._blocks == 1:
            ends: int = paper.step(*arguments, 0, self.size)
        else:
            ends = self._step_in_threads(arguments)
        if ends < 0:
            self.refuse(ends, actions)
        return ends

    def _step_in_threads(self, arguments: tuple[Any, ...]) -> int:
        if not np.isfinite(arguments[1]).all():
            return paper.NOT_FINITE
        if self.autoreset is Autoreset.DISABLED and self.ended.any():
            return paper.HAS_ENDED
        if self._pool is None or self._pool_of != os.getpid():
            # A pool's threads don't live on in a forked process.
            self._pool, self._pool_of = ThreadPoolExecutor(self.threads), os.getpid()
        share = -(-self._blocks // self.threads) * LANES
        starts = range(0, self.size, share)
        step: Callable[..., int] = paper.step
        jobs = [self._pool.submit(step, *arguments, start, min(start + share, self.size)) for start in starts]
        return sum(job.result() for job in jobs)

    def refuse(self, status: int, actions: npt.NDArray[np.float32]) -> None:
        """Raise what a negative status of `paper.step` or `paper.step_one` means; see `step`."""
        if status == paper.NOT_FINITE:
            index = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ValueError(
                f"action {actions[index].tolist()} of simulation {index} is not allowed; it must be finite "
                "(numbers beyond [-1, 1] are clipped)."
            )
        ended = np.flatnonzero(self.ended).tolist()
        raise RuntimeError(f"the episodes of simulations {ended[:10]} have ended; reset them before stepping on.")

    def close(self) -> None:
        """End the threads, if there are any."""
        if self._pool is not None and self._pool_of == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_memory": self._memory.array}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._memory = layout.view(state["_memory"])

    def measures(self) -> Array:
        """The present measures of all simulations, shape (measures, N), in the order of `MEASURE_NAMES`."""
        rows = self._memory.rows[:, FIRST_OUT : FIRST_OUT + OUT_ROWS]
        return rows.transpose(1, 0, 2).reshape(OUT_ROWS, -1)[:, : self.size].copy()

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The true state by name, each with a first axis of length N; see `TrackingEnv.state` for the entries."""

        told = self._told(self._state)
        told["in_cone"] = told["in_cone"] > 0.0
        return told

    def terms(self) -> dict[str, Array]:
        """The terms of the last step's reward by name, weighted, each of shape (N,).

        They add up to the reward. At an episode's beginning, when nothing has been paid, they are what a step that ends
        there would pay.
        """
        return self._told(_TERMS)

    def _told(self, told: _Entries) -> dict[str, npt.NDArray[Any]]:
        """Copies of rows over all simulations: (N,) for an entry of one row, (N, rows) for one of several."""
        # All at once: row by row takes five times as long.
        rows = self._memory.rows[:, told.numbers, :LANES].transpose(1, 0, 2)
        found = rows.reshape(told.numbers.size, -1)[:, : self.size]
        return {
            name: found[first].copy() if last == first + 1 else found[first:last].T.copy(order="C")
            for name, first, last in told.places
        }

    def drawn(self) -> dict[str, npt.NDArray[Any]]:
        """What the present episodes have drawn for each number and choice, by its path, each of shape (N,).

        ``ship`` is the place of the path among the scenario's. Of paths that an episode doesn't follow, numbers are
        not a number and choices empty.
        """
        memory = self._memory
        rows = memory.rows.transpose(1, 0, 2).reshape(memory.rows.shape[1], -1)[:, : self.size]
        followed = rows[self._drawn["ship"].row]
        found: dict[str, npt.NDArray[Any]] = {}
        for path, own in self._drawn.items():
            mine = (own.only < 0) | (own.only == followed)
            if own.options:
                names = np.array([*own.options, ""])
                found[path] = names[np.where(mine, rows[own.row], -1).astype(int)]
            else:
                found[path] = np.where(mine, rows[own.row], np.nan)
        return found


class _Entries(NamedTuple):
    """What is told by name."""

    numbers: Lanes
    """Numbers of all rows."""
    places: list[tuple[str, int, int]]
    """Name, and first place among those numbers and the one behind the last, of each entry."""

    @classmethod
    def of(cls, rows: Mapping[str, tuple[str, ...]]) -> _Entries:
        """Those of the rows, by their dotted names, of each entry."""
        lasts = np.cumsum([len(own) for own in rows.values()]).tolist()
        places = [(name, last - len(own), last) for (name, own), last in zip(rows.items(), lasts, strict=True)]
        return cls(np.array([ROW[row] for own in rows.values() for row in own]), places)


_TERMS = _Entries.of({name: (f"term.{name}",) for name in TERM})
"""The reward's terms."""


def _state_rows(scenario: Scenario) -> dict[str, tuple[str, ...]]:
    """The rows of each entry of `Fleet.state`."""
    measured = [name for name in layout.info_names(scenario) if name in layout.OUT["measure"]]
    return {
        "time_s": ("clock.time_s",),
        "pose": ("auv.x", "auv.y", "auv.yaw"),
        "velocity": ("auv.surge", "auv.sway", "auv.yaw_rate"),
        "depth_m": ("link.depth_m",),
        "ship_pose": ("ship.x", "ship.y", "ship.yaw"),
        "ship_velocity": ("ship.vx", "ship.vy", "ship.yaw_rate"),
        "ship_acceleration": ("ship.ax", "ship.ay", "ship.yaw_acceleration"),
        "current": ("current.x", "current.y"),
        "force": ("auv.force_surge", "auv.force_sway", "auv.moment_yaw"),
        **{name: (f"measure.{name}",) for name in measured if name != "in_cone"},
        "in_cone": ("measure.in_cone",),
        "slant_height_m": ("link.slant_height_m",),
    }


def _drawn(scenario: Scenario) -> dict[str, Drawn]:
    """The numbers and choices that episodes of a scenario may draw, by their paths."""
    return {each.path: each for each in layout.drawn_numbers(scenario) if each.path}


def _check_velocity(scenario: Scenario, name: str, given: Any, velocities: Array) -> None:
    """Refuse what gives AUVs velocities, shape (n, 3), that the integrator can't follow."""
    fastest = np.abs(velocities).max(axis=0, initial=0.0)
    episode, motion = scenario.episode, scenario.motion
    rate = motion.rate_at(fastest)
    longest = motion.longest_step(rate)
    if (fastest <= motion.velocity).all() or (episode.integration_step_s <= longest and (fastest <= FASTEST).all()):
        return
    raise ValueError(
        f"{name} = {shown(given)} is not allowed: at {fastest.tolist()} [m/s, m/s, rad/s] the motion changes at up to "
        f"{rate:.3g} 1/s, which the integrator doesn't follow in steps of {episode.integration_step_s:g} s; the steps "
        f"must be at most {episode.step_within(longest)!r} s, or the velocity slower."
    )


def _coded(value: Any, own: Drawn) -> Any:
    """Places of the names that were chosen; None for what can't be."""
    places: dict[Any, float] = {name: float(place) for place, name in enumerate(own.options)}

    def place(name: Any) -> float | None:
        plain = scalar(name)
        return places.get(plain) if isinstance(plain, str) else None

    return [place(name) for name in value] if is_sequence(value) else place(value)
