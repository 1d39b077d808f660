"""The optical channel: from optical power to bit rate under solar noise, and the cone in which the link holds.

Equations of section 2 of N'Doye, Zhang, Alouini and Laleg-Kirati, "Establishing and Maintaining a Reliable Optical
Wireless Communication in Underwater Environment" (here: the paper). The module's functions hold each equation once;
they take scalars in compiled code and arrays in NumPy.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable

from uwoc_gym.parameters import Number, Parameters, SettingError, choice, number

ELEMENTARY_CHARGE_C = 1.602176634e-19
"""Charge of the electron [C], exact in the SI since 2019."""

PAPER = "paper, table 1"

Array = npt.NDArray[np.float64]


@register_jitable
def lambertian_order(half_power_angle):
    return -np.log(2.0) / np.log(np.cos(half_power_angle))


@register_jitable
def radiant_intensity(power, order, range_m, emission_angle):
    lobe = np.cos(emission_angle) ** order
    return power * (order + 1.0) / (2.0 * np.pi * range_m**2) * lobe


@register_jitable
def effective_area(detector_area, refractive_index, field_of_view, pointing_error):
    concentrator_gain = refractive_index**2 / np.sin(field_of_view) ** 2
    return concentrator_gain * detector_area * np.cos(pointing_error)


@register_jitable
def channel_loss(attenuation, range_m):
    return np.exp(-attenuation * range_m)


@register_jitable
def solar_power(irradiance, transmittance, bandwidth, area):
    return irradiance * transmittance * bandwidth * area


@register_jitable
def shot_noise_per_hertz(responsivity, background_power):
    return 2.0 * ELEMENTARY_CHARGE_C * responsivity * background_power


@register_jitable
def solve_log_range(excess, log_slope, linear_slope):
    """ln d where excess + log_slope·ln d + linear_slope·(d − 1) = 0, by Newton's method in ln d.

    In ln d the function is concave and falls, so that Newton's method converges from anywhere.
    """
    x = np.minimum(-excess / log_slope, 12.0)
    for _ in range(40):
        d = np.exp(x)
        x = x - (excess + log_slope * x + linear_slope * (d - 1.0)) / (log_slope + linear_slope * d)
    return x


@register_jitable
def log_rate_slopes(order, attenuation, surface_background):
    """How ln(bit rate) goes with ln(range), range and ln(cos of the pointing error).

    The bit rate is proportional to photocurrent² over background power; these are the exponents of that quotient.
    """
    if surface_background:
        return -4.0, -2.0 * attenuation, 2.0 * (order + 1.0)
    return -4.0, 0.0, 2.0 * (order + 1.0) - 1.0


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

    power_w: Number = number(0.1, "W", "mean optical power of the transmitter", positive=True, source=PAPER)
    half_power_angle_rad: Number = number(
        math.radians(15), "rad", "half-angle at half power", positive=True, high=1.5, source=PAPER
    )
    detector_area_m2: Number = number(1e-4, "m^2", "detector area", positive=True, source=PAPER)
    field_of_view_rad: Number = number(
        math.radians(30), "rad", "half field of view of the receiver", positive=True, high=1.5, source=PAPER
    )
    refractive_index: Number = number(1.52, "1", "refractive index of the concentrator", low=1.0, source=PAPER)
    responsivity_a_per_w: Number = number(0.6, "A/W", "responsivity", positive=True, source=PAPER)
    attenuation_per_m: Number = number(
        0.15, "1/m", "attenuation coefficient of the water", low=0.0, high=100.0, source=PAPER
    )
    filter_bandwidth_nm: Number = number(30.0, "nm", "bandwidth of the optical filter", positive=True, source=PAPER)
    solar_irradiance_w_per_m2_nm: Number = number(
        0.7645,
        "W/(m^2 nm)",
        "spectral solar irradiance at the surface, 532 nm",
        positive=True,
        source="paper, sec. 2.2",
    )
    water_transmittance: Number = number(
        0.95, "1", "transmittance of the water at 532 nm", positive=True, high=1.0, source="paper, sec. 2.2"
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
        positive=True,
        high=0.5,
        open_high=True,
        randomisable=False,
        source="paper, sec. 2.3",
    )
    threshold_bit_rate_bps: float = number(
        10e6, "bit/s", "bit rate that defines the cone", positive=True, randomisable=False, source="paper, sec. 2.3"
    )
    max_bit_rate_bps: float | None = number(
        None, "bit/s", "highest rate of the modem; None for no limit", positive=True, randomisable=False, optional=True
    )

    def _check(self) -> None:
        if self.max_bit_rate_bps is not None and self.max_bit_rate_bps < self.threshold_bit_rate_bps:
            raise SettingError(
                f"OpticalLink.max_bit_rate_bps = {self.max_bit_rate_bps!r} is not allowed; it must be at least "
                f"threshold_bit_rate_bps = {self.threshold_bit_rate_bps!r} [bit/s]."
            )

    @property
    def lambertian_order(self) -> float:
        """Lambert's mode number m = −ln 2 / ln cos Φ½ (paper, eq. 2)."""
        return float(lambertian_order(self.value("half_power_angle_rad")))

    def radiant_intensity(self, range_m: npt.ArrayLike, emission_angle_rad: npt.ArrayLike) -> float | Array:
        """Radiant intensity over range squared, I_s [W/m²] (paper, eq. 1)."""
        d, angle = _geometry(range_m, emission_angle_rad)
        inside = np.cos(np.minimum(angle, math.pi / 2))
        lit = radiant_intensity(self.value("power_w"), self.lambertian_order, d, np.arccos(inside))
        return _like_input(np.where(angle < math.pi / 2, lit, 0.0))

    def effective_area(self, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Effective area of the receiver A_eff [m²] (paper, eqs. 3 and 4)."""
        _, angle = _geometry(1.0, pointing_error_rad)
        fov = self.value("field_of_view_rad")
        area = effective_area(self.value("detector_area_m2"), self.value("refractive_index"), fov, angle)
        return _like_input(np.where(angle <= fov, area, 0.0))

    def received_power(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Received optical power P_RX [W] (paper, eq. 6)."""
        d, angle = _geometry(range_m, pointing_error_rad)
        loss = channel_loss(self.value("attenuation_per_m"), d)
        return _like_input(self.radiant_intensity(d, angle) * self.effective_area(angle) * loss)

    def photocurrent(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Photocurrent I_b [A] (paper, eq. 7)."""
        return _like_input(self.value("responsivity_a_per_w") * self.received_power(range_m, pointing_error_rad))

    def background_power(self, range_m: npt.ArrayLike, pointing_error_rad: npt.ArrayLike) -> float | Array:
        """Solar power on the detector P_b [W], in the form chosen by ``background`` (paper, eqs. 8 and 9)."""
        d, angle = _geometry(range_m, pointing_error_rad)
        if self.background == "surface":
            irradiance = np.full_like(d, self.value("solar_irradiance_w_per_m2_nm"))
            area: npt.ArrayLike = self.value("detector_area_m2")
        else:
            irradiance = self.value("solar_irradiance_w_per_m2_nm") * channel_loss(
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
        slopes = log_rate_slopes(self.lambertian_order, self.value("attenuation_per_m"), self.background == "surface")
        reachable = lit & (wanted <= (math.inf if self.max_bit_rate_bps is None else self.max_bit_rate_bps))
        return _like_input(np.where(reachable, np.exp(solve_log_range(excess, slopes[0], slopes[1])), 0.0))

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
