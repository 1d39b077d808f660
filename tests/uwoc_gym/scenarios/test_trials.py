"""The trial worlds are what their page says."""

from __future__ import annotations

import re

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.scenarios import trials

WORLDS = ("Underactuated", "Tide", "LateFix")


def section(world: str) -> str:
    found: str = trials.__doc__.split(f"## {world}\n")[1].split("## ")[0]  # type: ignore[union-attr]
    return found


@pytest.mark.parametrize("world", WORLDS)
def test_actions_are_those_of_the_table(world: str) -> None:
    scenario = Scenario.named(world)
    rows = re.findall(r"^\| (\d+) +\| (\w+ \w+) +\| -1 +\| 1 +\| (\d+) N", section(world), re.MULTILINE)
    assert [int(number) for number, *_ in rows] == list(range(len(scenario.actions)))
    assert [axis for _, axis, _ in rows] == list(scenario.actions)
    limits = dict(zip(("surge force", "sway force", "yaw moment"), scenario.vehicle.force_limits, strict=True))
    assert {axis: float(limit) for _, axis, limit in rows} == {axis: limits[axis] for axis in scenario.actions}


@pytest.mark.parametrize("world", WORLDS)
def test_observations_are_those_of_the_text(world: str) -> None:
    scenario, text = Scenario.named(world), section(world)
    size = re.search(r"(\d+) entries", text)
    assert size
    assert int(size[1]) == scenario.observation.size
    if world != "LateFix":
        assert scenario.observation == Scenario.named("Random").observation
    else:
        groups = re.findall(r"``([\w-]+)``", text)
        assert tuple(groups) == scenario.observation.groups


def test_the_munk_moment_exceeds_the_yaw_moment() -> None:
    """At the speeds that the hull reaches when it is pushed askew with all that it has."""
    vehicle = Scenario.named("Tide").vehicle.nominal()
    surge, sway, yaw = vehicle.force_limits
    m11, m22, _ = vehicle.inertia
    linear = vehicle.damping(np.zeros(3))
    quadratic = vehicle.damping(np.ones(3)) - linear
    u, v = ((-linear + np.sqrt(linear**2 + 4.0 * quadratic * [surge, sway, yaw])) / (2.0 * quadratic))[:2]
    assert (m22 - m11) * u * v > 1.5 * yaw
    # Where forces are strong, and there is no current, the yaw moment copes with what tracking asks for.
    strong = Scenario.named("Random").vehicle.nominal()
    assert (m22 - m11) * 1.0 * 1.0 < strong.force_limits[2]


def test_what_is_told_of_fixes_and_ships() -> None:
    late, random = Scenario.named("LateFix"), Scenario.named("Random")
    text = section("LateFix")
    fixes = late.fixes
    assert f"one every {fixes.period_s:g} s, {fixes.delay_s:g} s late" in text
    assert f"errors of {fixes.position_std_m:g} m along each axis and {fixes.yaw_std_rad:g} rad" in text
    for quick, usual in zip(late.ship, random.ship, strict=True):
        if hasattr(usual, "speed_mps"):
            np.testing.assert_allclose(quick.speed_mps, 2.0 * np.asarray(usual.speed_mps))
    speed, pulses = Scenario.named("Tide").sea.current.speed_mps, Scenario.named("Tide").sea.pulses
    assert f"{speed[0]:g} to {speed[1]:g} m/s" in section("Tide")
    for weak, usual in zip(pulses, random.sea.pulses, strict=True):
        np.testing.assert_allclose(weak.force_x_n, 0.1 * np.asarray(usual.force_x_n))
