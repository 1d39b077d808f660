"""Policies by name, file or callable, and flying them through seeded episodes."""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
import sys
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.learning.settings import ALGORITHMS
from uwoc_gym.agents.options import CommandError
from uwoc_gym.agents.policies import saved as inference
from uwoc_gym.baselines import Controller
from uwoc_gym.metrics import EpisodeMetrics, EpisodeRecord, episode_metrics
from uwoc_gym.parameters import Parameters, Range, SettingError, closest
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import SCENARIOS, Scenario
from uwoc_gym.ship import RandomPath
from uwoc_gym.spaces import ACTION_SIZE
from uwoc_gym.vector_env import TrackingVectorEnv

Array = npt.NDArray[np.float64]


class Predictor(Protocol):
    """Anything that decides as a Stable-Baselines3 model does."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions (N, 3) for observations (N, 20), and the policy's memory."""
        ...


@dataclass(frozen=True)
class Policy:
    """A policy that can be flown through any scenario."""

    name: str
    description: str
    make: Callable[[Scenario], Predictor]
    """Builds the policy for a scenario, of which it may use what its designer would know."""
    deterministic: bool = True
    """Whether the same observations always give the same actions."""
    gain_set: str | None = None
    """The gain set of a scripted controller."""
    needs: tuple[str, ...] = ()
    """Optional modules without which it can't fly."""

    def installed(self) -> bool:
        """Whether all that it needs is installed."""
        return all(importlib.util.find_spec(module) is not None for module in self.needs)


def _scripted(gain_set: str, name: str, description: str) -> Policy:
    return Policy(name, description, partial(Controller, gain_set), gain_set=gain_set)


TRAINED = Path(__file__).parent / "trained"
"""The agents that come with the package: a folder each, with ``agent.json`` and ``model.zip``."""


def shipped(folder: Path = TRAINED) -> dict[str, Policy]:
    """The agents in a folder, by name; their models are only loaded when they are to fly."""
    found = {}
    for path in sorted(folder.glob(f"*/{inference.DESCRIPTION}")):
        model = path.with_name("model.zip")
        if model.is_file():
            description = inference.read_description(path)
            needs = (ALGORITHMS[description["algorithm"]].module,)
            make = partial(inference.build, model)
            found[path.parent.name] = Policy(path.parent.name, description["description"], make, needs=needs)
    return found


POLICIES: dict[str, Policy] = {
    policy.name: policy
    for policy in (
        _scripted("paper-pd", "pd", "the paper's PD law as printed, with full feedforward"),
        _scripted(
            "paper-pd-plain", "pd-plain", "the same gains without feedforward, as the paper's PD numbers suggest"
        ),
        _scripted("paper", "nlpd", "the paper's NLPD law, exponents searched to match its nominal results"),
        _scripted("tuned-pd", "pd-tuned", "the PD law with gains searched for the return in Random"),
        _scripted("tuned-nlpd", "nlpd-tuned", "the NLPD law with gains searched for the return in Random"),
    )
} | shipped()
"""The named policies: scripted controllers and shipped agents."""


def load(name: str) -> Policy:
    """The policy of that name, file or callable.

    Args:
        name: A name in `POLICIES`, the folder of a training run (its best model flies), the path of a zip file saved
            by Stable-Baselines3 or sb3-contrib, or "module:callable", which is called with the scenario and returns
            an object with Stable-Baselines3's ``predict``. All but names run code: a saved file holds pickled
            objects, so load only files that you trust. What ``agent.json`` beside a file says is rebuilt: frozen
            normalisation, stacked frames, a controller that is corrected.

    Raises:
        CommandError: There is no such policy, or it can't be loaded.
    """
    if name in POLICIES:
        return POLICIES[name]
    path = Path(name)
    if path.suffix == ".zip" or path.exists():
        return _saved(path)
    if ":" in name:
        return _callable(name)
    raise CommandError(
        f"there is no policy {name!r}; {closest(name, list(POLICIES))} A policy may also be the path of a saved "
        ".zip file or module:callable."
    )


def _callable(name: str) -> Policy:
    module_name, _, attribute = name.partition(":")
    # Console scripts, unlike `python -m`, don't look in the working folder.
    sys.path.insert(0, "")
    try:
        found: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            found = getattr(found, part)
    except Exception as error:
        raise CommandError(f"policy {name!r} can't be imported: {type(error).__name__}: {error}") from None
    finally:
        sys.path.remove("")
    if not callable(found):
        raise CommandError(f"policy {name!r} is not callable; it must take a scenario and return a policy.")

    def make(scenario: Scenario) -> Predictor:
        try:
            made: Any = found(scenario)
        except Exception as error:
            raise CommandError(f"policy {name!r} failed to be made: {type(error).__name__}: {error}") from error
        if not callable(getattr(made, "predict", None)):
            raise CommandError(
                f"policy {name!r} returned a {type(made).__name__} without predict(); it must return an object with "
                "the predict() of Stable-Baselines3."
            )
        return made  # type: ignore[no-any-return]

    return Policy(name, "callable", make, deterministic=False)


# A setting that only models of the class have; the file doesn't name the class itself. The first match counts.
_TELL_TALE = (
    ("tqc", "top_quantiles_to_drop_per_net"),
    ("sac", "target_entropy"),
    ("td3", "policy_delay"),
    ("recurrent_ppo", "_last_lstm_states"),
    ("ppo", "clip_range"),
    ("a2c", "normalize_advantage"),
)


def _saved(path: Path) -> Policy:
    given = str(path)
    if path.is_dir():
        path = path / "model.zip"
    if not path.is_file():
        raise CommandError(f"policy {str(path)!r}: there is no such file.")
    try:
        with zipfile.ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
    except (zipfile.BadZipFile, KeyError, ValueError, OSError):
        raise CommandError(f"policy {str(path)!r} is not a zip file saved by Stable-Baselines3.") from None
    if path.with_name(inference.DESCRIPTION).is_file():
        # Built once to meet errors now rather than in the middle of a benchmark.
        description = inference.read_description(path.with_name(inference.DESCRIPTION))
        inference.check_model(path)
        return Policy(given, description["description"], partial(inference.build, path))
    algorithm = next((name for name, setting in _TELL_TALE if setting in settings), None)
    if algorithm is None:
        known = ", ".join(each.name for each in ALGORITHMS.values())
        raise CommandError(f"policy {str(path)!r} was saved by another algorithm than {known}.")
    model = inference.load_model(path, algorithm)
    inference.check_shapes(str(path), model)
    statistics = inference.normaliser_path(path)
    normalise = inference.load_normaliser(statistics) if statistics.is_file() else None
    agent = inference.Agent(model, normalise)
    return Policy(given, f"saved {ALGORITHMS[algorithm].name} model", lambda scenario: agent)


def load_scenario(name: str) -> tuple[str, Scenario]:
    """A scenario and its short name, from its name, environment ID or JSON file.

    Raises:
        CommandError: There is no such scenario, or the file doesn't hold one.
    """
    short = ENV_IDS.get(name, name)
    if short in SCENARIOS:
        return short, SCENARIOS[short]
    path = Path(name)
    if path.suffix != ".json" and not path.is_file():
        hint = closest(name, [*SCENARIOS, *ENV_IDS])
        raise CommandError(f"there is no scenario {name!r}; {hint} A scenario may also be the path of a .json file.")
    try:
        return path.stem, Scenario.from_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CommandError(f"scenario {name!r} can't be read: {error.strerror}.") from None
    except (SettingError, UnicodeDecodeError) as error:
        raise CommandError(f"scenario {name!r} is not allowed: {error}") from None


def draws(scenario: Scenario) -> bool:
    """Whether episodes of the scenario differ from seed to seed."""
    noise = [scenario.sea.current.std_mps, *(value for _, value in scenario.sensors.numbers())]
    return (
        _has_range(scenario)
        or len(scenario.ship_paths) > 1
        or any(isinstance(path, RandomPath) for path in scenario.ship_paths)
        or any(value != 0.0 for value in noise)
    )


def _has_range(value: Any) -> bool:
    if isinstance(value, Range):
        return True
    if isinstance(value, Parameters):
        return any(_has_range(getattr(value, name)) for name in value.specs())
    return isinstance(value, tuple) and any(_has_range(item) for item in value)


@dataclass(frozen=True, kw_only=True)
class Series:
    """What one episode looked like, one sample per control period."""

    time_s: Array
    pose: Array
    """(T + 1, 3) [m, m, rad]."""
    ship_pose: Array
    """(T + 1, 3) [m, m, rad]."""
    range_m: Array
    pointing_error_rad: Array
    bit_rate_bps: Array
    slant_height_m: float
    depth_m: float
    disturbance_s: float
    """Start of the first disturbance [s]; nan if there is none."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """The episodes of one policy in one scenario."""

    seeds: tuple[int, ...]
    metrics: EpisodeMetrics
    record: EpisodeRecord
    series: Series
    """The first episode."""
    extra: dict[str, Array]
    """Further entries of the true state that were asked for, each of shape (T + 1, N, ...)."""


def _disturbances(parameters: dict[str, Array], size: int) -> Array:
    """When the first pulse of each simulation begins [s]; nan where there is none."""
    starts = [values for path, values in parameters.items() if path.startswith("sea.pulses") and "start_s" in path]
    return np.min(starts, axis=0) if starts else np.full(size, math.nan)


_RECORDED = ("in_cone", "pose", "ship_pose", "bit_rate_bps")


def fly(
    policy: Policy,
    scenario: Scenario,
    seeds: Sequence[int],
    parameters: Mapping[str, npt.ArrayLike] | None = None,
    extra: Sequence[str] = (),
) -> Flight:
    """Fly one episode per seed, all together, on observations alone.

    Args:
        policy: What decides.
        scenario: What is flown.
        seeds: Seeds of the N episodes.
        parameters: Numbers to take instead of drawing them, as in `TrackingVectorEnv.reset`.
        extra: Names of entries of `TrackingVectorEnv.state` to record besides what the measures need.

    Raises:
        ValueError: One of ``parameters`` isn't allowed.
        CommandError: The policy gives actions of another shape or that aren't finite.
    """
    size, steps = len(seeds), scenario.episode.steps
    predictor = policy.make(scenario)
    # After its end a simulation begins anew, which is ignored: the others still need their steps.
    env = TrackingVectorEnv(size, scenario)
    observations, _ = env.reset(seed=list(seeds), options={"parameters": parameters})
    state = env.state()
    tracks = {name: np.zeros((steps + 1, *state[name].shape), state[name].dtype) for name in (*_RECORDED, *extra)}
    first = {name: np.zeros(steps + 1) for name in ("range_m", "pointing_error_rad")}
    force, reward = np.zeros((steps, size, 3)), np.zeros((steps, size))
    valid = np.zeros((steps + 1, size), dtype=bool)
    alive, lost, begun = np.ones(size, dtype=bool), np.zeros(size, dtype=bool), np.ones(size, dtype=bool)
    disturbance = _disturbances(env.parameters(), size)
    slant, depth = float(state["slant_height_m"][0]), float(state["depth_m"][0])
    rewards, terminated, truncated = np.zeros(size), np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
    memory: Any = None
    for step in range(steps + 1):
        for name, track in tracks.items():
            track[step] = state[name]
        for name, column in first.items():
            column[step] = state[name][0]
        valid[step] = alive
        if step > 0:
            force[step - 1] = state["force"]
            reward[step - 1] = rewards
            lost |= alive & terminated
            alive = alive & ~(terminated | truncated)
        if step == steps or not alive.any():
            break
        actions, memory = decide(policy, predictor, observations, memory, begun)
        actions = np.where(alive[:, None], actions, np.float32(0.0))
        observations, rewards, terminated, truncated, _ = env.step(actions)
        begun = terminated | truncated
        state = env.state()
    env.close()
    record = EpisodeRecord(
        time_s=np.arange(steps + 1, dtype=np.float64) * scenario.episode.control_period_s,
        **{name: tracks[name] for name in _RECORDED},
        force=force,
        reward=reward,
        valid=valid,
        lost=lost,
        disturbance_s=disturbance,
        force_limits=scenario.vehicle.force_limits,
    )
    own = valid[:, 0]
    series = Series(
        time_s=record.time_s[own],
        pose=record.pose[own, 0],
        ship_pose=record.ship_pose[own, 0],
        range_m=first["range_m"][own],
        pointing_error_rad=first["pointing_error_rad"][own],
        bit_rate_bps=record.bit_rate_bps[own, 0],
        slant_height_m=slant,
        depth_m=depth,
        disturbance_s=float(disturbance[0]),
    )
    return Flight(
        seeds=tuple(seeds),
        metrics=episode_metrics(record),
        record=record,
        series=series,
        extra={name: tracks[name] for name in extra},
    )


def decide(
    policy: Policy, predictor: Predictor, observations: Any, memory: Any, begun: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.float32], Any]:
    """Actions (N, 3) for observations (N, 20), and the policy's memory.

    Raises:
        CommandError: The policy fails, or gives something else than finite actions of that shape and its memory.
    """
    try:
        found = predictor.predict(observations, state=memory, episode_start=begun, deterministic=True)
    except Exception as error:
        raise CommandError(f"policy {policy.name!r} failed: {type(error).__name__}: {error}") from error
    if not isinstance(found, tuple) or len(found) != 2:
        raise CommandError(f"policy {policy.name!r} gave a {type(found).__name__}; it must give (actions, memory).")
    size = len(observations)
    try:
        array = np.asarray(found[0], dtype=np.float32)
    except (TypeError, ValueError):
        array = np.empty(0, dtype=np.float32)
    if array.shape != (size, ACTION_SIZE) or not np.isfinite(array).all():
        raise CommandError(
            f"policy {policy.name!r} gave actions of shape {array.shape}"
            f"{'' if np.isfinite(array).all() else ' that are not all finite'}; they must be finite and of shape "
            f"({size}, {ACTION_SIZE})."
        )
    return array, found[1]


def batches(seeds: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    """The seeds in groups of at most ``size``."""
    for start in range(0, len(seeds), size):
        yield seeds[start : start + size]
