"""Bad inputs in code: each is refused in words that help, and nothing has changed.

`counts` tries them all and says how many were refused, how many by an error that names the field, the value and what
is allowed, and how many left what runs as it was.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from uwoc_gym import Fleet, Scenario, TrackingEnv, TrackingVectorEnv
from uwoc_gym.given import shown
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.sim.fleet import Autoreset

N = 3
DEEP: Any = []
for _ in range(100_000):
    DEEP = [DEEP]
HUGE = 10**400


class Case(NamedTuple):
    """Something that is to be refused."""

    field: str
    """What the error has to name."""
    value: Any
    """What the error has to show."""
    call: Callable[[Any], Any]
    """Does it to a running shell."""


class Nothing:
    """An object that is nothing in particular, and can't even be shown."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


NO_TRIPLES: tuple[Any, ...] = (
    "x", 5, True, {}, {"x": 1.0}, [], (1.0, 2.0), [1.0, 2.0, 3.0, 4.0], ["1", "2", "3"], [1.0, True, 2.0],
    [1.0, None, 2.0], (0.0, np.nan, 0.0), (0.0, np.inf, 0.0), (HUGE, 0.0, 0.0), (1j, 0.0, 0.0), DEEP, Nothing(),
    np.zeros((2, 2)), np.zeros((3, 1)), np.array(1.0), np.zeros(3, dtype=bool), np.array(["a", "b", "c"]),
    np.array([1.0, np.nan, 0.0], dtype=np.float32), [[1.0, 2.0, 3.0], [1.0]],
)  # fmt: skip
"""What isn't three finite numbers."""

NO_COUNTS: tuple[Any, ...] = (0, -1, 1.5, "1", "a", None, True, np.True_, [1], {}, np.nan, np.inf, HUGE, DEEP, 10**12)
"""What is no number of environments."""

NO_SEEDS: tuple[Any, ...] = (-1, 1.5, "a", True, np.True_, 2**64, np.nan, np.inf, {}, 1j, Nothing(), np.array([[1, 2]]))

PARAMETERS: tuple[tuple[str, Any], ...] = (
    ("options['parameters']", 5),
    ("options['parameters']", []),
    ("options['parameters']", {5: 1.0}),
    *(
        (f"options['parameters']['{name}']", {name: value})
        for name, value in (
            ("vehicle.mass", 1.0), ("vehicle.mass_scale", 5.0), ("vehicle.mass_scale", np.nan),
            ("vehicle.mass_scale", "1"), ("vehicle.mass_scale", True), ("vehicle.mass_scale", None),
            ("vehicle.mass_scale", [1.0] * 7), ("vehicle.mass_scale", DEEP), ("vehicle.mass_scale", HUGE),
            ("vehicle.mass_scale", {}), ("ship", 0.5), ("ship", 99), ("ship", "circle"), ("ship[2].turn", "up"),
            ("ship[2].turn", 1), ("ship[2].turn", [["port"]]), ("ship[2].turn", Nothing()),
        )
    ),
)  # fmt: skip

SCENARIOS: tuple[Any, ...] = (
    "Nominl", 5, True, [], DEEP, {"vehicl": {}}, {5: {}}, {"vehicle": {"mass_scale": "a"}}, {"vehicle": []},
    {"ship": {"kind": "square"}}, {"ship": {"kind": []}}, {"depth_m": -1.0}, {"sea": {"pulses": {}}},
    {"observation": {"groups": ["ship"]}}, {"action": "surge-yaw"}, {"start": {"relative_to_ship": 1}},
    {"episode": {"control_period_s": 1e-300}}, {"sea": {"pulses": [{}] * 1001}},
)  # fmt: skip

GOOD: dict[str, Any] = {"scenario": {"vehicle": {"damping_scale": 0.7}}, "pose": (1.0, 2.0, 0.5)}
"""What mustn't happen either, since it stands beside what is refused."""


class Shell:
    """A running environment of one kind, what to do to it, and all that it consists of."""

    lanes = 1

    def __init__(self) -> None:
        self.env = self.make()
        self.reset(seed=4)
        for _ in range(3):
            self.step(self.actions(0.3))

    def make(self) -> Any:
        return TrackingEnv(scenario="Random")

    def actions(self, value: float) -> Any:
        shape = (3,) if self.lanes == 1 else (self.lanes, 3)
        return np.full(shape, value, dtype=np.float32)

    def reset(self, seed: Any = None, options: Any = None) -> Any:
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> Any:
        return self.env.step(actions)

    def restore(self, rows: Any) -> Any:
        return self.env.restore(rows)

    def snapshot(self) -> Any:
        return self.env.snapshot()

    def everything(self) -> bytes:
        return pickle.dumps((self.env, self.env.np_random.bit_generator.state))

    def cases(self) -> Iterator[Case]:
        """All that this shell is to refuse."""
        for options in (5, "x", True, [], 0):
            yield Case("options", options, lambda own, o=options: own.reset(9, o))
        for name in ("speed", 5, "Pose", "scenarios"):
            yield Case(f"options[{name!r}]", name, lambda own, n=name: own.reset(9, {**GOOD, n: 1}))
        for key in ("pose", "velocity"):
            for value in NO_TRIPLES:
                yield Case(f"options['{key}']", value, lambda own, k=key, v=value: own.reset(9, {**GOOD, k: v}))
        for field, given in PARAMETERS:
            value = next(iter(given.values())) if "']['" in field and "vehicle.mass'" not in field else given
            shows = "vehicle.mass" if "vehicle.mass'" in field else value
            yield Case(field, shows, lambda own, p=given: own.reset(9, {**GOOD, "parameters": p}))
        for value in SCENARIOS:
            yield Case("options['scenario']", None, lambda own, s=value: own.reset(9, {**GOOD, "scenario": s}))
        for seed in NO_SEEDS:
            yield Case("seed", seed, lambda own, s=seed: own.reset(s, GOOD))
        for value in NO_TRIPLES:
            yield Case("action", value, lambda own, v=value: own.step(v))
        yield from self.further()

    def further(self) -> Iterator[Case]:
        for value in NO_TRIPLES:
            yield Case("impulse", value, lambda own, v=value: own.env.push(v))
        for rows in (None, "x", np.zeros(3), Fleet(Scenario(), 1).snapshot(), self.snapshot()[[0, 0]]):
            yield Case("rows", None, lambda own, r=rows: own.restore(r))


class Vector(Shell):
    lanes = N

    def make(self) -> Any:
        return TrackingVectorEnv(N, scenario="Random", max_episode_steps=20)

    def further(self) -> Iterator[Case]:
        for seed in ([1], [1, 2, -3], [1, 2, "a"], [1, 2, True], [1.5, 2, 3], (), range(4), np.array([1, 2, -1])):
            yield Case("seed", None, lambda own, s=seed: own.reset(s, GOOD))
        for mask in (
            True,
            5,
            "abc",
            [True],
            [1, 0, 1],
            [False] * N,
            [[True], [True, False]],
            np.ones(N),
            [None] * N,
            {},
        ):
            good = {"pose": GOOD["pose"]}
            yield Case("reset_mask", mask, lambda own, m=mask, g=good: own.reset(9, {**g, "reset_mask": m}))
        part = [True, False, True]
        yield Case("options['scenario']", None, lambda own: own.reset(9, {**GOOD, "reset_mask": part}))
        foreign = Fleet(Scenario(), N).snapshot()
        for rows, lanes in ((foreign, None), (self.snapshot()[:2], None), (self.snapshot(), [0]), (None, [0])):
            yield Case("rows", None, lambda own, r=rows, k=lanes: own.env.restore(r, k))
        for lanes in ([5], [-1], "a", [0.5], [True], [[0]], DEEP, {}):
            yield Case("lanes", lanes, lambda own, k=lanes: own.env.restore(own.snapshot()[:1], k))


class StableBaselines(Vector):
    def make(self) -> Any:
        return TrackingVecEnv("uwoc/Random-v0", N, max_episode_steps=20)

    def reset(self, seed: Any = None, options: Any = None) -> Any:
        if options is not None:
            self.env.set_options(options)
        try:
            if seed is not None:
                self.env.seed(seed)
        except ValueError:
            # The options were allowed, and would be used at the next reset.
            self.env.set_options()
            raise
        return self.env.reset()

    def snapshot(self) -> Any:
        return self.env.vector_env.snapshot()

    def everything(self) -> bytes:
        own = self.env
        return pickle.dumps((own.vector_env, own.get_attr("np_random")[0].bit_generator.state, own.reset_infos))

    def further(self) -> Iterator[Case]:
        other = [{"pose": (0.0, 0.0, 0.0)}, {"velocity": (0.0, 0.0, 0.0)}, {}]
        yield Case("options[1]", other[1], lambda own: own.reset(None, other))
        unlike = [{"scenario": {"depth_m": depth}} for depth in (2.0, 3.0, 3.0)]
        yield Case("'scenario'", None, lambda own: own.reset(None, unlike))
        names = [{"parameters": {"vehicle.mass_scale": 1.0}}] * 2 + [{"parameters": {}}]
        yield Case("options[2]['parameters']", {}, lambda own: own.reset(None, names))
        yield Case("options", None, lambda own: own.reset(None, [{}]))
        yield Case("options['reset_mask']", None, lambda own: own.reset(None, {"reset_mask": [True] * N}))


class Bare(Shell):
    lanes = N

    def make(self) -> Any:
        fleet = Fleet(Scenario.named("Random"), N, Autoreset.NEXT_STEP)
        fleet.seed(np.arange(N), [4, 5, 6])
        return fleet

    def reset(self, seed: Any = None, options: Any = None) -> Any:
        seen = np.zeros((N, 20), dtype=np.float32)
        self.env.reset(seen, **(options or {}))
        return seen

    def step(self, actions: Any) -> Any:
        seen, out, flags = np.zeros((N, 20), dtype=np.float32), np.empty((16, N)), np.zeros((4, N), dtype=bool)
        self.env.step(actions, seen, out, flags)
        return seen

    def everything(self) -> bytes:
        return pickle.dumps(self.env)

    def cases(self) -> Iterator[Case]:
        for key in ("pose", "velocity"):
            for value in NO_TRIPLES:
                yield Case(f"options['{key}']", value, lambda own, k=key, v=value: own.reset(None, {k: v}))
        for field, given in PARAMETERS:
            yield Case(field, None, lambda own, p=given: own.reset(None, {"parameters": p}))
        for seen in (np.zeros((N, 20)), np.zeros((N, 3), dtype=np.float32), np.zeros(20, dtype=np.float32)):
            yield Case("observations", None, lambda own, s=seen: own.env.reset(s))
        for lanes in ([5], [-1], "a", [0.5], [True], [[0]], DEEP, {}):
            yield Case("lanes", lanes, lambda own, k=lanes: own.reset(None, {"lanes": k}))
            yield Case("lanes", lanes, lambda own, k=lanes: own.env.snapshot(k))
        for value in NO_TRIPLES:
            yield Case("impulse", value, lambda own, v=value: own.env.push(np.arange(N), v))
            for key in ("pose", "velocity", "ship_pose", "ship_velocity"):
                yield Case(key, value, lambda own, k=key, v=value: own.believe(**{k: v}))
        for key, bad in (("time_s", ("x", -1.0, np.nan, True, None, HUGE, 1e300, [1.0], DEEP)),
                         ("ship_turn_rad_s", ("x", np.nan, True, None, [1.0], {}, DEEP, HUGE)),
                         ("current", ("x", 1.0, (1.0,), (np.nan, 0.0), None, (True, 0.0), DEEP))):  # fmt: skip
            for value in bad:
                if not (key == "current" and value is None):
                    yield Case(key, value, lambda own, k=key, v=value: own.believe(**{k: v}))
        for actions in ("x", None, 5, np.zeros((2, 3)), np.zeros((1, 2, 2)), np.full((1, 1, 3), np.nan), [[["a"] * 3]]):
            yield Case("actions", actions, lambda own, a=actions: own.env.rollout(own.snapshot()[:1], a))
        yield Case("rows", None, lambda own: own.env.rollout("x", np.zeros((1, 1, 3))))

    def believe(self, **changed: Any) -> None:
        zero = (0.0, 0.0, 0.0)
        self.env.believe(**{"pose": zero, "velocity": zero, "ship_pose": zero, "ship_velocity": zero, **changed})


SHELLS: dict[str, type[Shell]] = {
    "TrackingEnv": Shell, "TrackingVectorEnv": Vector, "TrackingVecEnv": StableBaselines, "Fleet": Bare,
}  # fmt: skip


def constructors() -> Iterator[Case]:
    """What can't be made."""
    for value in NO_COUNTS:
        yield Case("num_envs", value, lambda _, v=value: TrackingVectorEnv(v))
        yield Case("num_envs", value, lambda _, v=value: TrackingVecEnv("uwoc/Nominal-v0", v))
        yield Case("size", value, lambda _, v=value: Fleet(Scenario(), v))
        if value is not None:
            yield Case("threads", value, lambda _, v=value: TrackingVectorEnv(2, threads=v))
        if value not in (None, 10**12):
            yield Case("max_episode_steps", value, lambda _, v=value: TrackingVectorEnv(2, max_episode_steps=v))
    for value in ("human!", 5, [], {}, DEEP, np.zeros(2)):
        yield Case("render_mode", value, lambda _, v=value: TrackingEnv(render_mode=v))
        yield Case("autoreset_mode", value, lambda _, v=value: TrackingVectorEnv(2, autoreset_mode=v))
    for value in (5, "1280x720", (1280,), (1, 1), (1e9, 720), (1280.5, 720), (np.inf, 720), (10**9, 10**9), (True, 720),
                  DEEP, ("1280", "720"), None, {}):  # fmt: skip
        yield Case("render_size", value, lambda _, v=value: TrackingEnv(render_size=v))
    for value in ("x", True, -1.0, 0.0, np.nan, HUGE, [0.05, 0.1], DEEP, {}):
        yield Case("control_period_s", value, lambda _, v=value: TrackingEnv(control_period_s=v))
        yield Case("integration_step_s", value, lambda _, v=value: TrackingVectorEnv(2, integration_step_s=v))
    for value in (5, True, [], "Nominl", {"vehicl": {}}, {5: 5}, DEEP):
        yield Case("", None, lambda _, v=value: TrackingEnv(scenario=v))
        yield Case("", None, lambda _, v=value: TrackingVecEnv("uwoc/Nominal-v0", scenario=v))
    for value in (5, True, None, "Nominl", []):
        yield Case("scenario", value, lambda _, v=value: TrackingEnv(scenario_name=v))
        yield Case("scenario", value, lambda _, v=value: Fleet(v, 1))
    for value in ("speed", 5, ["speed"], [5], [[]]):
        yield Case("info_keys", None, lambda _, v=value: TrackingVecEnv("uwoc/Nominal-v0", info_keys=v))


def refusal(case: Case, own: Any) -> str | None:
    """What the error says; None if there is none. Anything but a `ValueError` goes through."""
    try:
        case.call(own)
    except ValueError as error:
        return str(error)
    return None


ALLOWED = ("must", "Valid names", "allowed are")


def helps(case: Case, text: str) -> bool:
    """Whether an error names the field, the value and what is allowed, on a line that can be read."""
    named = case.field in text and (case.value is None or shown(case.value) in text)
    return named and any(words in text for words in ALLOWED) and len(text) < 2500


def counts() -> dict[str, int]:
    """How many bad inputs were tried, refused, refused in words that help, and without leaving a trace."""
    found = dict.fromkeys(("tried", "refused", "in words that help", "without a trace"), 0)

    def note(case: Case, own: Any, before: Callable[[], bytes]) -> None:
        was = before()
        text = refusal(case, own)
        found["tried"] += 1
        found["refused"] += text is not None
        found["in words that help"] += text is not None and helps(case, text)
        found["without a trace"] += before() == was

    for kind in SHELLS.values():
        own = kind()
        for case in own.cases():
            note(case, own, own.everything)
    for case in constructors():
        note(case, None, bytes)
    return found


@pytest.mark.parametrize("kind", SHELLS.values(), ids=SHELLS)
def test_what_is_refused_changes_nothing(kind: type[Shell]) -> None:
    own, twin = kind(), kind()
    before = own.everything()
    tried = 0
    for case in own.cases():
        text = refusal(case, own)
        assert text is not None, (case.field, shown(case.value))
        assert helps(case, text), (case.field, text)
        assert own.everything() == before, (case.field, shown(case.value))
        tried += 1
    assert tried > 100
    for _ in range(2):
        for _ in range(4):
            np.testing.assert_array_equal(own.step(own.actions(-0.4))[0], twin.step(own.actions(-0.4))[0])
        np.testing.assert_array_equal(own.reset()[0], twin.reset()[0])
        assert own.snapshot().tobytes() == twin.snapshot().tobytes()


def test_what_cannot_be_made_says_why() -> None:
    for case in constructors():
        text = refusal(case, None)
        assert text is not None, (case.field, shown(case.value))
        assert helps(case, text), (case.field, text)
