"""Acoustic fixes: the ship as an array on the AUV hears it, now and then and late.

At every ping the ship's position is measured in the AUV's body frame, and the heading that the ship tells is compared
with the AUV's own (an inverted ultra-short baseline). The fix arrives after a delay, unless it is lost, and is held
until the next one; what the AUV and the ship have done since isn't in it. Ping 0 is at the start of the episode and
known at once, so that no policy begins blind. All is a function of the seed and the step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import floor, fma
from uwoc_gym.compute.records import rows
from uwoc_gym.compute.rng import draw, normal_pair
from uwoc_gym.parameters import Number, Parameters, SettingError, number

STREAM = 5.0

SLOTS = 3
"""Fixes that are kept until they arrive, the one of the latest ping among them."""

STATE = rows(
    # The fix that is held, the number of the latest ping and of the latest fix, and the step of its arrival.
    "ahead", "starboard", "yaw", "ping_s", "pinged", "delivered", "arrived",
    # The fixes that are on their way; those that will never come have a negative time.
    sent_ahead=(SLOTS,), sent_starboard=(SLOTS,), sent_yaw=(SLOTS,), sent_s=(SLOTS,),
)  # fmt: skip

_TOLERANCE = 1e-6
"""Share of a period by which a ping may be early, since times are rounded."""


@dataclass(frozen=True, kw_only=True)
class Fixes(Parameters):
    """When fixes are taken, how late and how exact they are; used where the observation group "fix" is observed."""

    period_s: Number = number(
        2.0, "s", "time between pings", low=0.001, high=3600.0, source="project default; units ping each 0.5 to 10 s"
    )
    delay_s: Number = number(
        0.5,
        "s",
        "time from a ping to its fix: sound's way, processing, modem",
        low=0.0,
        high=10.0,
        source="project default; up to 2 s are reported from the field",
    )
    position_std_m: Number = number(
        0.3, "m", "error of the position along each axis", low=0.0, high=100.0, source="0.5 to 2 degrees, range 0.5 m"
    )
    yaw_std_rad: Number = number(
        0.05, "rad", "error of the relative heading", low=0.0, high=3.2, source="compasses of 2 to 5 degrees"
    )
    dropout: Number = number(0.0, "1", "probability that a fix is lost", low=0.0, high=0.99, source="project default")

    def _check(self) -> None:
        if np.max(self.delay_s) > (SLOTS - 1) * np.min(self.period_s):
            raise SettingError(
                f"Fixes.delay_s = {self.delay_s!r} is not allowed; it must be at most {SLOTS - 1} times period_s = "
                f"{self.period_s!r} [s], since no more fixes can be on their way."
            )

    @property
    def random(self) -> bool:
        """Whether fixes differ from seed to seed."""
        return any(np.max(value) > 0.0 for value in (self.position_std_m, self.yaw_std_rad, self.dropout))

    def exact(self) -> Fixes:
        """The same without errors and losses."""
        return replace(self, position_std_m=0.0, yaw_std_rad=0.0, dropout=0.0)


@inlined
def begin(b, j) -> None:
    """Nothing has been heard."""
    b.fix.pinged[j] = -1.0
    b.fix.arrived[j] = -1.0


@inlined
def _hold(b, j, slot) -> None:
    """Let a fix arrive."""
    o = b.fix
    o.ahead[j] = o.sent_ahead[slot, j]
    o.starboard[j] = o.sent_starboard[slot, j]
    o.yaw[j] = o.sent_yaw[slot, j]
    o.ping_s[j] = o.sent_s[slot, j]
    o.arrived[j] = b.clock.step[j]


@inlined
def _ping(b, j, slot, number) -> None:
    """Measure where the ship is now."""
    p = b.drawn.fixes
    o = b.fix
    u0, u1, u2, u3 = draw(b, j, STREAM, number, 0.0)
    u4, _, _, _ = draw(b, j, STREAM, number, 1.0)
    n0, n1 = normal_pair(u0, u1)
    n2, _ = normal_pair(u2, u3)
    cosine, sine = b.auv.cos[j], b.auv.sin[j]
    dx = b.ship.x[j] - b.auv.x[j]
    dy = b.ship.y[j] - b.auv.y[j]
    o.sent_ahead[slot, j] = fma(cosine, dx, sine * dy) + p.position_std_m[j] * n0
    o.sent_starboard[slot, j] = fma(cosine, dy, -(sine * dx)) + p.position_std_m[j] * n1
    o.sent_yaw[slot, j] = b.ship.yaw[j] - b.auv.yaw[j] + p.yaw_std_rad[j] * n2
    o.sent_s[slot, j] = -1.0 if u4 < p.dropout[j] else b.clock.time_s[j]


@inlined
def listen(b, j) -> None:
    """Ping and receive what is due by now; a second time in the same step changes nothing."""
    p = b.drawn.fixes
    o = b.fix
    time = b.clock.time_s[j]
    number = floor(time / p.period_s[j] + _TOLERANCE)
    if number > o.pinged[j]:
        slot = int(number) % SLOTS
        _ping(b, j, slot, number)
        if o.pinged[j] < 0.0:
            o.sent_s[slot, j] = time
            _hold(b, j, slot)
            o.delivered[j] = number
        o.pinged[j] = number
    due = floor((time - p.delay_s[j]) / p.period_s[j] + _TOLERANCE)
    if due > o.delivered[j]:
        slot = int(due) % SLOTS
        o.delivered[j] = due
        if o.sent_s[slot, j] >= 0.0:
            _hold(b, j, slot)
