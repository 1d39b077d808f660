"""How each policy is drawn: one colour and one kind of line, the same in every figure, video and page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Look(NamedTuple):
    """Colour and kind of line of a policy."""

    colour: str
    """As #RRGGBB, of at least three to one against white paper and against the dark ground of videos."""
    dash: str
    """A name in `DASHES`."""

    @property
    def rgb(self) -> tuple[int, int, int]:
        """The colour as red, green and blue in [0, 255]."""
        red, green, blue = bytes.fromhex(self.colour[1:])
        return red, green, blue


DASHES: dict[str, tuple[float, ...]] = {
    "solid": (),
    "dash": (5.0, 2.0),
    "dot": (1.5, 1.5),
    "dashdot": (6.0, 2.0, 1.5, 2.0),
    "longdash": (9.0, 2.0),
    "longdashdot": (9.0, 1.5, 1.5, 1.5),
}
"""Lengths of dashes and gaps in widths of the line, by the names that Plotly has for them."""

# What a policy is, is a hue: PD warm, NLPD blue, LQR red, PPO green and what corrects a controller pink. Whatever a
# colour says is also said by dashes, for those who don't see it. Black and white are the ship's.
LOOKS: dict[str, Look] = {
    "pd": Look("#C77F00", "dashdot"),
    "pd-plain": Look("#8C6D4F", "dot"),
    "pd-tuned": Look("#D55E00", "dot"),
    "nlpd": Look("#2F93D1", "dash"),
    "nlpd-tuned": Look("#2F6BD6", "longdash"),
    "lqr": Look("#C24A55", "dash"),
    "ekf-pd": Look("#D2732A", "solid"),
    "ekf-nlpd": Look("#4F74C4", "solid"),
    "ekf-lqr": Look("#C9476A", "solid"),
    "gru-nlpd": Look("#3A7CA5", "dashdot"),
    "gru-lqr": Look("#B5558A", "dashdot"),
    "los": Look("#A8622C", "longdash"),
    "mppi": Look("#7A6FBE", "solid"),
    "clairvoyant": Look("#7D858C", "longdashdot"),
    "ppo": Look("#009E73", "solid"),
    "ppo-residual": Look("#CC5FA0", "longdashdot"),
    "ppo-underactuated": Look("#2E9E4F", "longdash"),
    "ppo-tide": Look("#00897B", "dash"),
    "ppo-latefix": Look("#4C9A2A", "dashdot"),
    "ppo-one-frame": Look("#7F9400", "dash"),
    "td3": Look("#9461D8", "dot"),
}
"""Of the policies that the package names."""

OTHERS = (
    Look("#17909B", "solid"),
    Look("#B5475B", "dash"),
    Look("#7A7F00", "dashdot"),
    Look("#7C73E6", "longdash"),
    Look("#A0703A", "longdashdot"),
    Look("#808690", "dot"),
)
"""Of all other policies, and of lines that aren't policies, in their order."""

_TUNED = "dashdot"
"""Line of what is tuned for a world."""

PAPER = {
    "PD, as printed": "pd",
    "PD, as found": "pd-plain",
    "PD, no feedforward": "pd-plain",
    "NLPD, as printed": "nlpd",
}
"""What the paper's figures call a policy of the package."""


def looks(names: Iterable[str]) -> dict[str, Look]:
    """The look of each policy; those that the package doesn't name take what is left, in their order.

    What is tuned for a world, as law@world, has the law's colour and another line.
    """
    found: dict[str, Look] = {}
    others = 0
    for name in dict.fromkeys(names):
        law, _, world = PAPER.get(name, name).partition("@")
        own = LOOKS.get(law)
        if own is not None and world:
            own = own._replace(dash=_TUNED if own.dash != _TUNED else "longdash")
        if own is None:
            own = OTHERS[others % len(OTHERS)]
            others += 1
        found[name] = own
    return found
