"""Where a training stands between two rollouts, so that one that was stopped goes on as if it hadn't been, bit for bit.

Weights, optimisers, counters and replay buffer are kept elsewhere; here are the environments with the episodes that are
under way, the last observations, and all random numbers' states.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.noise import NormalActionNoise

from uwoc_gym.agents.learning import checkpoints, environments

_SEEN = ("_last_obs", "_last_episode_starts", "_last_original_obs")
"""What a model knows of the step before, by Stable-Baselines3's names."""
_LSTM = "_last_lstm_states"


def taken(model: Any) -> dict[str, Any] | None:
    """Where a model and its environments stand; None where they can't be told.

    Args:
        model: Between two rollouts.
    """
    env = model.get_env()
    layers = environments.kept(env)
    noise = getattr(model, "action_noise", None)
    noise = getattr(noise, "base_noise", noise)
    if layers is None or not (noise is None or isinstance(noise, NormalActionNoise)):
        return None
    own = vars(model)
    # Stable-Baselines3 draws from the one that all share.
    numbers: Any = np.random.get_state()  # noqa: NPY002
    stood = {
        "layers": layers,
        "seen": {name: own[name] for name in _SEEN if name in own},
        "lstm": None if own.get(_LSTM) is None else [[part.numpy() for part in pair] for pair in own[_LSTM]],
        "torch": torch.get_rng_state().numpy(),
        "numpy": tuple(numbers),
        "python": random.getstate(),
        "actions": env.action_space.np_random.bit_generator.state,
    }
    # What goes on changes much of it in place.
    return deepcopy(stood)


def put(model: Any, stood: Mapping[str, Any], path: Path) -> None:
    """Let a model and its environments go on from where `taken` saw them; `let_draw` is still to come.

    Args:
        model: Made with the same settings.
        stood: What `taken` gave.
        path: The file that it is from.

    Raises:
        CommandError: It is of another run.
    """
    try:
        environments.put_back(model.get_env(), *stood["layers"])
        vars(model).update({name: stood["seen"][name] for name in _SEEN if name in stood["seen"]})
        if stood["lstm"] is not None:
            kind = type(vars(model)[_LSTM])
            vars(model)[_LSTM] = kind(*(tuple(map(torch.as_tensor, pair)) for pair in stood["lstm"]))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise checkpoints.damaged(path, error) from None


def let_draw(model: Any, stood: Mapping[str, Any], path: Path) -> None:
    """Let random numbers go on from where `taken` saw them.

    Raises:
        CommandError: It is of another run.
    """
    try:
        torch.set_rng_state(torch.as_tensor(stood["torch"]))
        np.random.set_state(stood["numpy"])  # noqa: NPY002
        random.setstate(stood["python"])
        model.get_env().action_space.np_random.bit_generator.state = stood["actions"]
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise checkpoints.damaged(path, error) from None
