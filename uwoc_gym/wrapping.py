"""Wrappers around our environments: those of single ones and those of vector ones, and what is true behind them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper

from uwoc_gym.env import TrackingEnv
from uwoc_gym.given import shown
from uwoc_gym.scenario import Scenario
from uwoc_gym.vector_env import TrackingVectorEnv

Wrapper = Callable[[Any], Any]
"""What takes an environment and returns it wrapped."""


def for_vectors(wrapper: Wrapper) -> bool:
    """Whether a wrapper goes around vector environments: a `VectorWrapper`, or a callable that says ``vector = True``.

    All others go around each single environment.
    """
    own = isinstance(wrapper, type) and issubclass(wrapper, VectorWrapper)
    return own or bool(getattr(wrapper, "vector", False))


def split(wrappers: Sequence[Wrapper]) -> tuple[list[Wrapper], list[Wrapper]]:
    """The wrappers of single environments and those of vector ones, innermost first.

    Raises:
        ValueError: One of a single environment stands behind one of a vector environment.
    """
    vectors = [for_vectors(each) for each in wrappers]
    first = vectors.index(True) if True in vectors else len(wrappers)
    if not all(vectors[first:]):
        late = next(each for each in wrappers[first:] if not for_vectors(each))
        raise ValueError(
            f"wrappers = {shown([name_of(each) for each in wrappers])} is not allowed: {name_of(late)} goes around "
            "single environments, and must stand before those that go around vector environments."
        )
    return list(wrappers[:first]), list(wrappers[first:])


def name_of(wrapper: Wrapper) -> str:
    """What a wrapper is called."""
    inner = wrapper.func if isinstance(wrapper, partial) else wrapper
    return str(getattr(inner, "__qualname__", type(inner).__name__))


def wrap(env: Any, wrappers: Sequence[Wrapper]) -> Any:
    """The environment in its wrappers, the first innermost.

    Raises:
        TypeError: A wrapper returned something else than the environment that it was given, wrapped.
    """
    for each in wrappers:
        kind = VectorEnv if isinstance(env, VectorEnv) else gym.Env
        found = each(env)
        if not isinstance(found, kind) or found.unwrapped is not env.unwrapped:
            raise TypeError(
                f"wrapper {name_of(each)} returned {shown(found)}; it must return the {kind.__name__} that it is "
                "given, wrapped."
            )
        env = found
    return env


def single_env(scenario: Scenario, **options: Any) -> TrackingEnv:
    """A single environment to wrap, whose spec says its episodes' length, which some wrappers ask for.

    Args:
        scenario: What it flies.
        options: Further arguments of `TrackingEnv`.
    """
    env = TrackingEnv(scenario=scenario, **options)
    env.spec = EnvSpec(
        "uwoc/Nominal-v0",
        entry_point="uwoc_gym.env:TrackingEnv",
        kwargs={"scenario": scenario.to_dict(), **options},
    )
    return env


def vector_env(
    native: Callable[[], TrackingVectorEnv] | None,
    single: Callable[[], gym.Env[Any, Any]],
    size: int,
    wrappers: Sequence[Wrapper],
    autoreset_mode: AutoresetMode,
) -> VectorEnv[Any, Any, Any]:
    """Environments in their wrappers: the fleet, or a loop over single ones where some go around these.

    Args:
        native: Makes the fleet; None where there is none.
        single: Makes a single environment.
        size: Number of environments.
        wrappers: The first is the innermost.
        autoreset_mode: The fleet's, which a loop gets too.

    Raises:
        ValueError: The wrappers' order isn't allowed.
        TypeError: A wrapper returned something else than what it was given, wrapped.
    """
    singles, vectors = split(wrappers)
    if native is not None and not singles:
        return wrap(native(), vectors)  # type: ignore[no-any-return]
    loop = SyncVectorEnv([lambda: wrap(single(), singles)] * size, autoreset_mode=autoreset_mode)
    return wrap(loop, vectors)  # type: ignore[no-any-return]


def singles_of(env: VectorEnv[Any, Any, Any]) -> list[gym.Env[Any, Any]] | None:
    """The single environments, in their wrappers, that a vector environment loops over; None for a fleet."""
    base = env.unwrapped
    return list(base.envs) if isinstance(base, SyncVectorEnv) else None


def state_of(env: VectorEnv[Any, Any, Any]) -> dict[str, npt.NDArray[Any]]:
    """The true states behind all wrappers, as `TrackingVectorEnv.state` gives them."""
    return _behind(env, "state")


def terms_of(env: VectorEnv[Any, Any, Any]) -> dict[str, npt.NDArray[np.float64]]:
    """The terms of the last step's reward behind all wrappers, as `TrackingVectorEnv.terms` gives them."""
    return _behind(env, "terms")


def parameters_of(env: VectorEnv[Any, Any, Any]) -> dict[str, npt.NDArray[Any]]:
    """What the present episodes have drawn, behind all wrappers, as `TrackingVectorEnv.parameters` gives it."""
    return _behind(env, "parameters")


def _behind(env: VectorEnv[Any, Any, Any], method: str) -> dict[str, npt.NDArray[Any]]:
    singles = singles_of(env)
    if singles is None:
        return dict(getattr(env.unwrapped, method)())
    rows = [getattr(each.unwrapped, method)() for each in singles]
    return {name: np.stack([np.asarray(row[name]) for row in rows]) for name in rows[0]}
