"""The scripted controllers by name; a controller's gain set has its name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import Gains
from uwoc_gym.baselines.guidance import Guidance, GuidanceGains
from uwoc_gym.baselines.policy import Policy

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
    "los": Policy(
        "los",
        "line-of-sight guidance behind the same filters, gains searched for the return in Underactuated",
        partial(Guidance, GuidanceGains()),
    ),
}
"""The controllers, as policies that can be made for any scenario."""


def one_for_each(laws: Sequence[Gains]) -> Policy:
    """A policy that flies one gain set per simulation, as many as there are simulations."""
    return Policy("controllers", "one gain set per simulation", partial(Controller, laws))
