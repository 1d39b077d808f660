"""The scripted controllers against the paper's matrix formulas and its published nominal runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from uwoc_gym import Scenario, SettingError, unpack
from uwoc_gym.baselines import GAINS, Controller, Gains, NLPDController, PDController, gains
from uwoc_gym.baselines.controller import gain
from uwoc_gym.baselines.controllers import CONTROLLERS, KINDS, TUNED, Tuned, begun, tuned_for
from uwoc_gym.scenario import SCENARIOS
from uwoc_gym.sim.fleet import Fleet
from uwoc_gym.sim.layout import FLAGS, OUT_ROWS

SIZE = Scenario().observation.size
PAPER_CLOCK = {"episode": {"control_period_s": 0.005, "integration_step_s": 0.005}}
SKEWED = Gains(
    a_p=(300.0, 200.0, 90.0),
    a_v=(250.0, 120.0, 60.0),
    b_p=(0.5, 0.01, 0.2),
    b_v=(0.3, 1.0, 0.05),
    mu_p=(0.9, 0.3, 0.0),
    mu_v=(0.2, 0.7, 1.0),
)


def rotation(yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def paper_gain(e: float, a: float, b: float, mu: float) -> float:
    return a * abs(e) ** (mu - 1.0) if abs(e) >= b else a * b ** (mu - 1.0)


def paper_force(g: Gains, eta, nu, eta_ref, eta_ref_dot, eta_ref_ddot) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The law with the earth-frame matrices of the paper's sec. 3, numbers from its table 3."""
    m11, m22, m33 = 100.0, 250.0, 80.0
    u, v, r = nu
    M = np.diag([m11, m22, m33])
    C = np.array([[0.0, 0.0, -m22 * v], [0.0, 0.0, m11 * u], [m22 * v, -m11 * u, 0.0]])
    D = np.diag([70.0 + 100.0 * abs(u), 100.0 + 200.0 * abs(v), 50.0 + 100.0 * abs(r)])
    R = rotation(eta[2])
    # Ṙ by differencing R along the turn, so that its derivative isn't written down a second time.
    h = 1e-6
    R_dot = (rotation(eta[2] + r * h) - rotation(eta[2] - r * h)) / (2.0 * h)
    M_eta, D_eta = R @ M @ R.T, R @ D @ R.T
    C_eta = R @ (C - M @ R.T @ R_dot) @ R.T
    error = eta_ref - eta
    error[2] = np.angle(np.exp(1j * error[2]))
    drift = eta_ref_dot - R @ nu
    Kp = np.diag([paper_gain(*x) for x in zip(error, g.a_p, g.b_p, g.mu_p, strict=True)])
    Kv = np.diag([paper_gain(*x) for x in zip(drift, g.a_v, g.b_v, g.mu_v, strict=True)])
    bracket = Kp @ error + Kv @ drift
    if g.feedforward:
        bracket = bracket + M_eta @ eta_ref_ddot + C_eta @ eta_ref_dot + D_eta @ eta_ref_dot
    return R.T @ bracket


def observe(eta, nu, eta_ref, eta_ref_dot, eta_ref_ddot) -> np.ndarray:  # type: ignore[no-untyped-def]
    """A noise-free observation of that state in float64."""
    R = rotation(eta[2])
    si = np.zeros(SIZE)
    si[0:2] = (R.T @ (eta_ref - eta))[:2]
    si[2:4] = np.cos(eta_ref[2] - eta[2]), np.sin(eta_ref[2] - eta[2])
    si[4:7] = R.T @ eta_ref_dot - nu
    si[7:10] = nu
    si[10:13] = R.T @ eta_ref_ddot
    si[13:15] = np.cos(eta[2]), np.sin(eta[2])
    return si / Scenario().observation.entry_scales


def random_states(count: int) -> list[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng(7)
    spread = ([5.0, 5.0, 6.0], [1.5, 1.5, 0.8], [5.0, 5.0, 6.0], [1.0, 1.0, 0.5], [0.3, 0.3, 0.2])
    states = [tuple(rng.uniform(-1.0, 1.0, 3) * s for s in spread) for _ in range(count)]
    # Errors within b are rare among the first half; the second half has nothing else.
    for eta, nu, ref, ref_dot, _ in states[count // 2 :]:
        ref[:] = eta + rng.uniform(-0.02, 0.02, 3)
        ref_dot[:] = rotation(eta[2]) @ nu + rng.uniform(-0.02, 0.02, 3)
    return states


@pytest.mark.parametrize(
    "gain_set", [SKEWED, replace(SKEWED, feedforward=False), *GAINS.values()], ids=["skewed", "bare", *GAINS]
)
def test_law_is_the_papers_in_the_earth_frame(gain_set: Gains) -> None:
    controller = Controller(gain_set)
    states = random_states(60)
    force = controller.force(np.array([observe(*state) for state in states]))
    expected = np.array([paper_force(gain_set, *state) for state in states])
    assert force.dtype == np.float64
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-6)


def test_fleets_observation_carries_all_that_the_law_needs() -> None:
    scenario = Scenario.named("Nominal")
    fleet = Fleet(scenario, 3)
    fleet.seed(np.arange(3), [1, 2, 3])
    obs = np.empty((3, SIZE), np.float32)
    pose = [[5.0, 5.0, 0.0], [1.0, 8.0, 2.5], [-3.0, 12.0, -1.3]]
    fleet.reset(obs, pose=pose, velocity=[[0.0, 0.0, 0.0], [0.7, -0.4, 0.2], [-0.5, 0.9, -0.3]])
    s = fleet.state()
    names = ("pose", "velocity", "ship_pose", "ship_velocity", "ship_acceleration")
    expected = [paper_force(SKEWED, *(s[name][i].copy() for name in names)) for i in range(3)]
    np.testing.assert_allclose(Controller(SKEWED, scenario).force(obs), expected, rtol=1e-5, atol=1e-2)


def test_yaw_error_is_wrapped() -> None:
    still = np.zeros(3)
    obs = observe(np.array([0.0, 0.0, 3.0]), still, np.array([0.0, 0.0, -3.0]), still.copy(), still.copy())
    assert PDController().force(obs)[2] == pytest.approx(300.0 * (2.0 * np.pi - 6.0))


def test_pd_is_the_nlpd_with_unit_exponents() -> None:
    obs = np.array([observe(*state) for state in random_states(20)])
    linear = replace(gains("nlpd"), mu_p=1.0, mu_v=1.0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(PDController().force(obs), NLPDController(linear).force(obs))
    assert not np.allclose(PDController().force(obs), NLPDController().force(obs), rtol=1e-3)


def test_pd_refuses_other_exponents() -> None:
    with pytest.raises(SettingError, match=r"Gains\.mu_p = \(0\.946.*PDController.*must be 1"):
        PDController("nlpd")


def test_gain_values_and_continuity() -> None:
    a, b, mu = 300.0, 0.25, 0.5
    assert gain(4.0, a, b, mu) == pytest.approx(150.0)
    assert gain(-4.0, a, b, mu) == pytest.approx(150.0)
    assert gain(1.0, a, b, mu) == pytest.approx(300.0)
    for inside in (0.0, 0.1, -0.2499, 0.25):
        assert gain(inside, a, b, mu) == pytest.approx(600.0)
    below, above = gain(np.nextafter(b, 0.0), a, b, mu), gain(np.nextafter(b, 1.0), a, b, mu)
    assert below == pytest.approx(above, rel=1e-12)
    # mu = 0 keeps the size of the force, mu = 1 the gain.
    e = np.array([0.3, 2.0, 50.0])
    np.testing.assert_allclose(gain(e, a, b, 0.0) * e, 300.0)
    np.testing.assert_array_equal(gain(e, a, b, 1.0), 300.0)


def test_batch_agrees_with_single_observations() -> None:
    obs = np.array([observe(*state) for state in random_states(12)])
    controller = NLPDController()
    batch = controller.force(obs)
    for i, single in enumerate(obs):
        np.testing.assert_allclose(controller.force(single), batch[i], rtol=1e-13, atol=1e-12)
    np.testing.assert_array_equal(controller.force(obs.reshape(3, 4, SIZE)), batch.reshape(3, 4, 3))


def test_predict_is_called_like_a_stable_baselines_policy() -> None:
    obs = np.array([observe(*state) for state in random_states(12)], dtype=np.float32)
    controller = NLPDController()
    action, state = controller.predict(obs)
    assert action.dtype == np.float32
    assert action.shape == (12, 3)
    assert state is None
    expected = np.clip(controller.force(obs) / [2000.0, 2000.0, 500.0], -1.0, 1.0)
    np.testing.assert_array_equal(action, expected.astype(np.float32))
    memory = (np.ones(2),)
    single, state = controller.predict(obs[0], memory, np.array([True]), deterministic=False)
    assert single.shape == (3,)
    assert state is memory


def test_predict_clips_to_the_scenarios_limits() -> None:
    obs = np.zeros((2, SIZE), np.float32)
    obs[:, 13] = obs[:, 2] = 1.0
    obs[:, 0] = 5.0, -5.0
    wide = PDController()
    assert wide.predict(obs)[0][:, 0] == pytest.approx([1.0, -1.0])
    assert abs(wide.force(obs)[0, 0]) == pytest.approx(6000.0)
    strong = Scenario().merged({"vehicle": {"max_surge_force_n": 12000.0}})
    assert PDController(scenario=strong).predict(obs)[0][:, 0] == pytest.approx([0.5, -0.5])


def test_controller_knows_only_the_nominal_vehicle() -> None:
    obs = np.array([observe(*state) for state in random_states(8)])
    plant = {"mass_scale": 1.4, "damping_scale": (0.5, 0.9), "mass_surge_kg": (90.0, 110.0)}
    other = Scenario().merged({"vehicle": plant})
    np.testing.assert_array_equal(PDController(scenario=other).force(obs), PDController().force(obs))


def test_controller_reads_the_scenarios_scales() -> None:
    state = random_states(1)[0]
    coarse = Scenario().merged({"observation": {"position_scale_m": 8.0, "velocity_scale_mps": 2.0}})
    ratio = Scenario().observation.entry_scales / coarse.observation.entry_scales
    obs = observe(*state)
    np.testing.assert_allclose(PDController(scenario=coarse).force(obs * ratio), PDController().force(obs))


@pytest.mark.parametrize("shape", [(), (19,), (4, 21), (20, 4), (2, 3, 20)])
def test_wrong_observation_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"observation has shape .* must be"):
        PDController().predict(np.zeros(shape, np.float32))


def test_unknown_names_give_the_nearest() -> None:
    with pytest.raises(SettingError, match=r"no gain set 'nlp'; did you mean 'nlpd'\?"):
        gains("nlp")
    with pytest.raises(SettingError, match="did you mean 'pd-plain'"):
        PDController("pd-plan")
    with pytest.raises(SettingError, match="did you mean 'Nominal'"):
        PDController(scenario="Nominall")
    with pytest.raises(SettingError, match="gains = 3 is not allowed"):
        Controller(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("a_p", 0.0, r"\(0, inf\)"),
        ("a_v", (1.0, -2.0, 1.0), r"\(0, inf\)"),
        ("b_p", (1.0, 1.0), r"three of them \(x, y, yaw\)"),
        ("b_v", float("nan"), r"\(0, inf\)"),
        ("a_v", float("inf"), r"\(0, inf\)"),
        ("mu_p", (0.5, 1.1, 1.0), r"\[0, 1\]"),
        ("mu_v", -0.1, r"\[0, 1\]"),
        ("mu_v", True, r"\[0, 1\]"),
        ("a_p", "300", r"\(0, inf\)"),
        ("feedforward", 1, "True or False"),
        ("source", 3, "a text"),
    ],
)
def test_bad_gains_name_field_value_and_range(name: str, value: object, allowed: str) -> None:
    with pytest.raises(SettingError, match=rf"Gains\.{name} = .* is not allowed; it must be .*{allowed}"):
        replace(SKEWED, **{name: value})  # type: ignore[arg-type]


def test_gains_are_triples_with_a_source() -> None:
    spread = replace(SKEWED, a_p=10, mu_v=np.array([0.1, 0.2, 0.3]))  # type: ignore[arg-type]
    assert spread.a_p == (10.0, 10.0, 10.0)
    assert spread.mu_v == (0.1, 0.2, 0.3)
    assert all(g.source for g in GAINS.values())
    assert hash(spread) != hash(SKEWED)


def test_imports_no_learning_library() -> None:
    code = "import sys, uwoc_gym.baselines; sys.exit('torch' in sys.modules or 'stable_baselines3' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def fly(controller: Controller, scenario: Scenario) -> tuple[float, np.ndarray, float]:
    """Arrival time [s], RMSE of x, y and yaw from arrival to the end, and the largest action of a nominal run."""
    n = 1
    fleet = Fleet(scenario, n)
    fleet.seed(np.arange(n), [0])
    obs, out = np.empty((n, SIZE), np.float32), np.empty((OUT_ROWS, n))
    flags = np.empty((len(FLAGS), n), np.bool_)
    fleet.reset(obs)
    errors, largest = [], 0.0
    arrival = np.nan
    for step in range(scenario.episode.steps):
        action, _ = controller.predict(obs)
        fleet.step(action, obs, out, flags)
        largest = max(largest, float(np.abs(action).max()))
        state = fleet.state()
        if np.isnan(arrival) and state["in_cone"][0]:
            arrival = (step + 1) * scenario.episode.control_period_s
        if not np.isnan(arrival):
            errors.append(state["ship_pose"][0] - state["pose"][0])
    return arrival, np.sqrt(np.mean(np.square(errors), axis=0)), largest


def test_plain_pd_reproduces_the_published_pd_row() -> None:
    scenario = Scenario().merged(PAPER_CLOCK | {"vehicle": {"coriolis": False}})
    arrival, rmse, largest = fly(PDController("pd-plain", scenario), scenario)
    assert arrival == pytest.approx(2.015, abs=0.0051)
    assert rmse == pytest.approx([0.4583, 0.4557, 0.0230], rel=0.02)
    assert largest < 1.0


def test_printed_pd_does_better_than_published() -> None:
    scenario = Scenario().merged(PAPER_CLOCK)
    arrival, rmse, largest = fly(PDController("pd", scenario), scenario)
    assert arrival == pytest.approx(2.330, abs=0.0051)
    assert rmse == pytest.approx([0.079, 0.108, 0.037], abs=0.0006)
    assert largest < 1.0


def test_nlpd_reproduces_the_published_nlpd_row() -> None:
    scenario = Scenario().merged(PAPER_CLOCK)
    arrival, rmse, largest = fly(NLPDController("nlpd", scenario), scenario)
    assert arrival == pytest.approx(2.315, abs=0.0051)
    assert rmse == pytest.approx([0.0596, 0.1197, 0.0408], rel=0.005)
    assert largest < 1.0


def test_one_gain_set_per_observation():
    observations = np.random.default_rng(5).uniform(-1, 1, (3, 20)).astype(np.float32)
    names = ("pd", "pd-plain", "nlpd")
    together = Controller(names).force(observations)
    for i, name in enumerate(names):
        np.testing.assert_array_equal(together[i], Controller(name).force(observations[i]))


@pytest.mark.parametrize("bad", [[], [1.0], 3])
def test_refuses_what_is_no_gain_set(bad):
    with pytest.raises(SettingError, match=r"gains = .* is not allowed; it must be a Gains"):
        Controller(bad)


def test_controllers_fly_the_gains_of_their_name():
    assert [name for name in CONTROLLERS if name in GAINS] == list(GAINS)
    observation = np.random.default_rng(6).uniform(-1, 1, 20).astype(np.float32)
    for name in GAINS:
        made = CONTROLLERS[name].make(Scenario())
        np.testing.assert_array_equal(made.predict(observation)[0], Controller(GAINS[name]).predict(observation)[0])


@pytest.mark.parametrize(
    ("former", "name"),
    [("paper-pd", "pd"), ("paper-pd-plain", "pd-plain"), ("paper", "nlpd"), ("tuned-pd", "pd-tuned"),
     ("tuned-nlpd", "nlpd-tuned")],
)  # fmt: skip
def test_former_names_of_gain_sets_are_known(former, name):
    assert gains(former) is GAINS[name]
    assert Controller(former).gain_sets == (GAINS[name],)


def test_feedforward_is_against_the_water_that_a_filter_believes_in():
    still = np.zeros(SIZE)
    still[[2, 13]] = 1.0
    seen = unpack(still, Scenario().observation)
    law = PDController()
    np.testing.assert_allclose(law.force_for(seen), 0.0, atol=1e-12)
    # The ship and the AUV lie still in water that flows from ahead at 0.5 m/s.
    held = law.force_for(seen._replace(water_velocity=np.array([-0.5, 0.0])))
    np.testing.assert_allclose(held, [(70.0 + 100.0 * 0.5) * 0.5, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("law", KINDS)
def test_what_a_law_is_set_by_is_written_and_read_again(law: str) -> None:
    kind = KINDS[law].gains
    for own in (Tuned(law, gains("nlpd-tuned") if kind is Gains else kind(), "a search"), begun(law)):
        again = Tuned.from_dict(json.loads(json.dumps(own.to_dict())))
        assert again.law == law
        assert again.to_dict() == own.to_dict()


def test_gains_say_by_their_names_what_flies_them() -> None:
    assert Tuned.from_dict({"a_p": [1, 1, 1], "a_v": [1, 1, 1]}).law == "nlpd"
    assert Tuned.from_dict({"place_m": 0.5}).law == "lqr"
    assert Tuned.from_dict({"crab": 0.5}).law == "los"
    assert Tuned.from_dict({"horizon_s": 0.5}).law == "mppi"
    for wrong, said in (
        ({"law": "pdd"}, "law = 'pdd' is not allowed; did you mean 'pd'"),
        ({"law": "lqr", "crab": 1.0}, "crab"),
        ([], "it must be a mapping of gains"),
    ):
        with pytest.raises(SettingError) as caught:
            Tuned.from_dict(wrong)  # type: ignore[arg-type]
        assert said in str(caught.value)


def test_tuned_sets_are_of_named_scenarios_and_laws() -> None:
    for path in TUNED.glob("*/*.json"):
        assert path.parent.name in SCENARIOS
        own = tuned_for(path.parent.name)[path.stem]
        assert own.law == path.stem
        assert not re.search(r"(?<!\w)/", own.source), "a path of one machine"
        assert CONTROLLERS[f"{path.stem}@{path.parent.name}"].needs == ()
        assert begun(f"{path.stem}@{path.parent.name}") == own
