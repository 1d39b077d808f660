"""Gain sets of the PD and NLPD laws by name, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

from uwoc_gym.parameters import SettingError, closest

Axes = tuple[float, float, float]
"""One number each for x, y and yaw."""

_ONES: Axes = (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of the law, per axis of the earth frame.

    The position gain is k(e) = a |e|^(μ − 1) where |e| ≥ b and a b^(μ − 1) below; the velocity gain likewise.

    Args:
        a_p: Position gains a at an error of 1, above 0 [N/m, N/m, N m/rad].
        a_v: Velocity gains a at an error of 1, above 0 [N s/m, N s/m, N m s/rad].
        mu_p: Exponents μ of the position gains, in [0, 1]; 1 makes the gain constant.
        mu_v: Exponents μ of the velocity gains, in [0, 1].
        b_p: Errors below which the position gains stay constant, above 0 [m, m, rad].
        b_v: Errors below which the velocity gains stay constant, above 0 [m/s, m/s, rad/s].
        feedforward: Whether the law adds the forces that the nominal model needs to follow the ship.
        source: Where the set comes from.

    Raises:
        SettingError: A number lies outside its range, or there aren't three of it.
    """

    a_p: Axes = (300.0, 300.0, 300.0)
    a_v: Axes = (250.0, 250.0, 250.0)
    mu_p: Axes = _ONES
    mu_v: Axes = _ONES
    b_p: Axes = _ONES
    b_v: Axes = _ONES
    feedforward: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("a_p", "a_v", "b_p", "b_v"):
            self._check(name, lambda value: 0.0 < value < float("inf"), "three numbers above 0")
        for name in ("mu_p", "mu_v"):
            self._check(name, lambda value: 0.0 <= value <= 1.0, "three numbers in [0, 1]")

    def _check(self, name: str, allowed: object, description: str) -> None:
        values = getattr(self, name)
        try:
            numbers = tuple(float(value) for value in values)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != 3 or not all(allowed(value) for value in numbers):  # type: ignore[operator]
            raise SettingError(f"Gains.{name} = {values!r} is not allowed; it must be {description}.")
        object.__setattr__(self, name, numbers)

    @property
    def linear(self) -> bool:
        """Whether all gains are constant, which makes the law a PD."""
        return self.mu_p == _ONES and self.mu_v == _ONES


GAINS: dict[str, Gains] = {
    "paper-pd": Gains(source="paper, sec. 4: K_p = 300, K_v = 250, law as printed, with full feedforward"),
    "paper-pd-plain": Gains(
        feedforward=False,
        source="paper's gains without feedforward: gives the paper's PD row, on a plant without Coriolis terms",
    ),
    "paper-nlpd": Gains(
        mu_p=(0.9812, 0.9123, 0.5598),
        mu_v=(0.1268, 0.8337, 0.8763),
        b_p=(1.1592, 1.1592, 1.1592),
        b_v=(1.1592, 1.1592, 1.1592),
        source="a = 300 and 250 from the paper; μ and b, which it doesn't give, searched to match its nominal NLPD row",
    ),
}
"""The named gain sets."""


def gains(name: str) -> Gains:
    """The gain set called ``name``.

    Raises:
        SettingError: There is no set of that name; the nearest one is given.
    """
    if name not in GAINS:
        raise SettingError(f"There is no gain set {name!r}; {closest(name, list(GAINS))}")
    return GAINS[name]
