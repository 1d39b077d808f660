"""What an agent corrects: any policy, told by its file in a way that it can be found again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.policies.registry import (
    MAY_BE,
    POLICIES,
    gains_of,
    gains_of_file,
    gains_path,
    load,
)
from uwoc_gym.baselines import GAINS
from uwoc_gym.baselines.controllers import Tuned
from uwoc_gym.baselines.gains import FORMER_NAMES
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.given import shown


@dataclass(frozen=True)
class Correction:
    """A policy that an agent corrects.

    Attributes:
        policy: The policy.
        told: How an agent's file tells of it: {"gains": ...}, {"policy": a shipped agent's name or module:callable}, or
            {"agent": the member of the file that holds it}.
        data: The file of an agent, which the file of the one that corrects it takes in; None for all others.
    """

    policy: Policy
    told: Mapping[str, Any]
    data: bytes | None = None

    @property
    def digest(self) -> str | None:
        """SHA-256 of the agent's file, by which a run that goes on knows it again; None for all others."""
        return None if self.data is None else hashlib.sha256(self.data).hexdigest()


def correction(
    given: str | Mapping[str, Any] | None, trust: bool = False, called: str = "residual"
) -> Correction | None:
    """What is corrected, or copied; None for nothing.

    Args:
        given: All that a policy may be given as, or the gains themselves.
        trust: Whether an agent's file may name code, which is run.
        called: The setting that it is given as.

    Raises:
        CommandError: There is no such policy, or it can't be loaded.
    """
    if given is None:
        return None
    try:
        if isinstance(given, Mapping):
            own = gains_of(given, shown(dict(given)))
            return _of_gains(own.law, own)
        return _named(given, trust)
    except CommandError as error:
        raise CommandError(f"{called} = {shown(given)} is not allowed; {error}") from None


def _named(name: str, trust: bool) -> Correction:
    known = FORMER_NAMES.get(name, name)
    if known in GAINS:
        return _of_gains(known, Tuned.of(GAINS[known]))
    if name not in POLICIES:
        path = places.local(name)
        gains = gains_path(path)
        if gains is not None:
            return _of_gains(name, gains_of_file(gains))
        file = path / saved.MODEL if path.is_dir() else path
        if file.is_file():
            if not archive.is_agent(file):
                raise CommandError(
                    f"{shown(name)} holds pickled objects, which an agent's file can't take in; give a module:callable "
                    f"that loads it. What is corrected may otherwise be {MAY_BE}."
                )
            return Correction(load(name, trust), {"agent": archive.CORRECTED}, file.read_bytes())
    return Correction(load(name), {"policy": name})


def _of_gains(name: str, gains: Tuned) -> Correction:
    return Correction(gains.policy(name), {"gains": gains.to_dict()})
