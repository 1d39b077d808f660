"""The laws that fly, what each is set by, and the policies that come with the package."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import GAINS, Gains
from uwoc_gym.baselines.guidance import Guidance, GuidanceGains
from uwoc_gym.baselines.learned_tracker import LearnedTracker
from uwoc_gym.baselines.lqr import Regulator, RegulatorScales
from uwoc_gym.baselines.planner import Clairvoyant, Planner, PlannerSettings
from uwoc_gym.baselines.policy import Policy, Predictor
from uwoc_gym.given import SettingError, closest, shown
from uwoc_gym.scenario import SCENARIOS

GainSet = Gains | GuidanceGains | RegulatorScales | PlannerSettings
"""What a law is set by."""


class Kind(NamedTuple):
    """A way to fly."""

    gains: type[Any]
    """What it is set by: a kind of `GainSet`."""
    make: Callable[..., Predictor]
    """Makes it from those, or from one for each of N simulations, and what is known of a scenario."""
    description: str
    together: bool = True
    """Whether N gain sets can fly in N simulations."""
    slow: bool = False
    """Whether it flies only where it is named."""


_EKF = "behind filters for the current and for late fixes"
_GRU = "behind a network that has learned how ships sail, where they are known by late fixes"

KINDS = {
    "pd": Kind(Gains, Controller, "the paper's PD law"),
    "nlpd": Kind(Gains, Controller, "the paper's NLPD law"),
    "lqr": Kind(RegulatorScales, Regulator, "a linear-quadratic regulator over the known model"),
    "ekf-pd": Kind(Gains, partial(Controller, filtered=True), f"the PD law {_EKF}"),
    "ekf-nlpd": Kind(Gains, partial(Controller, filtered=True), f"the NLPD law {_EKF}"),
    "ekf-lqr": Kind(RegulatorScales, partial(Regulator, filtered=True), f"the regulator {_EKF}"),
    "gru-nlpd": Kind(Gains, partial(Controller, filtered=LearnedTracker), f"the NLPD law {_GRU}"),
    "gru-lqr": Kind(RegulatorScales, partial(Regulator, filtered=LearnedTracker), f"the regulator {_GRU}"),
    "los": Kind(GuidanceGains, Guidance, f"line-of-sight guidance {_EKF}"),
    "mppi": Kind(PlannerSettings, Planner, f"a sampling planner on the known model {_EKF}", together=False, slow=True),
    "clairvoyant": Kind(
        PlannerSettings,
        Clairvoyant,
        "that planner on the true state and future: a yardstick, not a rival",
        together=False,
        slow=True,
    ),
}
"""The laws by name."""


class Tuned(NamedTuple):
    """A law with what it is set by: what a search finds, and a .json file holds."""

    law: str
    gains: GainSet
    source: str = "user"
    """Where the gains come from."""

    @classmethod
    def of(cls, gains: GainSet, law: str | None = None) -> Tuned:
        """The law that flies a gain set, by default the plainest."""
        own = law or next(name for name in ("nlpd", *KINDS) if isinstance(gains, KINDS[name].gains))
        return cls(own, gains, gains.source if isinstance(gains, Gains) else "user")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Tuned:
        """What a mapping says, such as a JSON object: "law", "source", and the gains by their names.

        The law may be left out where the gains say by their names which kind they are.

        Raises:
            SettingError: A name is unknown or missing, or a value isn't allowed.
        """
        if not isinstance(data, Mapping):
            raise SettingError(f"gains = {shown(data)} is not allowed; it must be a mapping of gains.")
        rest = dict(data)
        law = rest.pop("law", None)
        if law is None:
            kinds = (name for name, each in KINDS.items() if each.gains is not Gains and set(rest) & _names(each.gains))
            law = next(kinds, "nlpd")
        if not isinstance(law, str) or law not in KINDS:
            raise SettingError(f"law = {shown(law)} is not allowed; {closest(law, KINDS)}")
        kind = KINDS[law].gains
        source = rest.get("source", "user") if kind is Gains else rest.pop("source", "user")
        return cls(law, kind.from_dict(rest), source)

    def to_dict(self) -> dict[str, Any]:
        """Plain data that `from_dict` reads."""
        gains = asdict(self.gains) if isinstance(self.gains, Gains) else self.gains.to_dict()
        return {"law": self.law, "source": self.source, **gains}

    def policy(self, name: str, description: str | None = None) -> Policy:
        """The policy that flies it."""
        kind = KINDS[self.law]
        text = description or f"{kind.description}, set by {self.source}"
        return Policy(name, text, partial(kind.make, self.gains), slow=kind.slow)


def _names(kind: type[Any]) -> set[str]:
    return set(kind.specs())


def one_for_each(laws: Sequence[Tuned | GainSet]) -> Policy:
    """A policy that flies one gain set per simulation, all of one law, as many as there are simulations."""
    tuned = [each if isinstance(each, Tuned) else Tuned.of(each) for each in laws]
    return Policy(
        "controllers", "one gain set per simulation", partial(KINDS[tuned[0].law].make, [t.gains for t in tuned])
    )


TUNED = Path(__file__).parent / "tuned"
"""Gains that `uwoc-gym tune` has found: a folder for each scenario, with a file for each law."""


def tuned_for(scenario: str) -> dict[str, Tuned]:
    """What was found for a named scenario, by the law's name."""
    files = sorted((TUNED / scenario).glob("*.json"), key=lambda path: [*KINDS].index(path.stem))
    return {path.stem: Tuned.from_dict(json.loads(path.read_text(encoding="utf-8"))) for path in files}


_DESCRIPTIONS = {
    "pd": "the paper's PD law as printed, with full feedforward",
    "pd-plain": "the same gains without feedforward, as the paper's PD numbers suggest",
    "nlpd": "the paper's NLPD law, exponents searched to match its nominal results",
    "pd-tuned": "the PD law with gains searched for the return in Random",
    "nlpd-tuned": "the NLPD law with gains searched for the return in Random",
}

_EVERYWHERE = {
    "lqr": Tuned("lqr", RegulatorScales()),
    "ekf-pd": Tuned("ekf-pd", GAINS["pd-tuned"]),
    "ekf-nlpd": Tuned("ekf-nlpd", GAINS["nlpd-tuned"]),
    "ekf-lqr": Tuned("ekf-lqr", RegulatorScales()),
    "gru-nlpd": Tuned("gru-nlpd", GAINS["nlpd-tuned"]),
    "gru-lqr": Tuned("gru-lqr", RegulatorScales()),
    "los": Tuned("los", GuidanceGains()),
    "mppi": Tuned("mppi", PlannerSettings()),
    "clairvoyant": Tuned("clairvoyant", PlannerSettings()),
}

CONTROLLERS: dict[str, Policy] = {
    **{name: Tuned.of(GAINS[name]).policy(name, text) for name, text in _DESCRIPTIONS.items()},
    **{name: own.policy(name, KINDS[name].description) for name, own in _EVERYWHERE.items()},
    **{
        f"{law}@{world}": own.policy(f"{law}@{world}", f"{KINDS[law].description}, tuned in {world}")
        for world in SCENARIOS
        for law, own in tuned_for(world).items()
    },
}
"""The controllers, as policies that can be made for any scenario; after @ stands that in which gains were searched."""


def begun(name: str) -> Tuned:
    """The gains that a controller's name means, for a search to begin at.

    Raises:
        KeyError: There is no controller of that name.
    """
    law, _, world = name.partition("@")
    if world:
        return tuned_for(world)[law]
    return _EVERYWHERE[name] if name in _EVERYWHERE else Tuned.of(GAINS[name], name.partition("-")[0])
