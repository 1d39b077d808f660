from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from uwoc_gym import (
    SCENARIOS,
    CirclePath,
    Current,
    EpisodeSettings,
    LawnMowerPath,
    ObservationSettings,
    OpticalLink,
    PaperPath,
    Pulse,
    RandomPath,
    Range,
    RecordedPath,
    RewardSettings,
    Scenario,
    Sea,
    Sensors,
    SettingError,
    Start,
    StraightPath,
    Vehicle,
)
from uwoc_gym.parameters import ChoiceSpec, FlagSpec, NamesSpec, NumberSpec, Parameters
from uwoc_gym.scenario import DESCRIPTIONS, as_scenario, name_scenario

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)


def same_after_json(scenario: Scenario) -> bool:
    return Scenario.from_json(scenario.to_json()) == scenario


@pytest.mark.parametrize("name", SCENARIOS)
def test_named_scenarios_survive_json(name):
    scenario = Scenario.named(name)
    assert scenario is SCENARIOS[name]
    assert same_after_json(scenario)
    assert Scenario.from_dict(scenario.to_dict()) == scenario


def test_json_is_plain():
    data = json.loads(Scenario.named("Random").to_json())
    assert data["vehicle"]["mass_scale"] == [0.8, 1.2]
    assert data["ship"][0]["kind"] == "random"
    assert data["sea"]["pulses"][1]["frame"] == "earth"
    assert data["depth_m"] is None


def test_recorded_path_survives_json():
    t = np.arange(0.0, 200.0, 10.0)
    path = RecordedPath(time_s=t, x_m=np.sin(t), y_m=t / 3)
    assert same_after_json(Scenario(ship=path))
    assert same_after_json(Scenario(ship=[PaperPath(), path]))


def values_of(spec, default):
    """Values that a field allows, as plain data; numbers within half of the default, so that most can be flown."""
    if isinstance(spec, FlagSpec):
        return st.booleans()
    if isinstance(spec, ChoiceSpec):
        one = st.sampled_from(spec.options)
        # Several are kept in the order of the options.
        several = st.lists(one, min_size=2, unique=True).map(lambda names: sorted(names, key=spec.options.index))
        return one | several if spec.randomisable else one
    if isinstance(spec, NamesSpec):
        return st.lists(st.sampled_from(spec.options), min_size=1, unique=True)
    assert isinstance(spec, NumberSpec)
    middle = 0.0 if default is None else float(np.mean(default))
    reach = 0.5 * abs(middle) or 0.5
    number = st.floats(max(spec.low, middle - reach), min(spec.high, middle + reach))
    if not spec.randomisable:
        return number
    return number | st.lists(number, min_size=2, max_size=2).map(sorted)


def overrides_of(parameters, without=()):
    defaults = {field.name: field.default for field in dataclasses.fields(parameters)}
    fields = {name: values_of(spec, defaults[name]) for name, spec in parameters.specs().items() if name not in without}
    return st.fixed_dictionaries({}, optional=fields)


SHIPS = st.one_of(
    *(
        st.builds(lambda kind, data: {"kind": kind, **data}, st.just(path.kind), overrides_of(path))
        for path in (PaperPath, StraightPath, CirclePath, RandomPath, LawnMowerPath)
    )
)
OVERRIDES = st.fixed_dictionaries(
    {},
    optional={
        "vehicle": overrides_of(Vehicle),
        # The cap on the bit rate must not lie below the threshold.
        "link": overrides_of(OpticalLink, without=("max_bit_rate_bps",)),
        "ship": SHIPS | st.lists(SHIPS, min_size=1, max_size=3),
        "sea": st.fixed_dictionaries(
            {}, optional={"pulses": st.lists(overrides_of(Pulse), max_size=2), "current": overrides_of(Current)}
        ),
        "sensors": overrides_of(Sensors),
        "start": overrides_of(Start),
        "reward": overrides_of(RewardSettings),
        "observation": overrides_of(ObservationSettings),
        "depth_m": st.none() | st.floats(0.1, 10.0) | st.just([2.0, 3.0]),
    },
)


def merged(base, overrides):
    """The scenario with overrides, of which a few together can't be flown."""
    try:
        return base.merged(overrides)
    except SettingError:
        reject()


@SETTINGS
@given(OVERRIDES)
def test_any_scenario_survives_json(overrides):
    for base in (Scenario(), Scenario.named("Random")):
        assert same_after_json(merged(base, overrides))


@SETTINGS
@given(OVERRIDES)
def test_overrides_take_effect(overrides):
    base = Scenario.named("Random")
    got, before = merged(base, overrides).to_dict(), base.to_dict()
    for group in ("vehicle", "link", "sensors", "start", "reward", "observation"):
        assert got[group] == before[group] | overrides.get(group, {})
    assert got["sea"]["current"] == before["sea"]["current"] | overrides.get("sea", {}).get("current", {})


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"vehicel": {}}, r"Scenario has no setting 'vehicel'; did you mean 'vehicle'\?"),
        ({"vehicle": {"mass_scal": 1.0}}, r"Vehicle has no setting 'mass_scal'; did you mean 'mass_scale'\?"),
        ({"sea": {"curent": {}}}, r"Sea has no setting 'curent'; did you mean 'current'\?"),
        ({"sea": {"current": {"std": 1.0}}}, r"Current has no setting 'std'; did you mean 'std_mps'\?"),
        ({"sea": {"pulses": [{}, {"force_x": 1.0}]}}, r"Pulse has no setting 'force_x'; did you mean 'force_x_n'\?"),
        ({"ship": {"kind": "circle", "radius": 3.0}}, r"CirclePath has no setting 'radius'; did you mean 'radius_m'\?"),
        ({"ship": [{"kind": "paper", "swing": 1.0}]}, r"PaperPath has no setting 'swing'; did you mean 'swing_rad'\?"),
        ({"ship": {"kind": "cirle"}}, r"Scenario.ship.kind = 'cirle' is not allowed; did you mean 'circle'\?"),
        ({"ship": [{"kind": "lawnmower"}]}, r"Scenario.ship\[0\].kind = 'lawnmower' .* did you mean 'lawn-mower'\?"),
        ({"ship": {"radius_m": 3.0}}, r"needs a 'kind'. Valid names: paper, straight, circle"),
        ({"link": {"background": "print"}}, r"OpticalLink.background = 'print' .* did you mean 'printed'\?"),
        ({"sea": {"pulses": [{"frame": "erth"}]}}, r"Pulse.frame = 'erth' .* did you mean 'earth'\?"),
        ({"episode": {"zzzz": 1}}, r"EpisodeSettings has no setting 'zzzz'; Valid names: duration_s, "),
    ],
)
def test_unknown_names(data, message):
    with pytest.raises(SettingError, match=message):
        Scenario.from_json(json.dumps(data))
    if data.get("ship") != {"radius_m": 3.0}:
        with pytest.raises(SettingError, match=message):
            Scenario().merged(data)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "The scenario '{' isn't valid JSON"),
        ("[1, 2]", "its JSON must be an object"),
        ('{"vehicle": 3}', "Scenario.vehicle = 3 is not allowed; it must be a Vehicle or a mapping"),
        ('{"ship": []}', r"Scenario.ship = \[\] is not allowed; it needs at least one of PaperPath"),
        ('{"ship": "circle"}', "Scenario.ship = 'circle' is not allowed"),
        ('{"sea": {"pulses": {}}}', r"Sea.pulses = {} is not allowed; it must be a list of at most 1000 Pulse"),
        ('{"vehicle": {"mass_scale": NaN}}', "Vehicle.mass_scale = nan is not allowed"),
        ('{"vehicle": {"mass_scale": "1"}}', "Vehicle.mass_scale = '1' is not allowed"),
        ('{"vehicle": {"mass_scale": true}}', "Vehicle.mass_scale = True is not allowed"),
        ('{"vehicle": {"mass_scale": null}}', "Vehicle.mass_scale = None is not allowed"),
        ('{"vehicle": {"coriolis": 1}}', "Vehicle.coriolis = 1 is not allowed; it must be True or False"),
    ],
)
def test_bad_json(text, message):
    with pytest.raises(SettingError, match=message):
        Scenario.from_json(text)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Vehicle(mass_scale=0.0), r"Vehicle.mass_scale = 0.0 .* \[0.1, 10\] \[1\]"),
        (lambda: Vehicle(damping_scale=-0.1), r"Vehicle.damping_scale = -0.1 .* \[0, 100\]"),
        (lambda: Vehicle(mass_scale=(0.0, 1.0)), r"Vehicle.mass_scale = \(0.0, 1.0\) is not allowed"),
        (lambda: Vehicle(mass_scale=(1.2, 0.8)), r"Vehicle.mass_scale = \(1.2, 0.8\) .* pair \(low, high\)"),
        (lambda: Vehicle(mass_scale=(1.0, 1.1, 1.2)), r"Vehicle.mass_scale = \(1.0, 1.1, 1.2\) is not allowed"),
        (lambda: Vehicle(mass_scale=(1.0, math.inf)), r"Vehicle.mass_scale = \(1.0, inf\) is not allowed"),
        (lambda: Vehicle(max_surge_force_n=(-1.0, 2.0)), r"Vehicle.max_surge_force_n = \(-1.0, 2.0\) .* \[0, 100000\]"),
        (lambda: RandomPath(wander=0.95), r"RandomPath.wander = 0.95 .* \[0, 0.9\]"),
        (lambda: Pulse(duration_s=-1.0), r"Pulse.duration_s = -1.0 .* \[0, 1e\+06\] \[s\]"),
        (lambda: Current(correlation_time_s=0.0), r"Current.correlation_time_s = 0.0 .* \[0.01, 1e\+06\] \[s\]"),
        (lambda: Sensors(yaw_std_rad=-1.0), r"Sensors.yaw_std_rad = -1.0 .* \[0, 3.2\] \[rad\]"),
        (lambda: Scenario(depth_m=0.0), r"Scenario.depth_m = 0.0 .* \[0.01, 10000\] \[m\] .* or None"),
        (lambda: Start(x_m=math.nan), r"Start.x_m = nan .* \[m\]"),
        (lambda: OpticalLink(target_ber=0.5), r"OpticalLink.target_ber = 0.5 .* \[1e-15, 0.49\]"),
        (lambda: OpticalLink(target_ber=0.0), r"OpticalLink.target_ber = 0.0 .* \[1e-15, 0.49\]"),
        (lambda: RewardSettings(effort=-1.0), r"RewardSettings.effort = -1.0 .* \[0, 1000\]"),
        (lambda: ObservationSettings(velocity_scale_mps=0.0), r"ObservationSettings.velocity_scale_mps = 0.0"),
        (
            lambda: EpisodeSettings(lost_distance_m=0.0),
            r"EpisodeSettings.lost_distance_m = 0.0 .* \[0.01, 1e\+06\] \[m\]",
        ),
    ],
)
def test_values_out_of_range(build, message):
    with pytest.raises(SettingError, match=message):
        build()


def all_parameters():
    found, waiting = [], [Parameters]
    while waiting:
        below = waiting.pop().__subclasses__()
        found += below
        waiting += below
    return found


@pytest.mark.parametrize("parameters", all_parameters(), ids=lambda each: each.__name__)
def test_every_number_has_finite_bounds_and_its_default_within(parameters):
    for field in dataclasses.fields(parameters):
        spec = parameters.specs().get(field.name)
        if isinstance(spec, NumberSpec):
            low, high = (spec.low, spec.high) if field.default is None else np.ravel(field.default)[[0, -1]]
            assert -math.inf < spec.low <= low <= high <= spec.high < math.inf, field.name


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"vehicle": {"mass_surge_kg": 1.0}}, r"integration_step_s = 0.005 .* 1.35e\+03 1/s"),
        ({"vehicle": {"damping_scale": 60}, "episode": {"integration_step_s": 0.025}}, "integration_step_s = 0.025"),
        ({"vehicle": {"mass_scale": 0.1}, "episode": {"integration_step_s": 0.05}}, "at most 0.0125 "),
        ({"vehicle": {"mass_scale": (0.1, 1.0)}, "episode": {"integration_step_s": 0.05}}, "at most 0.00714"),
        ({"vehicle": {"damping_scale": 0}, "episode": {"integration_step_s": 0.025}}, "gets as fast as 3.65e"),
        ({"sea": {"pulses": [{"force_x_n": 1e5}]}, "episode": {"integration_step_s": 0.05}}, "at most 0.01 "),
        ({"start": {"surge_mps": 20.0}, "episode": {"integration_step_s": 0.05}}, "integration_step_s = 0.05"),
        ({"depth_m": 4.5}, r"Scenario.depth_m = 4.5 .* below the cone.* at most 4.405 \[m\]"),
        ({"depth_m": (1.0, 4.5)}, r"Scenario.depth_m = Range\(low=1.0, high=4.5\) .* at most 4.405"),
        ({"depth_m": 3.0, "link": {"attenuation_per_m": (0.15, 1.0)}}, "Scenario.depth_m = 3.0 .* at most 2.1"),
        ({"link": {"threshold_bit_rate_bps": 1e15}}, "no light reaches it beyond 0.061 m"),
        ({"start": {"x_m": 50}}, r"Start.x_m = 50.0, y_m = 5.0 .* begin 50.25 m .*lost_distance_m = 20.0"),
        ({"start": {"x_m": (-1, 30)}}, "begin 30.4"),
        ({"start": {"x_m": 21, "relative_to_ship": True}}, "begin 21.5"),
        ({"ship": {"kind": "circle", "x_m": 13.0, "y_m": 5.0, "radius_m": (8.0, 12.5)}}, "begin 20.5 m"),
        (
            {"ship": {"kind": "circle", "x_m": 13.0, "y_m": 5.0, "start_angle_rad": (1, 7), "radius_m": 13}},
            "begin 21 m",
        ),
        ({"ship": [{"kind": "paper"}, {"kind": "straight", "x_m": 100.0}]}, "begin 95"),
    ],
)
def test_what_cannot_be_integrated_or_solved_is_refused(overrides, message):
    with pytest.raises(SettingError, match=message):
        Scenario().merged(overrides)


@pytest.mark.parametrize(
    "vehicle",
    [
        {"mass_surge_kg": 1.0},
        # No faster than it was, but what is wrong in a step is never damped away.
        {"linear_damping_sway": 0.0},
    ],
)
def test_the_step_that_an_error_names_will_do(vehicle):
    period, step = 0.05, 0.05
    while True:
        try:
            Scenario().merged({"vehicle": vehicle, "episode": {"integration_step_s": step}})
            break
        except SettingError as error:
            named = float(str(error).rpartition("at most ")[2].partition(" ")[0])
            assert named < step
            step = period / round(period / named)
            np.testing.assert_allclose(step, named, rtol=1e-12)
    assert step < period
    longer = period / (round(period / step) - 1)
    with pytest.raises(SettingError, match="integrator doesn't follow"):
        Scenario().merged({"vehicle": vehicle, "episode": {"integration_step_s": longer}})


def test_the_smallest_cone_is_that_of_the_worst_link():
    link = OpticalLink(attenuation_per_m=(0.15, 0.4), power_w=(0.05, 0.1), background=["surface", "printed"])
    worst = OpticalLink(attenuation_per_m=0.4, power_w=0.05).cone().slant_height_m
    printed = OpticalLink(attenuation_per_m=0.4, power_w=0.05, background="printed").cone().slant_height_m
    assert link.smallest_cone().slant_height_m == pytest.approx(min(worst, printed), rel=1e-12)
    assert OpticalLink().smallest_cone() == pytest.approx(OpticalLink().cone(), rel=1e-12)


def test_setting_error_is_a_value_error():
    assert issubclass(SettingError, ValueError)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"control_period_s": 0.05, "integration_step_s": 0.03},
            "control_period_s = 0.05 .* integration_step_s = 0.03",
        ),
        ({"control_period_s": 0.001}, "control_period_s = 0.001 .* integration_step_s = 0.005"),
        ({"duration_s": 1.02}, "duration_s = 1.02 .* multiple of control_period_s = 0.05"),
        ({"duration_s": 0.01}, "duration_s = 0.01 .* multiple of control_period_s = 0.05"),
    ],
)
def test_time_grid(changes, message):
    with pytest.raises(SettingError, match="EpisodeSettings." + message):
        EpisodeSettings(**changes)


def test_time_grid_counts():
    episode = EpisodeSettings()
    assert (episode.substeps, episode.steps) == (10, 3000)
    episode = EpisodeSettings(duration_s=0.3, control_period_s=0.1, integration_step_s=0.1)
    assert (episode.substeps, episode.steps) == (1, 3)


def test_record_shorter_than_the_episode():
    t = np.arange(0.0, 100.0)
    path = RecordedPath(time_s=t, x_m=t, y_m=t)
    with pytest.raises(SettingError, match=r"recorded path ends at 99 s, before the episode of 150 s"):
        Scenario(ship=path)
    with pytest.raises(SettingError, match="ends at 99 s"):
        Scenario(ship=[PaperPath(), path])
    assert Scenario(ship=path, episode=EpisodeSettings(duration_s=99.0)).ship == path


def test_merged_goes_deep():
    base = Scenario.named("CurrentPulse")
    merged = base.merged({"sea": {"current": {"speed_mps": 0.2}}, "vehicle": {"mass_scale": 1.1}})
    assert merged.sea.current == Current(speed_mps=0.2)
    assert merged.sea.pulses == base.sea.pulses
    assert merged.vehicle == Vehicle(mass_scale=1.1)
    assert merged.link is base.link
    assert base.vehicle.mass_scale == 1.0


def test_merged_ship():
    base = Scenario(ship=CirclePath(radius_m=7.0, turn="port"))
    assert base.merged({"ship": {"speed_mps": 0.5}}).ship == CirclePath(radius_m=7.0, turn="port", speed_mps=0.5)
    same_kind = {"ship": {"kind": "circle", "speed_mps": 0.5}}
    assert base.merged(same_kind).ship == CirclePath(radius_m=7.0, turn="port", speed_mps=0.5)
    assert base.merged({"ship": {"kind": "straight", "speed_mps": 0.5}}).ship == StraightPath(speed_mps=0.5)
    assert base.merged({"ship": PaperPath()}).ship == PaperPath()
    two = base.merged({"ship": [{"kind": "paper"}, StraightPath()]})
    assert two.ship == (PaperPath(), StraightPath())
    assert two.merged({"ship": {"kind": "circle"}}).ship_paths == (CirclePath(),)


def test_merged_pulses_replace():
    merged = Scenario.named("CurrentPulse").merged({"sea": {"pulses": [{"start_s": 1.0}, Pulse(start_s=2.0)]}})
    assert merged.sea.pulses == (Pulse(start_s=1.0), Pulse(start_s=2.0))
    assert merged.merged({"sea": {"pulses": []}}).sea == Sea()


@pytest.mark.parametrize("overrides", [3, [("vehicle", {})], None])
def test_merged_needs_a_mapping(overrides):
    with pytest.raises(SettingError, match=r"Scenario = .* is not allowed; changes to it must be a mapping"):
        Scenario().merged(overrides)


def test_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Scenario().vehicle = Vehicle()
    with pytest.raises(dataclasses.FrozenInstanceError):
        Vehicle().mass_scale = 2.0


def test_named_error():
    with pytest.raises(SettingError, match=r"no scenario 'Nominl'; did you mean 'Nominal'\? Valid names: Nominal, "):
        Scenario.named("Nominl")


def test_named_scenarios_are_the_papers():
    assert Scenario.named("Nominal") == Scenario()
    pulse = Pulse(start_s=30.0, duration_s=1.0, force_x_n=350.0, force_y_n=350.0, moment_nm=350.0, frame="body")
    assert Scenario.named("CurrentPulse") == Scenario(sea=Sea(pulses=(pulse,)))
    assert Scenario.named("MassError") == Scenario(sea=Sea(pulses=(pulse,)), vehicle=Vehicle(mass_scale=1.2))
    strong = Pulse(force_x_n=1500.0, force_y_n=1500.0, moment_nm=1500.0)
    assert Scenario.named("StrongPulse") == Scenario(sea=Sea(pulses=(strong,)))
    start = Scenario().start
    assert (start.x_m, start.y_m, start.yaw_rad, start.surge_mps) == (5.0, 5.0, 0.0, 0.0)


def test_as_scenario():
    scenario = Scenario.named("MassError")
    assert as_scenario(scenario) is scenario
    assert as_scenario("MassError") is scenario
    assert as_scenario({"depth_m": 2.0}, scenario) == scenario.merged({"depth_m": 2.0})
    assert as_scenario({"depth_m": 2.0}) == Scenario(depth_m=2.0)


def test_ranges():
    vehicle = Vehicle(mass_scale=np.array([0.8, 1.2]), damping_scale=[1, 2])
    assert vehicle.mass_scale == Range(0.8, 1.2)
    assert vehicle.damping_scale == Range(1.0, 2.0)
    assert vehicle.mass_scale.middle == 1.0
    assert Vehicle(mass_scale=np.float32(0.5)).mass_scale == 0.5


def test_midpoint():
    middle = Scenario.named("Random").midpoint()
    for group in ("vehicle", "start", "sensors", "link"):
        assert not any(isinstance(value, list) for value in middle.to_dict()[group].values())
    assert middle.vehicle.mass_scale == pytest.approx(1.0)
    assert middle.ship[0].speed_mps == pytest.approx(0.7)
    assert middle.sea.pulses[0].start_s == 17.5
    assert middle.sea.current.speed_mps == 0.15
    assert middle.start.relative_to_ship
    assert Scenario().midpoint() == Scenario()
    assert Scenario(depth_m=(2.0, 3.0)).midpoint().depth_m == 2.5


def test_drawn_values_follow_the_seed(fly):
    scenario = Scenario.named("Random")
    first = fly(scenario, 3, seeds=[1, 2, 1]).fleet.drawn()
    second = fly(scenario, 2, seeds=[2, 1]).fleet.drawn()
    for name, values in first.items():
        np.testing.assert_array_equal(values[0], values[2], err_msg=name)
        np.testing.assert_array_equal(values[:2], second[name][::-1], err_msg=name)
    assert first["vehicle.mass_scale"][0] != first["vehicle.mass_scale"][1]


def test_digest_tells_scenarios_apart():
    digests = {scenario.digest() for scenario in SCENARIOS.values()}
    assert len(digests) == len(SCENARIOS)
    nominal = SCENARIOS["Nominal"]
    assert Scenario().digest() == nominal.digest() == Scenario.from_json(nominal.to_json()).digest()
    # The smallest step of one number far down.
    assert nominal.merged({"vehicle": {"mass_surge_kg": np.nextafter(100.0, 101.0)}}).digest() != nominal.digest()


def test_what_is_drawn_is_said():
    assert [name for name, scenario in SCENARIOS.items() if not scenario.draws] == [
        "Nominal",
        "CurrentPulse",
        "MassError",
        "StrongPulse",
    ]
    assert Scenario(ship=RandomPath()).draws
    assert Scenario(ship=[StraightPath(), CirclePath()]).draws
    assert Scenario(sea=Sea(current=Current(std_mps=0.1))).draws
    assert Scenario(depth_m=(2.0, 3.0)).draws
    assert Scenario(sea=Sea(pulses=[Pulse(start_s=(1.0, 2.0))])).draws


def test_a_name_stands_for_one_scenario():
    assert set(DESCRIPTIONS) == set(SCENARIOS)
    name_scenario("Nominal", DESCRIPTIONS["Nominal"], SCENARIOS["Nominal"])
    with pytest.raises(SettingError, match="There is another scenario called 'Nominal'"):
        name_scenario("Nominal", "another", SCENARIOS["Random"])


def test_a_choice_can_be_drawn_like_a_number(fly):
    scenario = Scenario(
        ship=CirclePath(turn=["port", "starboard"]), link=OpticalLink(background=["printed", "surface"]), depth_m=3.0
    )
    assert scenario.ship.turn == ("starboard", "port")
    assert Scenario.from_json(scenario.to_json()) == scenario
    assert scenario.draws
    assert scenario.midpoint().ship.turn == "starboard"
    fleet = fly(scenario, 2000).fleet
    drawn, state = fleet.drawn(), fleet.state()
    for path in ("ship.turn", "link.background"):
        names, counts = np.unique(drawn[path], return_counts=True)
        assert len(names) == 2
        # Standard deviation of a count: √(2000 / 4) ≈ 22.
        assert np.abs(counts - 1000).max() < 100
    np.testing.assert_array_equal(state["ship_velocity"][:, 2] > 0.0, drawn["ship.turn"] == "starboard")
    slant = np.where(drawn["link.background"] == "surface", 4.405, 3.64)
    np.testing.assert_allclose(state["slant_height_m"], slant, rtol=0.03)
    seen = np.zeros((2000, 20), np.float32)
    fleet.reset(seen, parameters={"ship.turn": "port"})
    assert (fleet.drawn()["ship.turn"] == "port").all()
    with pytest.raises(ValueError, match=r"\['ship.turn'\] = 'left' is not allowed; .* one of 'starboard', 'port'"):
        fleet.reset(seen, parameters={"ship.turn": "left"})
    with pytest.raises(SettingError, match=r"turn is one of \('starboard', 'port'\), which is only drawn within"):
        scenario.ship.at(0.0)
    with pytest.raises(SettingError, match="use midpoint"):
        scenario.link.bit_rate(3.0, 0.0)


@pytest.mark.parametrize("turn", [[], ["port", "port"], ["port", "left"], "left", 3, None])
def test_choices_that_are_not_allowed(turn):
    with pytest.raises(SettingError, match=r"CirclePath\.turn = .* is not allowed; .*A list of several is drawn from"):
        CirclePath(turn=turn)
    assert CirclePath(turn=["port"]) == CirclePath(turn="port")


def test_the_nominal_model_is_followed_though_only_the_true_one_was_asked_for():
    step = {"integration_step_s": 0.001}
    light = Scenario().merged({"vehicle": {"mass_surge_kg": 2.0, "mass_scale": 10.0}, "episode": step})
    known = light.known()
    assert known.vehicle.mass_scale == 1.0
    assert known.episode.integration_step_s < light.episode.integration_step_s
    assert Scenario().known().episode == Scenario().episode
    with pytest.raises(SettingError, match=r"integration_step_s = 0.001 is not allowed"):
        light.known(integration_step_s=0.001)


@pytest.mark.parametrize("name", ["Random", "Tide", "PaperCaseI"])
def test_the_coarsest_step_in_which_the_model_is_followed(name):
    scenario = Scenario.named(name)
    coarsest = scenario.known(math.inf).episode
    assert scenario.known().episode.integration_step_s <= coarsest.integration_step_s <= coarsest.control_period_s
    substeps = coarsest.control_period_s / coarsest.integration_step_s
    assert substeps == pytest.approx(round(substeps))
    if substeps > 1.5:
        with pytest.raises(SettingError, match="integration_step_s"):
            scenario.known(coarsest.control_period_s / round(substeps - 1.0))


def test_a_ship_faster_than_any_is_refused():
    with pytest.raises(SettingError, match=r"PaperPath.radius_m = 1000.0 .* sail at 200 m/s; it must be at most 100"):
        PaperPath(radius_m=1000.0, rate_rad_s=(-0.2, 0.1))
