"""The optical channel: from optical power to bit rate under solar noise, and the cone in which the link holds.

Equations of section 2 of N'Doye, Zhang, Alouini and Laleg-Kirati, "Establishing and Maintaining a Reliable Optical
Wireless Communication in Underwater Environment" (here: the paper). Each stands once, as a function of scalars that
compiled code calls; `OpticalLink` evaluates the same functions over arrays.

For a given link the bit rate is ln B = a + b ln d + c (d − 1) + e ln cos ψ in range d and pointing error ψ, which is
what an episode evaluates at every step.
"""

from __future__ import annotations

import itertools
import math
import statistics
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import equation, inlined, over_arrays
from uwoc_gym.compute.elementary import atan_below_one, exp, fma, log
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import Number, Parameters, SettingError, choice, number

ELEMENTARY_CHARGE_C = 1.602176634e-19
"""Charge of the electron [C], exact in the SI since 2019."""

PAPER = "paper, table 1"

LOWEST_CONE_M = 0.1
"""Slant height [m] below which there is no cone worth the name."""

Array = npt.NDArray[np.float64]

STATE = rows(
    # The link that the episode has drawn.
    "ln_rate", "slope_log", "slope_linear", "slope_cos", "depth_m", "ln_depth", "cos_fov", "slant_height_m",
    "level_scale",
    # The link at the present place: ln of the bit rate over the threshold, whether the AUV is in the field of view,
    # the bit rate between threshold and on-axis rate on a log scale, the horizontal distance to the ship [m].
    "ln_multiple", "visible", "level", "distance_m",
)  # fmt: skip
MEASURE = rows("bit_rate_bps", "snr", "ber", "range_m", "pointing_error_rad", "in_cone")
COST = rows("outside")


@equation
def lambertian_order(half_power_angle):
    return -math.log(2.0) / math.log(math.cos(half_power_angle))


@equation
def radiant_intensity(power, order, range_m, emission_angle):
    lobe = math.cos(emission_angle) ** order
    return power * (order + 1.0) / (2.0 * math.pi * range_m**2) * lobe


@equation
def effective_area(detector_area, refractive_index, field_of_view, pointing_error):
    concentrator_gain = refractive_index**2 / math.sin(field_of_view) ** 2
    return concentrator_gain * detector_area * math.cos(pointing_error)


@equation
def channel_loss(attenuation, range_m):
    return math.exp(-attenuation * range_m)


@equation
def solar_power(irradiance, transmittance, bandwidth, area):
    return irradiance * transmittance * bandwidth * area


@equation
def shot_noise_per_hertz(responsivity, background_power):
    return 2.0 * ELEMENTARY_CHARGE_C * responsivity * background_power


@equation
def solve_log_range(excess, log_slope, linear_slope):
    """ln d where excess + log_slope·ln d + linear_slope·(d − 1) = 0, by Newton's method in ln d.

    In ln d the function is concave and falls, so that Newton's method converges from anywhere.
    """
    x = min(-excess / log_slope, 12.0)
    for _ in range(40):
        d = math.exp(x)
        x = x - (excess + log_slope * x + linear_slope * (d - 1.0)) / (log_slope + linear_slope * d)
    return x


@equation
def log_rate_slopes(order, attenuation, surface_background):
    """How ln(bit rate) goes with ln(range), range and ln(cos of the pointing error).

    The bit rate is proportional to photocurrent² over background power; these are the exponents of that quotient.
    """
    if surface_background:
        return -4.0, -2.0 * attenuation, 2.0 * (order + 1.0)
    return -4.0, 0.0, 2.0 * (order + 1.0) - 1.0


@equation
def reduced(
    power_w, half_power_angle_rad, detector_area_m2, field_of_view_rad, refractive_index, responsivity_a_per_w,
    attenuation_per_m, filter_bandwidth_nm, solar_irradiance_w_per_m2_nm, water_transmittance, surface, q,
):  # fmt: skip
    """The link's a, b, c and e in ln B = a + b ln d + c (d − 1) + e ln cos ψ, from the numbers of `OpticalLink`."""
    order = lambertian_order(half_power_angle_rad)
    area = effective_area(detector_area_m2, refractive_index, field_of_view_rad, 0.0)
    loss = channel_loss(attenuation_per_m, 1.0)
    current = responsivity_a_per_w * (radiant_intensity(power_w, order, 1.0, 0.0) * area * loss)
    irradiance = solar_irradiance_w_per_m2_nm * (1.0 if surface else loss * loss)
    lit = detector_area_m2 if surface else area
    background = solar_power(irradiance, water_transmittance, filter_bandwidth_nm, lit)
    noise = shot_noise_per_hertz(responsivity_a_per_w, background)
    ln_rate = math.log(current * current / noise / (q * q))
    slope_log, slope_linear, slope_cos = log_rate_slopes(order, attenuation_per_m, surface)
    return ln_rate, slope_log, slope_linear, slope_cos


@equation
def slant_height(link, fov, ln_threshold):
    """Range at the rim of the field of view at which the bit rate of a `reduced` link falls to the threshold."""
    ln_rate, slope_log, slope_linear, slope_cos = link
    excess = ln_rate + slope_cos * math.log(math.cos(fov)) - ln_threshold
    return math.exp(solve_log_range(excess, slope_log, slope_linear))


_radiant_intensity = over_arrays(radiant_intensity)
_effective_area = over_arrays(effective_area)
_channel_loss = over_arrays(channel_loss)
_solve_log_range = over_arrays(solve_log_range)


class Cone(NamedTuple):
    """The region below the receiver in which a bit rate is reached: within the half angle and the slant height."""

    half_angle_rad: float
    slant_height_m: float

    @property
    def height_m(self) -> float:
        """Depth of the cone's rim below the receiver [m]."""
        return self.slant_height_m * math.cos(self.half_angle_rad)

    def footprint_radius_m(self, depth_m: float) -> float:
        """Radius [m] of the disc that the region cuts out of the plane at ``depth_m`` [m]; 0 below its end."""
        if not depth_m > 0.0:
            raise ValueError(f"depth_m = {depth_m!r} is not allowed; it must be a number above 0 [m].")
        if depth_m >= self.slant_height_m:
            return 0.0
        chord = math.sqrt(self.slant_height_m**2 - depth_m**2)
        return min(depth_m * math.tan(self.half_angle_rad), chord)


@dataclass(frozen=True, kw_only=True)
class OpticalLink(Parameters):
    """The optical link: transmitter straight up on the AUV, receiver straight down under the ship.

    All methods take scalars or arrays, broadcast them, and return a float for scalars. ``range_m`` [m] is the
    distance between transmitter and receiver (above 0), ``pointing_error_rad`` [rad] the angle between the receiver's
    axis and the line of sight, which is also the angle off the transmitter's axis, as in the paper (φ = ψ). Beyond
    the receiver's field of view nothing is received: the bit rate is 0 and the bit error rate 0.5.

    Examples:
        >>> link = OpticalLink()
        >>> round(link.cone().slant_height_m, 3)
        4.405
        >>> round(link.bit_rate(3.815, 0.0) / 1e9, 1)
        8.9
    """

    power_w: Number = number(0.1, "W", "mean optical power of the transmitter", low=1e-6, high=1000.0, source=PAPER)
    half_power_angle_rad: Number = number(
        math.radians(15), "rad", "half-angle at half power", low=0.01, high=1.5, source=PAPER
    )
    detector_area_m2: Number = number(1e-4, "m^2", "detector area", low=1e-9, high=1.0, source=PAPER)
    field_of_view_rad: Number = number(
        math.radians(30), "rad", "half field of view of the receiver", low=0.01, high=1.5, source=PAPER
    )
    refractive_index: Number = number(
        1.52, "1", "refractive index of the concentrator", low=1.0, high=4.0, source=PAPER
    )
    responsivity_a_per_w: Number = number(0.6, "A/W", "responsivity", low=0.001, high=10.0, source=PAPER)
    attenuation_per_m: Number = number(
        0.15, "1/m", "attenuation coefficient of the water", low=0.0, high=10.0, source=PAPER
    )
    filter_bandwidth_nm: Number = number(
        30.0, "nm", "bandwidth of the optical filter", low=0.01, high=1000.0, source=PAPER
    )
    solar_irradiance_w_per_m2_nm: Number = number(
        0.7645,
        "W/(m^2 nm)",
        "spectral solar irradiance at the surface, 532 nm",
        low=1e-12,
        high=10.0,
        source="paper, sec. 2.2",
    )
    water_transmittance: Number = number(
        0.95, "1", "transmittance of the water at 532 nm", low=1e-6, high=1.0, source="paper, sec. 2.2"
    )
    background: str = choice(
        "surface",
        ("surface", "printed"),
        "'surface': receiver at depth 0, diffuse light on the bare detector, which reproduces the paper's cone; "
        "'printed': the paper's equation as printed, attenuated twice and concentrated",
    )
    target_ber: float = number(
        1e-4,
        "1",
        "bit error rate at which the bit rate is stated",
        low=1e-15,
        high=0.49,
        randomisable=False,
        source="paper, sec. 2.3",
    )
    threshold_bit_rate_bps: float = number(
        10e6,
        "bit/s",
        "bit rate that defines the cone",
        low=1.0,
        high=1e15,
        randomisable=False,
        source="paper, sec. 2.3",
    )
    max_bit_rate_bps: float | None = number(
        None,
        "bit/s",
        "highest rate of the modem; None for no limit",
        low=1.0,
        high=1e15,
        randomisable=False,
        optional=True,
    )

    def _check(self) -> None:
        if self.max_bit_rate_bps is not None and self.max_bit_rate_bps < self.threshold_bit_rate_bps:
            raise SettingError(
                f"OpticalLink.max_bit_rate_bps = {self.max_bit_rate_bps!r} is not allowed; it must be at least "
                f"threshold_bit_rate_bps = {self.threshold_bit_rate_bps!r} [bit/s]."
            )

    def derived(self) -> dict[str, float]:
        """Q⁻¹ of the target, and threshold and highest rate with their logarithms."""
        ln_threshold = math.log(self.threshold_bit_rate_bps)
        ln_ceiling = math.inf if self.max_bit_rate_bps is None else math.log(self.max_bit_rate_bps)
        return {
            "q": inverse_q_function(self.target_ber),
            "ln_threshold": ln_threshold,
            "ln_ceiling": ln_ceiling,
            "threshold_bps": math.exp(ln_threshold),
            "ceiling_bps": math.exp(ln_ceiling),
        }

    def smallest_cone(self) -> Cone:
        """The cone of the least slant height among all links that an episode may draw."""
        ranges = {name: sorted(set(np.ravel(value).tolist())) for name, value in self.numbers()}
        surfaces = {name == "surface" for name in np.ravel(self.background).tolist()}
        own = self.derived()
        cones = []
        for surface, *values in itertools.product(surfaces, *ranges.values()):
            numbers = dict(zip(ranges, values, strict=True))
            fov = numbers["field_of_view_rad"]
            slant = slant_height(reduced(**numbers, surface=surface, q=own["q"]), fov, own["ln_threshold"])
            cones.append(Cone(fov, slant))
        return min(cones, key=lambda cone: cone.slant_height_m)

    @property
    def lambertian_order(self) -> float:
        """Lambert's mode number m = −ln 2 / ln cos Φ½ (paper, eq. 2)."""
        return float(lambertian_order(self.value("half_power_angle_rad")))

    def radiant_intensity(self, range_m: npt.ArrayLike, emission_angle_rad: npt.ArrayLike) -> float | Array:
        """Radiant intensity over range squared, I_s [W/m²] (paper, eq. 1)."""
        d, angle = _geometry(range_m, emission_angle_rad)
        inside = np.cos(np.minimum(angle, math.pi / 2))
        lit = _radiant_intensity(self.value("power_w"), self.lambertian_order, d, np.arccos(inside))
        return _like_input(np.where(angle < math.pi / 2, lit, 0.0))

    def effective_area(self, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Effective area of the receiver A_eff [m²] (paper, eqs. 3 and 4)."""
        _, angle = _geometry(1.0, pointing_error_rad)
        fov = self.value("field_of_view_rad")
        area = _effective_area(self.value("detector_area_m2"), self.value("refractive_index"), fov, angle)
        return _like_input(np.where(angle <= fov, area, 0.0))

    def received_power(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Received optical power P_RX [W] (paper, eq. 6)."""
        d, angle = _geometry(range_m, pointing_error_rad)
        loss = _channel_loss(self.value("attenuation_per_m"), d)
        return _like_input(self.radiant_intensity(d, angle) * self.effective_area(angle) * loss)

    def photocurrent(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Photocurrent I_b [A] (paper, eq. 7)."""
        return _like_input(self.value("responsivity_a_per_w") * self.received_power(range_m, pointing_error_rad))

    def background_power(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Solar power on the detector P_b [W], in the form chosen by ``background`` (paper, eqs. 8 and 9)."""
        d, angle = _geometry(range_m, pointing_error_rad)
        if self.option("background") == "surface":
            irradiance = np.full_like(d, self.value("solar_irradiance_w_per_m2_nm"))
            area: npt.ArrayLike = self.value("detector_area_m2")
        else:
            irradiance = self.value("solar_irradiance_w_per_m2_nm") * _channel_loss(
                2.0 * self.value("attenuation_per_m"), d
            )
            area = self.effective_area(angle)
        return _like_input(
            solar_power(irradiance, self.value("water_transmittance"), self.value("filter_bandwidth_nm"), area)
        )

    def noise_variance(
        self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike, bit_rate_bps: npt.ArrayLike
    ) -> float | Array:
        """Variance of the solar shot noise σ_b² [A²] at a bit rate [bit/s] (paper, eq. 10)."""
        background = self.background_power(range_m, pointing_error_rad)
        density = shot_noise_per_hertz(self.value("responsivity_a_per_w"), background)
        return _like_input(density * _positive("bit_rate_bps", bit_rate_bps))

    def snr(
        self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike, bit_rate_bps: npt.ArrayLike
    ) -> float | Array:
        """Signal-to-noise ratio I_b²/σ_b² at a bit rate [bit/s] (paper, eq. 11)."""
        current = np.asarray(self.photocurrent(range_m, pointing_error_rad))
        variance = np.asarray(self.noise_variance(range_m, pointing_error_rad, bit_rate_bps))
        # Far beyond any use both underflow.
        lit = (current > 0.0) & (variance > 0.0)
        return _like_input(np.where(lit, current**2 / np.where(lit, variance, 1.0), 0.0))

    def ber(
        self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike, bit_rate_bps: npt.ArrayLike
    ) -> float | Array:
        """Bit error rate Q(√SNR) at a bit rate [bit/s] (paper, eq. 12)."""
        return q_function(np.sqrt(self.snr(range_m, pointing_error_rad, bit_rate_bps)))

    def bit_rate(
        self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike, ber: float | None = None
    ) -> float | Array:
        """Bit rate B [bit/s] at a bit error rate in (0, 0.5), by default `target_ber` (paper, eq. 13)."""
        at_one_bit = np.asarray(self.snr(range_m, pointing_error_rad, 1.0))
        rate = at_one_bit / inverse_q_function(self.target_ber if ber is None else ber) ** 2
        ceiling = math.inf if self.max_bit_rate_bps is None else self.max_bit_rate_bps
        return _like_input(np.minimum(rate, ceiling))

    def range_at(self, bit_rate_bps: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Range [m] at which the bit rate at `target_ber` falls to ``bit_rate_bps``; 0 where it is never reached."""
        wanted = _positive("bit_rate_bps", bit_rate_bps)
        _, angle = _geometry(1.0, pointing_error_rad)
        at_one_metre = np.asarray(self.snr(1.0, angle, 1.0)) / inverse_q_function(self.target_ber) ** 2
        lit = at_one_metre > 0.0
        excess = np.log(np.where(lit, at_one_metre, 1.0)) - np.log(wanted)
        slopes = log_rate_slopes(
            self.lambertian_order, self.value("attenuation_per_m"), self.option("background") == "surface"
        )
        reachable = lit & (wanted <= (math.inf if self.max_bit_rate_bps is None else self.max_bit_rate_bps))
        return _like_input(np.where(reachable, np.exp(_solve_log_range(excess, slopes[0], slopes[1])), 0.0))

    def cone(self, bit_rate_bps: float | None = None) -> Cone:
        """The cone in which ``bit_rate_bps`` [bit/s], by default the threshold, is reached (paper, sec. 2.3).

        Raises:
            ValueError: The rate isn't positive or lies above `max_bit_rate_bps`.
        """
        rate = self.threshold_bit_rate_bps if bit_rate_bps is None else bit_rate_bps
        if self.max_bit_rate_bps is not None and rate > self.max_bit_rate_bps:
            raise ValueError(
                f"bit_rate_bps = {rate!r} is not allowed; it must be at most max_bit_rate_bps = "
                f"{self.max_bit_rate_bps!r} [bit/s]."
            )
        half_angle = self.value("field_of_view_rad")
        return Cone(half_angle, float(self.range_at(rate, half_angle)))


def q_function(x: npt.ArrayLike) -> float | Array:
    """Tail probability Q(x) of the standard normal distribution."""
    return _like_input(_erfc(np.asarray(x, dtype=float) / math.sqrt(2.0)) * 0.5)


_erfc = np.vectorize(math.erfc, otypes=[float])


def inverse_q_function(probability: float) -> float:
    """The x at which Q(x) equals a probability in (0, 0.5).

    Raises:
        ValueError: The probability lies outside (0, 0.5).
    """
    if not 0.0 < probability < 0.5:
        raise ValueError(f"ber = {probability!r} is not allowed; it must be a number in (0, 0.5).")
    return -statistics.NormalDist().inv_cdf(probability)


def _geometry(range_m: npt.ArrayLike, angle_rad: npt.ArrayLike) -> tuple[Array, Array]:
    angle = np.asarray(angle_rad, dtype=float)
    if not np.isfinite(angle).all():
        raise ValueError(f"pointing_error_rad = {angle_rad!r} is not allowed; it must be finite [rad].")
    d, angle = np.broadcast_arrays(_positive("range_m", range_m), np.abs(angle))
    return d, angle


def _positive(name: str, value: npt.ArrayLike) -> Array:
    array = np.asarray(value, dtype=float)
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"{name} = {value!r} is not allowed; it must be finite and above 0.")
    return array


def _like_input(value: npt.ArrayLike) -> float | Array:
    array = np.asarray(value, dtype=float)
    return float(array) if array.ndim == 0 else array


@inlined
def begin(b, j, world) -> None:
    """Reduce the link that the lane has drawn to ln B = a + b ln d + c (d − 1) + e ln cos ψ, its cone and depth."""
    p = b.drawn.link
    fov = p.field_of_view_rad[j]
    own = reduced(
        p.power_w[j], p.half_power_angle_rad[j], p.detector_area_m2[j], fov, p.refractive_index[j],
        p.responsivity_a_per_w[j], p.attenuation_per_m[j], p.filter_bandwidth_nm[j],
        p.solar_irradiance_w_per_m2_nm[j], p.water_transmittance[j], p.background[j] == 0.0, world.link.q,
    )  # fmt: skip
    ln_rate, slope_log, slope_linear, slope_cos = own
    slant = slant_height(own, fov, world.link.ln_threshold)
    depth = b.drawn.scenario.depth_m[j]
    if depth != depth:
        depth = slant * math.cos(fov)
        b.drawn.scenario.depth_m[j] = depth
    on_axis = min(ln_rate + slope_log * math.log(depth) + slope_linear * (depth - 1.0), world.link.ln_ceiling)
    decades = on_axis - world.link.ln_threshold

    o = b.link
    o.ln_rate[j] = ln_rate
    o.slope_log[j] = slope_log
    o.slope_linear[j] = slope_linear
    o.slope_cos[j] = slope_cos
    o.depth_m[j] = depth
    o.ln_depth[j] = math.log(depth)
    # A hair's breadth of tolerance: at the cone's own depth the rim is where both conditions meet.
    o.cos_fov[j] = math.cos(fov) * (1.0 - 1e-12)
    o.slant_height_m[j] = slant * (1.0 + 1e-12)
    o.level_scale[j] = 1.0 / decades if decades > 0.0 else 0.0


@inlined
def measure(b, j, world) -> None:
    """What the reward and the observation depend on: where the AUV is in the cone."""
    o = b.link
    dx = b.ship.x[j] - b.auv.x[j]
    dy = b.ship.y[j] - b.auv.y[j]
    depth = o.depth_m[j]
    distance2 = fma(dx, dx, dy * dy)
    range2 = fma(depth, depth, distance2)
    range_m = math.sqrt(range2)
    ln_range = 0.5 * log(range2)
    ln_rate = fma(o.slope_log[j], ln_range, o.ln_rate[j])
    ln_rate = fma(o.slope_linear[j], range_m - 1.0, ln_rate)
    ln_rate = fma(o.slope_cos[j], o.ln_depth[j] - ln_range, ln_rate)
    visible = depth >= o.cos_fov[j] * range_m
    inside = visible and (range_m <= o.slant_height_m[j])
    ln_threshold = world.link.ln_threshold
    above = (min(ln_rate, world.link.ln_ceiling) - ln_threshold) * o.level_scale[j]
    level = min(max(above, 0.0), 1.0)
    in_cone = 1.0 if inside else 0.0
    o.ln_multiple[j] = ln_rate - ln_threshold
    o.visible[j] = 1.0 if visible else 0.0
    o.level[j] = level if visible else 0.0
    o.distance_m[j] = math.sqrt(distance2)
    b.measure.range_m[j] = range_m
    b.measure.in_cone[j] = in_cone
    b.cost.outside[j] = 1.0 - in_cone


@inlined
def report(b, j, world) -> None:
    """What only `info` shows: bit rate at the target bit error rate, SNR at the threshold, pointing error."""
    o = b.link
    multiple = exp(o.ln_multiple[j]) if o.visible[j] > 0.0 else 0.0
    b.measure.bit_rate_bps[j] = min(multiple * world.link.threshold_bps, world.link.ceiling_bps)
    b.measure.snr[j] = multiple * (world.link.q * world.link.q)
    b.measure.pointing_error_rad[j] = 2.0 * atan_below_one(o.distance_m[j] / (b.measure.range_m[j] + o.depth_m[j]))


@inlined
def report_errors(b, j, world) -> None:
    """The bit error rate at the threshold."""
    snr = b.measure.snr[j]
    # Most lanes are either dark or so bright that Q is below the smallest double.
    unsure = 0.0 < snr < 1500.0
    certain = 0.0 if snr > 0.0 else 0.5
    b.measure.ber[j] = 0.5 * math.erfc(math.sqrt(0.5 * snr)) if unsure else certain
