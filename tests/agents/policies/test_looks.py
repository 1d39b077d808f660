"""One look a policy."""

from __future__ import annotations

import itertools

import pytest

from uwoc_gym.agents.learning.protocol import GROUPS
from uwoc_gym.agents.policies.looks import DASHES, LOOKS, OTHERS, looks
from uwoc_gym.agents.policies.registry import POLICIES


def _luminance(rgb: tuple[int, int, int]) -> float:
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in (part / 255 for part in rgb)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(first: tuple[int, int, int], second: tuple[int, int, int]) -> float:
    low, high = sorted((_luminance(first), _luminance(second)))
    return (high + 0.05) / (low + 0.05)


def test_every_policy_of_the_package_has_a_look() -> None:
    assert set(LOOKS) == {name for name in POLICIES.keys() | GROUPS.keys() if "@" not in name}
    assert all(look.dash in DASHES for look in (*LOOKS.values(), *OTHERS))


@pytest.mark.parametrize("ground", [(255, 255, 255), (10, 24, 40), (16, 35, 56)])
def test_colours_show_on_paper_and_on_the_dark_grounds(ground: tuple[int, int, int]) -> None:
    for look in (*LOOKS.values(), *OTHERS):
        assert _contrast(look.rgb, ground) >= 3.0, look
        # Black and white are the ship's.
        assert 0.1 < _luminance(look.rgb) < 0.35


def test_no_two_look_alike() -> None:
    for (one, a), (other, b) in itertools.combinations(LOOKS.items(), 2):
        apart = max(abs(x - y) for x, y in zip(a.rgb, b.rgb, strict=True))
        assert a.colour != b.colour
        assert apart > 40 or a.dash != b.dash, (one, other)


def test_a_policys_look_does_not_hang_on_its_company() -> None:
    alone, among = looks(["ppo"])["ppo"], looks(["pd", "runs/mine", "nlpd", "ppo", "runs/other"])
    assert among["ppo"] == alone == LOOKS["ppo"]
    assert [among["runs/mine"], among["runs/other"]] == list(OTHERS[:2])
    assert looks(["PD, as printed"])["PD, as printed"] == LOOKS["pd"]


def test_what_is_tuned_for_a_world_has_its_law_s_colour_and_another_line() -> None:
    laws = {name for name in POLICIES if "@" in name} | {"pd@Tide"}
    for name, own in looks(laws).items():
        law = LOOKS[name.partition("@")[0]]
        assert own.colour == law.colour
        assert own.dash in DASHES
        assert own.dash != law.dash
