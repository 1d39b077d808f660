"""Nested random values thrown at everything that reads settings: each is accepted or refused in the package's words."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("yaml")
pytest.importorskip("stable_baselines3")

from uwoc_gym import Fleet, Scenario, SettingError, TrackingEnv
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import settings as training
from uwoc_gym.agents.learning.plans import Wish, planned, recorded_plan
from uwoc_gym.agents.learning.progress import Progress, read_progress
from uwoc_gym.agents.policies.residual import checked_scale
from uwoc_gym.agents.reports.files import json_text
from uwoc_gym.baselines import Gains
from uwoc_gym.given import LIMITS, as_number, as_numbers, as_whole, closest, count, from_json, shown
from uwoc_gym.parameters import ChildSpec, Parameters

EXAMPLES = 300

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from(
        [10**400, -(10**400), 2**63, 1e308, -1e308, 5e-324, 1e-300, 0.0, -0.0, math.nan, math.inf, -math.inf]
    ),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["Nominal", "circle", "recorded", "port", "1", "1e3", "ship", "lin_1e-3", "dict(a=", "x" * 10_000]),
    st.sampled_from([np.array(1.0), np.array(True), np.array("port"), np.float32(0.5), np.int64(3), np.bool_(True)]),
    st.sampled_from([np.zeros(2), np.zeros((2, 2)), np.array(["a"]), np.array([None, 1], dtype=object), 1j, b"1"]),
)


def _names(of: type[Parameters]) -> set[str]:
    """All names of settings in a class and below it."""
    found = set(of.specs())
    for spec in of.specs().values():
        if isinstance(spec, ChildSpec):
            for each in spec.types:
                found |= _names(each)
    return found


SETTINGS = sorted(_names(Scenario))


def nested(names: list[str]) -> st.SearchStrategy[Any]:
    """Values as JSON and Python have them, in which names that are known turn up."""
    keys = st.one_of(st.sampled_from(names), st.text(max_size=4), st.sampled_from(["kind", "base", "", "0"]))
    return st.recursive(
        SCALARS,
        lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=4)),
        max_leaves=12,
    )


ANYTHING = nested(SETTINGS)
OWN_ERRORS = (SettingError, CommandError)
LENIENT = settings(max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def refused(read: Callable[[], Any]) -> str | None:
    """What the package says against it; None if it is accepted. Any other error goes through."""
    try:
        read()
    except OWN_ERRORS as error:
        text = str(error)
        assert re.search("must|Valid names|not known|isn't valid|There is no|needs|nested", text), text
        assert len(text) < 5000
        return text
    return None


def said_against(read: Callable[[], Any]) -> str | None:
    """What an environment says against it; None if it is accepted. Any other error goes through."""
    try:
        read()
    except ValueError as error:
        return str(error)
    return None


def _fields() -> list[tuple[tuple[str, ...], str]]:
    """The path of every setting of a scenario, and its name."""

    def below(of: type[Parameters], path: tuple[str, ...]) -> list[tuple[tuple[str, ...], str]]:
        found = []
        for name, spec in of.specs().items():
            found.append(((*path, name), f"{of.__name__}.{name}"))
            if isinstance(spec, ChildSpec) and not (spec.many or spec.one_or_many):
                found += below(spec.types[0], (*path, name))
        return found

    return below(Scenario, ())


FIELDS = _fields()


@LENIENT
@given(field=st.sampled_from(FIELDS), value=ANYTHING)
def test_a_setting_takes_a_value_or_names_itself(field: tuple[tuple[str, ...], str], value: Any) -> None:
    path, _ = field
    changes: Any = value
    for name in reversed(path):
        changes = {name: changes}
    text = refused(lambda: Scenario().merged(changes))
    # What is refused together with others, such as a duration that is no multiple of a period, names one of them.
    assert text is None or any(name in text for name in SETTINGS) or any(each.__name__ in text for each in _classes())


def _classes() -> set[type[Parameters]]:
    def below(of: type[Parameters]) -> set[type[Parameters]]:
        found = {of}
        for spec in of.specs().values():
            if isinstance(spec, ChildSpec):
                for each in spec.types:
                    found |= below(each)
        return found

    return below(Scenario)


@LENIENT
@given(value=ANYTHING)
def test_scenarios_take_anything_or_say_why(value: Any) -> None:
    for read in (Scenario().merged, Scenario.from_dict, Scenario.named, from_json_of):
        refused(lambda read=read: read(value))


def from_json_of(value: Any) -> Any:
    return Scenario.from_json(json_text({"ship": value})) if _plain(value) else None


def _plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_plain, value.values()))
    if isinstance(value, list):
        return all(map(_plain, value))
    return value is None or type(value) in (bool, float, str) or (type(value) is int and abs(value) < 10**300)


@LENIENT
@given(value=nested(["a_p", "a_v", "b_p", "b_v", "mu_p", "mu_v", "feedforward", "source"]))
def test_gains_take_anything_or_say_why(value: Any) -> None:
    refused(lambda: Gains.from_dict(value))
    for name in ("a_p", "mu_v", "feedforward"):
        refused(lambda name=name: Gains.from_dict({"a_p": 1.0, "a_v": 1.0, name: value}))
    refused(lambda: checked_scale(value))


KNOWN = [*training.OWN, "learning_rate", "n_steps", "batch_size", "net_arch", "policy_kwargs", "gamma", "target_kl"]


@LENIENT
@given(key=st.sampled_from([*KNOWN, "train_freq", "clip_range", "normalize_advantage"]), value=nested(KNOWN))
def test_settings_of_learners_take_anything_or_say_why(key: str, value: Any) -> None:
    for algorithm in ("ppo", "td3"):
        refused(lambda algorithm=algorithm: training.checked(algorithm, {**training.OWN, key: value}, "here"))
    refused(lambda: training.assigned("ppo", training.OWN, [f"{key}={value!r:.2000}"]) if _plain(value) else None)


RECORDED = {"command": "", **planned(Wish(steps=64, envs=1)).to_dict()}


@LENIENT
@given(key=st.sampled_from(sorted(RECORDED)), value=nested(sorted(RECORDED)))
def test_a_recorded_run_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, key: str, value: Any) -> None:
    if not _plain(value):
        return
    path = tmp_path_factory.getbasetemp() / "run.json"
    path.write_text(json_text({**RECORDED, key: value}), encoding="utf-8", errors="surrogatepass")
    refused(lambda: planned(Wish(), recorded_plan(path)))


@LENIENT
@given(key=st.sampled_from(sorted(Progress().__dict__)), value=nested(["steps", "mean", "return"]))
def test_progress_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, key: str, value: Any) -> None:
    if not _plain(value):
        return
    path = tmp_path_factory.getbasetemp() / "progress.json"
    path.write_text(json_text({**Progress().__dict__, key: value}), encoding="utf-8", errors="surrogatepass")
    text = refused(lambda: read_progress(path))
    assert text is None or key in text or "UTF-8" in text


ENV = TrackingEnv(scenario="Random")


@LENIENT
@given(value=ANYTHING, key=st.sampled_from(["pose", "velocity", "parameters", "scenario"]))
def test_options_are_read_or_refused(key: str, value: Any) -> None:
    for options in (value, {key: value}, {"parameters": {"vehicle.mass_scale": value}}):
        text = said_against(lambda options=options: ENV.check_reset(seed=1, options=options))
        assert text is None or "options" in text
    text = said_against(lambda: ENV.check_reset(seed=value))
    assert text is None or "seed = " in text


@LENIENT
@given(value=ANYTHING, name=st.sampled_from(sorted(name for name, limit in LIMITS.items() if limit.whole)))
def test_counts_and_numbers_are_read_or_refused(value: Any, name: str) -> None:
    text = refused(lambda: count(name, value))
    whole = as_whole(value)
    assert (text is None) == (whole is not None and LIMITS[name].low <= whole <= LIMITS[name].high)
    assert text is None or (name in text and shown(value) in text and LIMITS[name].allowed in text)
    number, numbers = as_number(value), as_numbers(value)
    assert number is None or isinstance(number, float)
    assert numbers is None or np.isfinite(numbers).all()
    assert len(shown(value)) < 2000
    assert closest(value, ["a", "b"]).endswith("Valid names: a, b.")
    if name == "environments" and text is not None:
        with pytest.raises(SettingError, match="size = "):
            Fleet(Scenario(), value)


@LENIENT
@given(text=st.one_of(st.text(max_size=40), st.text(alphabet='[]{}",:&*<x1e+.-! \n#', max_size=60)))
def test_texts_are_read_or_refused(text: str) -> None:
    refused(lambda: from_json(text))
    refused(lambda: training.assigned("ppo", training.OWN, [text]))
    refused(lambda: training.assigned("ppo", training.OWN, [f"n_steps={text}", f"policy_kwargs={text}"]))
