"""The link against the equations of the paper, written out here a second time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from uwoc_gym import Cone, OpticalLink, SettingError
from uwoc_gym.world.optics.link import inverse_q_function, q_function

LINK = OpticalLink()
CHARGE = 1.602176634e-19
SETTINGS = settings(derandomize=True, deadline=None)

ORDER = -math.log(2) / math.log(math.cos(math.pi / 12))


def received(d: float, angle: float) -> float:
    intensity = 0.1 * (ORDER + 1) / (2 * math.pi * d**2) * math.cos(angle) ** ORDER
    area = 1.52**2 / math.sin(math.pi / 6) ** 2 * 1e-4 * math.cos(angle)
    return intensity * area * math.exp(-0.15 * d)


def background(d: float, angle: float, printed: bool) -> float:
    surface = 0.7645 * 0.95 * 30
    if not printed:
        return surface * 1e-4
    return surface * math.exp(-0.3 * d) * 1.52**2 / 0.25 * 1e-4 * math.cos(angle)


def rate(d: float, angle: float, printed: bool = False, ber: float = 1e-4) -> float:
    current = 0.6 * received(d, angle)
    return (current / stats.norm.isf(ber)) ** 2 / (2 * CHARGE * 0.6 * background(d, angle, printed))


PLACES = [(1.0, 0.0), (3.8149, 0.0), (4.4, 0.5), (8.03, 0.2)]


@pytest.mark.parametrize(("d", "angle"), PLACES)
@pytest.mark.parametrize("printed", [False, True])
def test_methods_against_the_paper(d, angle, printed):
    link = OpticalLink(background="printed" if printed else "surface")
    current = 0.6 * received(d, angle)
    variance = 2 * CHARGE * 0.6 * background(d, angle, printed) * 10e6
    assert link.received_power(d, angle) == pytest.approx(received(d, angle), rel=1e-12)
    assert link.photocurrent(d, angle) == pytest.approx(current, rel=1e-12)
    assert link.background_power(d, angle) == pytest.approx(background(d, angle, printed), rel=1e-12)
    assert link.noise_variance(d, angle, 10e6) == pytest.approx(variance, rel=1e-12)
    assert link.snr(d, angle, 10e6) == pytest.approx(current**2 / variance, rel=1e-12)
    expected_ber = stats.norm.sf(current / variance**0.5)
    assert link.ber(d, angle, 10e6) == pytest.approx(expected_ber, rel=1e-10, abs=1e-300)
    assert link.bit_rate(d, angle) == pytest.approx(rate(d, angle, printed), rel=1e-12)
    assert link.bit_rate(d, angle, ber=1e-6) == pytest.approx(rate(d, angle, printed, 1e-6), rel=1e-12)


def test_lambertian_order():
    assert LINK.lambertian_order == pytest.approx(ORDER, rel=1e-14)
    assert LINK.lambertian_order == pytest.approx(19.99, abs=0.01)
    # A half-power angle of 60° is the plain Lambertian emitter.
    assert OpticalLink(half_power_angle_rad=math.pi / 3).lambertian_order == pytest.approx(1.0, rel=1e-14)


def test_radiant_intensity():
    at_axis = 0.1 * (ORDER + 1) / (2 * math.pi * 4.0)
    assert LINK.radiant_intensity(2.0, 0.0) == pytest.approx(at_axis, rel=1e-14)
    assert LINK.radiant_intensity(2.0, math.pi / 12) == pytest.approx(at_axis / 2, rel=1e-12)
    assert LINK.radiant_intensity(2.0, -math.pi / 12) == pytest.approx(at_axis / 2, rel=1e-12)
    assert LINK.radiant_intensity(2.0, 2.0) == 0.0


def test_effective_area():
    assert LINK.effective_area(0.0) == pytest.approx(1.52**2 * 4 * 1e-4, rel=1e-12)
    assert LINK.effective_area(0.4) == pytest.approx(1.52**2 * 4 * 1e-4 * math.cos(0.4), rel=1e-12)
    assert LINK.effective_area(math.radians(30)) > 0.0
    assert LINK.effective_area(math.radians(30.001)) == 0.0


def test_power_over_a_hemisphere_is_the_transmitters():
    # Integrating I_s over a sphere of radius d must give back P.
    angle = np.linspace(0.0, math.pi / 2, 20_001)
    flux = np.asarray(LINK.radiant_intensity(3.0, angle)) * 2 * math.pi * 3.0**2 * np.sin(angle)
    assert np.trapezoid(flux, angle) == pytest.approx(0.1, rel=1e-6)


def test_paper_cone():
    cone = LINK.cone()
    assert cone.half_angle_rad == math.radians(30)
    slant = optimize.brentq(lambda d: rate(d, math.pi / 6) - 10e6, 1.0, 20.0, xtol=1e-13)
    assert cone.slant_height_m == pytest.approx(slant, rel=1e-11)
    assert cone.slant_height_m == pytest.approx(4.406, rel=1e-3)
    assert cone.height_m == pytest.approx(3.8157, rel=1e-3)
    assert cone.height_m == pytest.approx(slant * math.cos(math.pi / 6), rel=1e-11)
    assert cone.footprint_radius_m(cone.height_m) == pytest.approx(slant / 2, rel=1e-9)
    assert 8.5e9 < LINK.bit_rate(cone.height_m, 0.0) < 9.5e9


def test_printed_background_cone():
    slant = OpticalLink(background="printed").cone().slant_height_m
    assert 3.5 < slant < 3.65
    expected = optimize.brentq(lambda d: rate(d, math.pi / 6, True) - 10e6, 1.0, 20.0, xtol=1e-13)
    assert slant == pytest.approx(expected, rel=1e-11)


def test_cone_at_another_rate():
    cone = LINK.cone(1e6)
    assert rate(cone.slant_height_m, math.pi / 6) == pytest.approx(1e6, rel=1e-9)
    assert cone.slant_height_m > LINK.cone().slant_height_m


def test_footprint_radius():
    cone = Cone(math.radians(30), 4.0)
    assert cone.height_m == pytest.approx(4 * math.cos(math.radians(30)))
    assert cone.footprint_radius_m(1.0) == pytest.approx(math.tan(math.radians(30)))
    # Below the rim the region's end is a spherical cap.
    assert cone.footprint_radius_m(3.8) == pytest.approx((16 - 3.8**2) ** 0.5)
    assert cone.footprint_radius_m(4.0) == 0.0
    assert cone.footprint_radius_m(7.0) == 0.0


@pytest.mark.parametrize("depth", [0.0, -1.0, math.nan])
def test_footprint_refuses_depth(depth):
    with pytest.raises(ValueError, match=r"depth_m = .* above 0 \[m\]"):
        Cone(0.5, 4.0).footprint_radius_m(depth)


@pytest.mark.parametrize("background_form", ["surface", "printed"])
def test_outside_the_field_of_view(background_form):
    link = OpticalLink(background=background_form)
    for angle in (0.53, -0.53, 1.6, 3.0):
        assert link.received_power(2.0, angle) == 0.0
        assert link.photocurrent(2.0, angle) == 0.0
        assert link.snr(2.0, angle, 1e6) == 0.0
        assert link.ber(2.0, angle, 1e6) == 0.5
        assert link.bit_rate(2.0, angle) == 0.0
        assert link.range_at(1e6, angle) == 0.0


@SETTINGS
@given(st.floats(0.0, 37.0))
def test_q_function(x):
    assert q_function(x) == pytest.approx(stats.norm.sf(x), rel=1e-12)


@SETTINGS
@given(st.floats(1e-300, 0.4999))
def test_inverse_q_function(p):
    assert inverse_q_function(p) == pytest.approx(stats.norm.isf(p), rel=1e-9, abs=1e-12)


def test_q_function_of_arrays():
    x = np.array([[-2.0, 0.0], [1.0, 3.0]])
    np.testing.assert_allclose(q_function(x), stats.norm.sf(x), rtol=1e-13)
    assert type(q_function(1)) is float


LINKS = st.builds(
    OpticalLink,
    power_w=st.floats(1e-3, 10.0),
    half_power_angle_rad=st.floats(0.05, 1.2),
    field_of_view_rad=st.floats(0.1, 1.4),
    attenuation_per_m=st.floats(0.0, 3.0),
    detector_area_m2=st.floats(1e-6, 1e-2),
    background=st.sampled_from(["surface", "printed"]),
    target_ber=st.floats(1e-12, 0.4),
)
SHARES = st.floats(0.0, 0.99)


@SETTINGS
@given(LINKS, SHARES, st.floats(1e3, 1e12))
def test_range_at_undoes_bit_rate(link, share, wanted):
    angle = share * link.field_of_view_rad
    d = link.range_at(wanted, angle)
    assert d > 0.0
    # Far beyond any link's reach, powers fall below the smallest double.
    assume(link.attenuation_per_m * d < 100.0)
    assert link.bit_rate(d, angle) == pytest.approx(wanted, rel=1e-9)


@SETTINGS
@given(LINKS, SHARES, st.floats(0.5, 10.0), st.floats(1e-12, 0.4))
def test_ber_undoes_bit_rate(link, share, d, ber):
    angle = share * link.field_of_view_rad
    bits = link.bit_rate(d, angle, ber)
    assert link.ber(d, angle, bits) == pytest.approx(ber, rel=1e-7)


@SETTINGS
@given(LINKS, SHARES, st.floats(0.5, 10.0), st.floats(1.01, 3.0))
def test_bit_rate_falls_with_range_and_angle(link, share, d, factor):
    angle = share * link.field_of_view_rad
    assert link.bit_rate(d * factor, angle) < link.bit_rate(d, angle)
    assert link.bit_rate(d, angle / factor) >= link.bit_rate(d, angle)


METHODS = ["radiant_intensity", "received_power", "photocurrent", "background_power", "bit_rate"]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("form", ["surface", "printed"])
def test_arrays_broadcast(method, form):
    function = getattr(OpticalLink(background=form), method)
    d = np.array([[1.0], [2.0], [4.0]])
    angle = np.array([0.0, 0.3, 0.6, -0.3])
    got = function(d, angle)
    assert got.shape == (3, 4)
    assert got.dtype == np.float64
    expected = [[function(float(each[0]), float(a)) for a in angle] for each in d]
    np.testing.assert_allclose(got, expected, rtol=1e-14)


@pytest.mark.parametrize("method", ["noise_variance", "snr", "ber"])
def test_arrays_broadcast_with_bit_rate(method):
    function = getattr(LINK, method)
    bits = np.array([1e6, 1e8]).reshape(2, 1, 1)
    got = function(np.array([[1.0], [2.0], [5.0]]), [0.0, 0.6], bits)
    assert got.shape == (2, 3, 2)
    assert got[1, 2, 0] == pytest.approx(function(5.0, 0.0, 1e8), rel=1e-14)
    assert got[0, 1, 1] == pytest.approx(function(2.0, 0.6, 1e6), rel=1e-14)


def test_range_at_broadcasts():
    got = LINK.range_at([[1e6], [1e7]], [0.0, 0.3, 0.6])
    assert got.shape == (2, 3)
    assert got[1, 1] == pytest.approx(LINK.range_at(1e7, 0.3), rel=1e-14)
    assert (got[:, 2] == 0.0).all()


def test_scalars_give_float():
    for d, angle in ((2, 0), (np.float64(2.0), np.array(0.1))):
        results = [getattr(LINK, method)(d, angle) for method in METHODS]
        results += [getattr(LINK, method)(d, angle, 1e7) for method in ("noise_variance", "snr", "ber")]
        results += [LINK.effective_area(angle), LINK.range_at(1e7, angle)]
        assert {type(result) for result in results} == {float}


def test_max_bit_rate_caps():
    link = OpticalLink(max_bit_rate_bps=50e6)
    assert link.bit_rate(3.8, 0.0) == 50e6
    assert link.bit_rate(4.3, 0.5) == LINK.bit_rate(4.3, 0.5) < 50e6
    np.testing.assert_array_equal(link.bit_rate([3.8, 3.8], [0.0, 1.0]), [50e6, 0.0])
    assert link.range_at(50e6, 0.1) == LINK.range_at(50e6, 0.1)
    assert link.range_at(51e6, 0.1) == 0.0
    assert link.cone() == LINK.cone()
    with pytest.raises(ValueError, match=r"bit_rate_bps = 60000000.0 .* at most max_bit_rate_bps = 50000000.0"):
        link.cone(60e6)


def test_threshold_above_the_cap():
    with pytest.raises(SettingError, match=r"max_bit_rate_bps = 1000000.0 .* threshold_bit_rate_bps = 10000000.0"):
        OpticalLink(max_bit_rate_bps=1e6)


@pytest.mark.parametrize("d", [0.0, -1.0, math.nan, math.inf, [1.0, 0.0]])
@pytest.mark.parametrize("method", METHODS)
def test_range_is_checked(method, d):
    with pytest.raises(ValueError, match=r"range_m = .* must be finite and above 0"):
        getattr(LINK, method)(d, 0.0)


@pytest.mark.parametrize("angle", [math.nan, math.inf, [0.0, -math.inf]])
@pytest.mark.parametrize("method", METHODS)
def test_angle_is_checked(method, angle):
    with pytest.raises(ValueError, match=r"pointing_error_rad = .* must be finite \[rad\]"):
        getattr(LINK, method)(1.0, angle)


@pytest.mark.parametrize("method", ["noise_variance", "snr", "ber"])
@pytest.mark.parametrize("bits", [0.0, -1.0, math.nan])
def test_bit_rate_is_checked(method, bits):
    with pytest.raises(ValueError, match=r"bit_rate_bps = .* must be finite and above 0"):
        getattr(LINK, method)(1.0, 0.0, bits)
    with pytest.raises(ValueError, match=r"bit_rate_bps = .* must be finite and above 0"):
        LINK.range_at(bits, 0.0)


@pytest.mark.parametrize("ber", [0.0, 0.5, 0.7, -1e-3, math.nan])
def test_ber_is_checked(ber):
    with pytest.raises(ValueError, match=r"ber = .* number in \(0, 0.5\)"):
        LINK.bit_rate(1.0, 0.0, ber=ber)
    with pytest.raises(SettingError, match=r"OpticalLink.target_ber = .* number in \[1e-15, 0.49\]"):
        OpticalLink(target_ber=ber)


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("power_w", 0.0, r"\[1e-06, 1000\] \[W\]"),
        ("half_power_angle_rad", 1.6, r"\[0.01, 1.5\] \[rad\]"),
        ("field_of_view_rad", -0.1, r"\[0.01, 1.5\] \[rad\]"),
        ("refractive_index", 0.9, r"\[1, 4\] \[1\]"),
        ("attenuation_per_m", -0.1, r"\[0, 10\] \[1/m\]"),
        ("water_transmittance", 1.1, r"\[1e-06, 1\] \[1\]"),
        ("threshold_bit_rate_bps", 0.0, r"\[1, 1e\+15\] \[bit/s\]"),
        ("detector_area_m2", "big", r"\[1e-09, 1\] \[m\^2\]"),
        ("responsivity_a_per_w", math.nan, r"\[0.001, 10\] \[A/W\]"),
    ],
)
def test_settings_name_field_value_and_bounds(field, value, allowed):
    with pytest.raises(SettingError, match=rf"OpticalLink.{field} = {value!r} is not allowed; .*{allowed}"):
        OpticalLink(**{field: value})


def test_unknown_background():
    with pytest.raises(SettingError, match=r"OpticalLink.background = 'surfaec' .* did you mean 'surface'\?"):
        OpticalLink(background="surfaec")


def test_range_has_no_value():
    link = OpticalLink(power_w=(0.1, 0.2))
    with pytest.raises(SettingError, match=r"OpticalLink.power_w is the range \(0.1, 0.2\)"):
        link.bit_rate(1.0, 0.0)
    assert link.midpoint().bit_rate(3.0, 0.1) == pytest.approx(2.25 * LINK.bit_rate(3.0, 0.1), rel=1e-9)
