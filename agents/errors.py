"""What goes wrong for a user, and what isn't installed: said in one line."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from uwoc_gym.given import SettingError

EXTRAS = {
    "cmaes": "tune",
    "fsspec": "ray",
    "h5py": "data",
    "imageio_ffmpeg": "render",
    "matplotlib": "benchmark",
    "minari": "data",
    "optuna": "tune",
    "plotly": "render",
    "pygame": "render",
    "ray": "ray",
    "sb3_contrib": "agents",
    "stable_baselines3": "agents",
    "tensorboard": "agents",
    "torch": "agents",
    "tqdm": "benchmark",
    "yaml": "agents",
}
"""Which extra of this package brings a module."""


class CommandError(Exception):
    """An error that a command reports in one line."""


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Put the option's name before an error about what it was given."""
    try:
        yield
    except (CommandError, SettingError) as error:
        raise CommandError(f"{option}: {error}") from None


def require(*modules: str) -> None:
    """Refuse to go on without optional modules.

    Raises:
        CommandError: One of them isn't installed; the extra that brings it is named.
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise CommandError(f'{module} is not installed; run: pip install "uwoc-gym[{EXTRAS[module]}]"')
