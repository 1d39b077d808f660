"""Gain sets of the scripted controllers: by the controller's name, each with its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from uwoc_gym.given import SettingError, as_number, as_numbers, closest, scalar, shown

Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of the law k(e) = a |e|^(mu-1) for |e| >= b, a b^(mu-1) for |e| < b (paper, sec. 3.2).

    Each number is a triple for the earth frame's x, y and yaw; a single number stands for all three. ``_p`` acts on
    the pose error, ``_v`` on the velocity error. mu = 1 is the PD, for which b has no effect.

    Attributes:
        a_p: Gain at an error of one unit, > 0 [N/m, N/m, N m/rad].
        b_p: Error below which the gain stays constant, > 0 [m, m, rad].
        mu_p: Exponent, in [0, 1].
        a_v: Gain at an error of one unit, > 0 [N s/m, N s/m, N m s/rad].
        b_v: Error below which the gain stays constant, > 0 [m/s, m/s, rad/s].
        mu_v: Exponent, in [0, 1].
        feedforward: Whether the law adds the model's forces along the ship's path.
        source: Where the numbers come from.

    Raises:
        SettingError: A value isn't allowed.
    """

    a_p: Triple
    a_v: Triple
    b_p: Triple = (1.0, 1.0, 1.0)
    b_v: Triple = (1.0, 1.0, 1.0)
    mu_p: Triple = (1.0, 1.0, 1.0)
    mu_v: Triple = (1.0, 1.0, 1.0)
    feedforward: bool = True
    source: str = "user"

    def __post_init__(self) -> None:
        for name in ("a_p", "b_p", "mu_p", "a_v", "b_v", "mu_v"):
            object.__setattr__(self, name, _triple(name, getattr(self, name)))
        object.__setattr__(self, "feedforward", scalar(self.feedforward))
        if not isinstance(self.feedforward, bool):
            raise SettingError(
                f"Gains.feedforward = {shown(self.feedforward)} is not allowed; it must be True or False."
            )
        if not isinstance(self.source, str):
            raise SettingError(f"Gains.source = {shown(self.source)} is not allowed; it must be a text.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Gains:
        """The gains that a mapping says, such as a JSON object.

        Raises:
            SettingError: A name is unknown or missing, or a value isn't allowed.
        """
        if not isinstance(data, Mapping):
            raise SettingError(f"Gains = {shown(data)} is not allowed; it must be a mapping of gains.")
        known = {field.name: field.default for field in fields(cls)}
        for name in data:
            if not isinstance(name, str) or name not in known:
                raise SettingError(f"Gains has no gain {shown(name)}; {closest(name, known)}")
        for name, default in known.items():
            if default is MISSING and name not in data:
                raise SettingError(f"Gains needs {name!r}; it must be a number or three of them (x, y, yaw).")
        return cls(**data)


def _triple(name: str, value: Any) -> Triple:
    exponent = name.startswith("mu")
    single = as_number(value)
    items = as_numbers(value, (3,)) if single is None else [single] * 3
    if items is not None:
        x, y, yaw = (float(item) for item in items)
        if all(0.0 <= item <= 1.0 if exponent else 0.0 < item < math.inf for item in (x, y, yaw)):
            return x, y, yaw
    interval = "[0, 1]" if exponent else "(0, inf)"
    raise SettingError(
        f"Gains.{name} = {shown(value)} is not allowed; it must be a number in {interval} or three of them (x, y, yaw)."
    )


_TUNED = (
    "`uwoc-gym tune {} --trials {} --out tuning`: highest mean return on 64 training seeds of uwoc/Random-v0; the box "
    "that was searched stands in uwoc_gym.agents.learning.tuning"
)
_PAPER = "paper, sec. 4: Kp = 300, Kv = 250"

GAINS: dict[str, Gains] = {
    "pd": Gains(
        a_p=(300.0, 300.0, 300.0),
        a_v=(250.0, 250.0, 250.0),
        source=f"{_PAPER}; feedforward as its law is printed",
    ),
    "pd-plain": Gains(
        a_p=(300.0, 300.0, 300.0),
        a_v=(250.0, 250.0, 250.0),
        feedforward=False,
        source=f"{_PAPER}; feedforward left out, which on a plant without Coriolis terms reproduces the paper's PD row",
    ),
    "nlpd": Gains(
        a_p=(300.0, 300.0, 300.0),
        a_v=(250.0, 250.0, 250.0),
        b_p=(1.531, 1.531, 1.531),
        b_v=(1.531, 1.531, 1.531),
        mu_p=(0.9467, 0.9093, 0.7246),
        mu_v=(0.1036, 0.7991, 0.3974),
        source=f"{_PAPER}; mu and b, which it doesn't give, by `uwoc-gym calibrate nlpd` to its nominal NLPD row. They "
        "aren't unique: seven numbers answer to four",
    ),
    "pd-tuned": Gains(
        a_p=(6317.0, 6317.0, 3813.0),
        a_v=(1809.0, 1809.0, 865.3),
        source=_TUNED.format("pd", 400),
    ),
    "nlpd-tuned": Gains(
        a_p=(6154.0, 6154.0, 2235.0),
        a_v=(1648.0, 1648.0, 760.2),
        b_p=(0.009374, 0.009374, 0.07298),
        b_v=(0.6420, 0.6420, 0.5994),
        mu_p=(1.0, 1.0, 0.7661),
        mu_v=(0.2338, 0.2338, 0.2319),
        source=_TUNED.format("nlpd", 1600),
    ),
}
"""The named gain sets; each has the name of the controller that flies it."""

FORMER_NAMES = {
    "paper-pd": "pd",
    "paper-pd-plain": "pd-plain",
    "paper": "nlpd",
    "tuned-pd": "pd-tuned",
    "tuned-nlpd": "nlpd-tuned",
}
"""Names that recorded runs and users' code may still say."""


def gains(name: str) -> Gains:
    """The named gain set; former names are known too.

    Raises:
        SettingError: There is no gain set of that name; the nearest one is given.
    """
    known = FORMER_NAMES.get(name, name) if isinstance(name, str) else ""
    if known not in GAINS:
        raise SettingError(f"There is no gain set {shown(name)}; {closest(name, GAINS)}")
    return GAINS[known]
