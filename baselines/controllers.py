"""The scripted controllers by name; a controller's gain set has its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import Gains
from uwoc_gym.baselines.guidance import GUIDANCE, Guidance, GuidanceGains
from uwoc_gym.baselines.law import Law
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

_DESCRIPTIONS = {
    "pd": "the paper's PD law as printed, with full feedforward",
    "pd-plain": "the same gains without feedforward, as the paper's PD numbers suggest",
    "nlpd": "the paper's NLPD law, exponents searched to match its nominal results",
    "pd-tuned": "the PD law with gains searched for the return in Random",
    "nlpd-tuned": "the NLPD law with gains searched for the return in Random",
}

CONTROLLERS: dict[str, Policy] = {
    **{name: Policy(name, description, partial(Controller, name)) for name, description in _DESCRIPTIONS.items()},
    "ekf-nlpd": Policy(
        "ekf-nlpd",
        "nlpd-tuned behind filters for the current and for late fixes",
        partial(Controller, "nlpd-tuned", filtered=True),
    ),
    **{
        name: Policy(
            name,
            f"line-of-sight guidance behind the same filters, gains searched for the return in {world}",
            partial(Guidance, GUIDANCE[name]),
        )
        for name, world in (("los", "Underactuated"), ("los-tide", "Tide"))
    },
}
"""The controllers, as policies that can be made for any scenario."""


GainSet = Gains | GuidanceGains
"""The gains of a law, which say by their kind which law that is."""


def law(gains: GainSet | Sequence[GainSet], scenario: Scenario) -> Law:
    """The law that flies a gain set, or one of N in each of N simulations."""
    first = gains if isinstance(gains, (Gains, GuidanceGains)) else gains[0]
    made: Any = Guidance if isinstance(first, GuidanceGains) else Controller
    return made(gains, scenario)  # type: ignore[no-any-return]


def gain_set(data: Mapping[str, Any]) -> GainSet:
    """The gains that a mapping says, such as a JSON object.

    Raises:
        SettingError: A name is unknown or missing, or a value isn't allowed.
    """
    is_guidance = isinstance(data, Mapping) and any(name in GuidanceGains.specs() for name in data)
    return GuidanceGains.from_dict(data) if is_guidance else Gains.from_dict(data)


def plain(gains: GainSet) -> dict[str, Any]:
    """Gains as data that `gain_set` reads."""
    return gains.to_dict() if isinstance(gains, GuidanceGains) else asdict(gains)


def one_for_each(laws: Sequence[GainSet]) -> Policy:
    """A policy that flies one gain set per simulation, as many as there are simulations."""
    return Policy("controllers", "one gain set per simulation", partial(law, laws))
