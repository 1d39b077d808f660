"""Settings: their format, overrides and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch
import yaml

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import settings


def test_every_settings_file_is_in_the_zoos_format() -> None:
    for algorithm in settings.TRAINABLE:
        entries = yaml.safe_load((settings.FOLDER / f"{algorithm}.yaml").read_text())
        assert "default" in entries
        for env_id, given in entries.items():
            values, _ = settings.resolve(algorithm, env_id)
            # Texts that YAML took a number for would be an error there.
            assert {key: values[key] for key in given} == given
            assert not {"residual", "residual_scale"} & set(given)


def test_entries_may_take_over_from_others_as_in_the_zoo(tmp_path: Path) -> None:
    path = tmp_path / "ppo.yaml"
    path.write_text("first: &usual {n_steps: 64, gamma: 0.9}\ndefault:\n  <<: *usual\n  gamma: 0.8\n")
    values, _ = settings.resolve("ppo", "uwoc/Random-v0", path=path)
    assert (values["n_steps"], values["gamma"]) == (64, 0.8)


def test_policy_arguments_in_the_style_of_the_zoo() -> None:
    text = "policy_kwargs='dict(net_arch=[64, 32], activation_fn=nn.ReLU, log_std_init=-2)'"
    values, _ = settings.resolve("ppo", "uwoc/Random-v0", [text, "policy_kwargs.net_arch=[8]", "gamma=9e-1"])
    assert values["policy_kwargs"] == {"net_arch": [8], "activation_fn": "nn.ReLU", "log_std_init": -2}
    assert values["gamma"] == 0.9
    assert settings.constructor_arguments("ppo", values, 3)["policy_kwargs"]["activation_fn"] is torch.nn.ReLU


@pytest.mark.parametrize(
    ("algorithm", "setting", "message"),
    [
        ("td3", "normalize=true", "normalize = True is not allowed with frame_stack = 4"),
        ("sac", "train_freq=[1, episode]", "train_freq = [1, 'episode'] is not allowed with n_envs = 16"),
        ("ppo", "policy_kwargs.net_arch=[64, -1]", "policy_kwargs.net_arch = [64, -1] is not allowed"),
        ("ppo", "target_kl=abc", "target_kl = 'abc' is not allowed; it must be a number"),
        ("ppo", "normalize={clip_obs: abc}", "clip_obs is a number of at least 0"),
        ("ppo", "normalize={norm_obs: 1}", "norm_obs is true or false"),
        ("ppo", "residual_scale=3", "it must be a number in (0, 2]"),
    ],
)
def test_settings_that_would_fail_later_are_refused(algorithm: str, setting: str, message: str) -> None:
    with pytest.raises(CommandError, match=re.escape(message)):
        settings.resolve(algorithm, "uwoc/Random-v0", [setting])
