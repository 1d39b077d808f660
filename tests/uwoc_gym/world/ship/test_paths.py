from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from uwoc_gym import (
    CirclePath,
    EpisodeSettings,
    LawnMowerPath,
    PaperPath,
    RandomPath,
    RecordedPath,
    Scenario,
    SettingError,
    StraightPath,
)

KNOTS = np.linspace(0.0, 60.0, 31)
RECORD = {"time_s": KNOTS, "x_m": 8 * np.sin(0.15 * KNOTS), "y_m": 0.5 * KNOTS, "yaw_rad": np.sin(0.1 * KNOTS)}

PATHS = {
    "paper": PaperPath(radius_m=8.0, rate_rad_s=-0.13, swing_rad=1.1),
    "straight": StraightPath(x_m=1.0, y_m=-2.0, course_rad=2.5, speed_mps=0.7),
    "circle to starboard": CirclePath(x_m=3.0, y_m=-1.0, radius_m=6.0, speed_mps=0.8, start_angle_rad=0.9),
    "circle to port": CirclePath(radius_m=6.0, speed_mps=0.8, start_angle_rad=-2.0, turn="port"),
    "random": RandomPath(course_rad=1.0, wander=0.9),
    "lawn-mower to starboard": LawnMowerPath(course_rad=0.6, leg_length_m=10.0, spacing_m=5.0),
    "lawn-mower to port": LawnMowerPath(course_rad=-2.6, leg_length_m=7.0, spacing_m=4.0, speed_mps=0.6, turn="port"),
    "recorded": RecordedPath(**RECORD),
    "recorded without yaw": RecordedPath(time_s=KNOTS, x_m=RECORD["x_m"], y_m=RECORD["y_m"]),
}
ALONG_COURSE = [name for name in PATHS if name not in ("paper", "recorded", "recorded without yaw")]


@pytest.fixture(params=PATHS)
def path(request):
    return PATHS[request.param]


@pytest.fixture(params=ALONG_COURSE)
def along_course(request):
    return PATHS[request.param]


def turned(angle):
    """Angles on the side of zero that is nearer."""
    return np.remainder(np.asarray(angle) + math.pi, 2 * math.pi) - math.pi


def smooth_times(path, h):
    """Times more than h away from where acceleration jumps: ends of arcs, samples of a record."""
    times = np.linspace(0.01, 58.0, 997)
    jumps = np.empty(0)
    if isinstance(path, LawnMowerPath):
        arc = math.pi * path.spacing_m / 2
        starts = np.arange(20) * (path.leg_length_m + arc)
        jumps = np.concatenate([starts, starts + path.leg_length_m]) / path.speed_mps
    if isinstance(path, RecordedPath):
        jumps = KNOTS
    near = np.abs(times[:, None] - jumps).min(axis=1, initial=math.inf) < 2 * h
    return times[~near]


def test_velocity_and_acceleration_are_derivatives(path):
    h = 1e-3
    times = smooth_times(path, h)
    assert times.size > 900
    here, before, after = (path.at(times + shift, seed=3) for shift in (0.0, -h, h))
    slope = after.pose - before.pose
    slope[:, 2] = turned(slope[:, 2])
    np.testing.assert_allclose(here.velocity, slope / (2 * h), rtol=0, atol=2e-6)
    slope = (after.velocity - before.velocity) / (2 * h)
    np.testing.assert_allclose(here.acceleration, slope, rtol=0, atol=2e-6)


def test_path_is_continuous(path):
    times = np.arange(0.0, 59.0, 0.01)
    motion = path.at(times, seed=3)
    step = np.diff(motion.pose, axis=0)
    step[:, 2] = turned(step[:, 2])
    # One step goes no further than the velocity on either side allows.
    speed = np.maximum(np.abs(motion.velocity[1:]), np.abs(motion.velocity[:-1]))
    assert (np.abs(step) <= 0.01 * speed + 1e-4).all()
    assert np.abs(np.diff(motion.velocity[:, :2], axis=0)).max() < 0.01


@pytest.mark.parametrize("name", [name for name in PATHS if name != "random"])
def test_fleet_sails_the_same_path(name, fly):
    path = PATHS[name]
    scenario = Scenario(ship=path, episode=EpisodeSettings(duration_s=50.0, lost_distance_m=1e6))
    flight = fly(scenario)
    for _ in range(8):
        state = flight.step(0.0, 97)
        motion = path.at(state["time_s"])
        np.testing.assert_allclose(state["ship_pose"], motion.pose, rtol=0, atol=1e-12)
        np.testing.assert_allclose(state["ship_velocity"], motion.velocity, rtol=0, atol=1e-12)
        np.testing.assert_allclose(state["ship_acceleration"], motion.acceleration, rtol=0, atol=1e-12)


def test_fleet_sails_a_mixture_of_paths(fly):
    # Each lane of a block must move on its own path, whatever the others do.
    paths = [PATHS["paper"], PATHS["circle to port"], PATHS["lawn-mower to port"], PATHS["recorded"]]
    scenario = Scenario(ship=paths, episode=EpisodeSettings(duration_s=50.0, lost_distance_m=1e6))
    state = fly(scenario, 40).step(0.0, 700)
    motions = [path.at(35.0) for path in paths]
    sailed = []
    for lane in range(40):
        same = [np.allclose(state["ship_pose"][lane], motion.pose[0], rtol=0, atol=1e-11) for motion in motions]
        assert sum(same) == 1
        sailed.append(same.index(True))
        expected = motions[sailed[-1]]
        np.testing.assert_allclose(state["ship_velocity"][lane], expected.velocity[0], rtol=0, atol=1e-11)
        np.testing.assert_allclose(state["ship_acceleration"][lane], expected.acceleration[0], rtol=0, atol=1e-11)
    assert set(sailed) == {0, 1, 2, 3}


def test_random_paths_of_a_fleet_differ(fly):
    scenario = Scenario(ship=RandomPath(x_m=2.0, course_rad=0.0), episode=EpisodeSettings(lost_distance_m=1e6))
    flight = fly(scenario, 20)
    np.testing.assert_allclose(flight.fleet.state()["ship_pose"][:, :2], [[2.0, 0.0]] * 20, atol=1e-12)
    state = flight.step(0.0, 100)
    assert len(np.unique(state["ship_pose"][:, 0])) == 20
    speed = np.hypot(*state["ship_velocity"][:, :2].T)
    assert (speed >= 0.8 * 0.4 - 1e-12).all()
    assert (speed <= 0.8 * 1.6 + 1e-12).all()


def test_heading_is_along_the_course(along_course):
    motion = along_course.at(np.linspace(0.0, 60.0, 301), seed=1)
    course = np.arctan2(motion.velocity[:, 1], motion.velocity[:, 0])
    np.testing.assert_allclose(turned(motion.pose[:, 2] - course), 0.0, atol=1e-12)


def test_paper_path():
    t = np.linspace(0.0, 150.0, 1501)
    motion = PaperPath().at(t)
    expected = [10 * np.sin(0.1 * t), 10 * np.sin(0.1 * t + math.pi / 2), math.pi / 2 * np.sin(0.1 * t)]
    np.testing.assert_allclose(motion.pose, np.transpose(expected), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*motion.velocity[:, :2].T), 1.0, rtol=1e-12)
    np.testing.assert_allclose(motion.pose[0], [0.0, 10.0, 0.0], atol=1e-12)


def test_paper_path_with_other_numbers():
    t = np.linspace(0.0, 100.0, 101)
    motion = PATHS["paper"].at(t)
    expected = [8 * np.sin(-0.13 * t), 8 * np.cos(0.13 * t), 1.1 * np.sin(-0.13 * t)]
    np.testing.assert_allclose(motion.pose, np.transpose(expected), rtol=0, atol=1e-12)


def test_straight_path():
    t = np.array([0.0, 10.0])
    motion = PATHS["straight"].at(t)
    np.testing.assert_allclose(motion.pose[0], [1.0, -2.0, 2.5])
    np.testing.assert_allclose(motion.pose[1], [1 + 7 * math.cos(2.5), -2 + 7 * math.sin(2.5), 2.5], rtol=1e-14)
    assert not motion.acceleration.any()


@pytest.mark.parametrize(("turn", "sense"), [("starboard", 1.0), ("port", -1.0)])
def test_circle(turn, sense):
    circle = CirclePath(x_m=3.0, y_m=-1.0, radius_m=6.0, speed_mps=0.8, start_angle_rad=0.9, turn=turn)
    t = np.linspace(0.0, 40.0, 401)
    motion = circle.at(t)
    arm = motion.pose[:, :2] - (3.0, -1.0)
    np.testing.assert_allclose(np.hypot(*arm.T), 6.0, rtol=1e-12)
    np.testing.assert_allclose(np.hypot(*motion.velocity[:, :2].T), 0.8, rtol=1e-12)
    np.testing.assert_allclose(motion.velocity[:, 2], sense * 0.8 / 6.0, rtol=1e-12)
    np.testing.assert_allclose(arm[0], [6 * math.cos(0.9), 6 * math.sin(0.9)], rtol=1e-12)
    # x is north and y east, so starboard lies at (−sin yaw, cos yaw): the centre must be there.
    starboard = np.stack([-np.sin(motion.pose[:, 2]), np.cos(motion.pose[:, 2])], axis=1)
    np.testing.assert_allclose((starboard * -arm).sum(axis=1), sense * 6.0, rtol=1e-12)


@pytest.mark.parametrize(("turn", "sense"), [("starboard", 1.0), ("port", -1.0)])
def test_lawn_mower(turn, sense):
    course, leg, spacing, speed = 0.6, 10.0, 5.0, 0.5
    path = LawnMowerPath(
        x_m=2.0, y_m=1.0, course_rad=course, leg_length_m=leg, spacing_m=spacing, speed_mps=speed, turn=turn
    )
    arc = math.pi * spacing / 2
    # Distance travelled, then where that is along and across the first leg, and the heading there.
    expected = np.array(
        [
            (0.0, 0.0, 0.0, 0.0),
            (4.0, 4.0, 0.0, 0.0),
            (leg, leg, 0.0, 0.0),
            (leg + arc / 2, leg + spacing / 2, spacing / 2, math.pi / 2),
            (leg + arc, leg, spacing, math.pi),
            (leg + arc + 3.0, leg - 3.0, spacing, math.pi),
            (2 * leg + 1.5 * arc, -spacing / 2, 1.5 * spacing, math.pi / 2),
            (2 * leg + 2 * arc + 1.0, 1.0, 2 * spacing, 0.0),
            (7 * (leg + arc) + 1.0, leg - 1.0, 7 * spacing, math.pi),
        ]
    )
    travelled, along, across, heading = expected.T
    motion = path.at(travelled / speed)
    across = sense * across
    x = 2.0 + along * math.cos(course) - across * math.sin(course)
    y = 1.0 + along * math.sin(course) + across * math.cos(course)
    np.testing.assert_allclose(motion.pose[:, :2], np.stack([x, y], axis=1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned(motion.pose[:, 2] - course - sense * heading), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*motion.velocity[:, :2].T), speed, rtol=1e-12)


def test_lawn_mower_stays_in_its_strips():
    path = LawnMowerPath(leg_length_m=10.0, spacing_m=4.0)
    pose = path.at(np.linspace(0.0, 100.0, 2001)).pose
    assert pose[:, 0].min() == pytest.approx(-2.0, abs=0.01)
    assert pose[:, 0].max() == pytest.approx(12.0, abs=0.01)
    assert (np.diff(pose[:, 1]) >= -1e-12).all()


def test_random_path_never_stops():
    t = np.linspace(0.0, 300.0, 3001)
    path = RandomPath(course_rad=0.0, speed_mps=0.8, wander=0.9)
    slowest = []
    for seed in range(20):
        speed = np.hypot(*path.at(t, seed=seed).velocity[:, :2].T)
        assert speed.min() >= 0.8 * 0.1 - 1e-12
        assert speed.max() <= 0.8 * 1.9 + 1e-12
        slowest.append(speed.min())
    # It does wander.
    assert min(slowest) < 0.4


def test_random_path_starts_where_it_should_and_follows_its_course():
    path = RandomPath(x_m=3.0, y_m=-4.0, course_rad=1.0, speed_mps=0.8)
    for seed in range(5):
        pose = path.at([0.0, 3000.0], seed=seed).pose
        np.testing.assert_allclose(pose[0, :2], [3.0, -4.0], atol=1e-12)
        np.testing.assert_allclose(pose[1, :2], [2400 * math.cos(1.0), 2400 * math.sin(1.0)], atol=30.0)


def test_random_path_seeds():
    path = RandomPath(course_rad=0.0)
    t = np.linspace(0.0, 60.0, 61)
    poses = [path.at(t, seed=seed).pose for seed in (0, 1, 2, 0)]
    np.testing.assert_array_equal(poses[0], poses[3])
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(poses[a] - poses[b]).max() > 0.1


def test_random_path_without_wander_is_straight():
    motion = RandomPath(course_rad=0.7, wander=0.0).at(np.linspace(0.0, 60.0, 61))
    straight = StraightPath(course_rad=0.7, speed_mps=0.8).at(np.linspace(0.0, 60.0, 61))
    for got, expected in zip(motion, straight, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_recorded_path_goes_through_its_samples():
    pose = RecordedPath(**RECORD).at(KNOTS).pose
    np.testing.assert_allclose(pose[:, 0], RECORD["x_m"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose[:, 1], RECORD["y_m"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(turned(pose[:, 2] - RECORD["yaw_rad"]), 0.0, atol=1e-12)


def test_recorded_path_is_a_cubic_spline():
    t = np.linspace(0.0, 60.0, 1234)
    motion = RecordedPath(**RECORD).at(t)
    for axis, name in enumerate(("x_m", "y_m", "yaw_rad")):
        spline = CubicSpline(KNOTS, RECORD[name])
        for order, got in enumerate(motion):
            np.testing.assert_allclose(got[:, axis], spline(t, order), rtol=0, atol=1e-12)


def test_recorded_path_without_yaw_heads_along_its_course():
    motion = PATHS["recorded without yaw"].at(KNOTS)
    course = np.arctan2(motion.velocity[:, 1], motion.velocity[:, 0])
    np.testing.assert_allclose(turned(motion.pose[:, 2] - course), 0.0, atol=1e-12)


def test_recorded_yaw_takes_the_short_way_round():
    yaw = turned(np.linspace(3.0, 3.6, 7))
    path = RecordedPath(time_s=np.arange(7.0), x_m=np.arange(7.0), y_m=np.zeros(7), yaw_rad=yaw)
    np.testing.assert_allclose(path.at(np.linspace(0.0, 6.0, 50)).velocity[:, 2], 0.1, rtol=1e-9)


@pytest.mark.parametrize("names", [["time_s", "x_m", "y_m", "yaw_rad"], ["y_m", "time_s", "x_m"]])
def test_recorded_path_from_csv(tmp_path, names):
    file = tmp_path / "path.csv"
    rows = [",".join(names)] + [",".join(repr(float(RECORD[name][i])) for name in names) for i in range(31)]
    file.write_text("\n".join(rows) + "\n")
    assert RecordedPath.from_csv(file) == RecordedPath(**{name: RECORD[name] for name in names})
    assert RecordedPath.from_csv(str(file)).end_time_s == 60.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,x_m\n0,0\n1,1\n2,2\n3,3\n", "RecordedPath needs the setting 'y_m'"),
        ("", "RecordedPath needs the setting 'time_s'"),
        ("time_s,x_m,y_m\n", "RecordedPath needs the setting 'time_s'"),
        ("time,x_m,y_m\n0,0,0\n", "no column 'time'; did you mean 'time_s'"),
        (
            "time_s,x_m,y_m\n0,0,0\n1,one,1\n",
            "column 'x_m' = 'one' in row 2 is not allowed; it must be a finite number",
        ),
        (
            "time_s,x_m,y_m\n0,0,0\n1,1\n",
            r"row 2 = \['1', '1'\] is not allowed; it must have a cell for each of the 3 columns time_s, x_m, y_m",
        ),
        ("time_s,x_m,y_m\n0,0,0\n1,nan,1\n2,2,2\n3,3,3\n", "column 'x_m' = 'nan' in row 2 is not allowed"),
        ("time_s,x_m,y_m\n0,0,0\n1,1,1\n\n2,2,2,2\n3,3,3\n", r"row 3 = \['2', '2', '2', '2'\] is not allowed"),
        ("time_s,x_m,x_m,y_m\n0,0,0,0\n", "column 'x_m' stands there 2 times; it must be there once"),
        ("time_s,x_m,y_m\n0,0,0\n1,1,1\n2,2,202\n3,3,3\n", r"x_m\[2\], y_m\[2\] = 2.0, 202.0 .*row 3 .* 100 m/s"),
        ("time_s,x_m,y_m\n0,0,0\n1,1,1\n1,2,2\n3,3,3\n", r"time_s\[2\] = 1.0 .*in row 3 it must be above"),
        ("time_s,x_m,y_m\n0,0,0\n1,1e300,-1e308\n2,1e308,1e308\n3,3,3\n", "100 m/s"),
        ("time_s,x_m,y_m\n0,\x00,0\n", "is not allowed|NUL"),
    ],
)
def test_bad_csv(tmp_path, text, message):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(SettingError, match=message):
        RecordedPath.from_csv(file)


def test_csv_may_begin_with_a_byte_order_mark(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("\ufefftime_s, x_m, y_m\r\n0,0,0\r\n1,1,1\r\n2,2,2\r\n3,3,3\r\n", encoding="utf-8", newline="")
    assert RecordedPath.from_csv(file).x_m == (0.0, 1.0, 2.0, 3.0)


def test_missing_csv(tmp_path):
    with pytest.raises(FileNotFoundError):
        RecordedPath.from_csv(tmp_path / "none.csv")


FOUR = [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_s": FOUR[:3], "x_m": FOUR[:3], "y_m": FOUR[:3]}, "four or more increasing times that start at 0"),
        ({"time_s": [0.0, 1.0, 1.0, 2.0]}, r"time_s\[2\] = 1.0 is not allowed; .* above that of the row before, 1.0"),
        ({"time_s": [0.0, 2.0, 1.0, 3.0]}, r"time_s\[2\] = 1.0 is not allowed"),
        ({"time_s": [1.0, 2.0, 3.0, 4.0]}, "start at 0"),
        ({"x_m": FOUR[:3]}, "RecordedPath.x_m has 3 samples; .* as many as time_s, 4"),
        ({"y_m": [*FOUR, 4.0]}, "RecordedPath.y_m has 5 samples; .* 4"),
        ({"yaw_rad": [0.0]}, "RecordedPath.yaw_rad has 1 samples; .* 4"),
        (
            {"x_m": [0.0, math.nan, 2.0, 3.0]},
            r"RecordedPath.x_m\[1\] = nan is not allowed; it must be a finite number \[m\]",
        ),
        (
            {"yaw_rad": [0.0, math.inf, 2.0, 3.0]},
            r"RecordedPath.yaw_rad\[1\] = inf is not allowed; it must be a finite number \[rad\]",
        ),
        ({"y_m": [[0.0, 1.0], [2.0, 3.0]]}, r"RecordedPath.y_m\[0\] = \[0.0, 1.0\] is not allowed"),
        ({"y_m": "abcd"}, "RecordedPath.y_m = 'abcd' is not allowed; it must be a one-dimensional"),
    ],
)
def test_bad_record(changes, message):
    with pytest.raises(SettingError, match=message):
        RecordedPath(**({"time_s": FOUR, "x_m": FOUR, "y_m": FOUR} | changes))


@pytest.mark.parametrize("time", [-0.001, math.nan, math.inf, [1.0, -1.0]])
def test_time_outside(path, time):
    with pytest.raises(ValueError, match=r"time_s = .* is not allowed; .* in \[0, "):
        path.at(time)


def test_time_after_the_record():
    with pytest.raises(ValueError, match=r"time_s = .* is not allowed; .* in \[0, 60\] \[s\]"):
        PATHS["recorded"].at([0.0, 60.001])


def test_time_may_be_a_number():
    motion = PATHS["circle to port"].at(3)
    assert motion.pose.shape == motion.velocity.shape == motion.acceleration.shape == (1, 3)


@pytest.mark.parametrize(
    ("path_with_range", "name"),
    [(PaperPath(radius_m=(5, 6)), "PaperPath.radius_m"), (RandomPath(), "RandomPath.course_rad")],
)
def test_range_has_no_place(path_with_range, name):
    with pytest.raises(SettingError, match=rf"{name} is the range .* use midpoint\(\)"):
        path_with_range.at(0.0)
    assert np.isfinite(path_with_range.midpoint().at(0.0).pose).all()
