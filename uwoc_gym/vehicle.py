"""The AUV: three degrees of freedom in the horizontal plane, its parameters and its integration.

    M ν̇ + C(ν)ν + D(ν)ν = τ + τ_w,   η̇ = R(ϱ)ν        (paper, sec. 3.1)

with η = (x, y, yaw) in the earth frame and ν = (surge, sway, yaw rate) in the body frame. The plant is the nominal
model times `mass_scale` and `damping_scale`; controllers know the nominal model only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.block import (
    COS,
    COUPLING_SURGE,
    COUPLING_SWAY,
    COUPLING_YAW,
    EARTH_X,
    EARTH_Y,
    EXTRA_SURGE,
    EXTRA_SWAY,
    EXTRA_YAW,
    INVERSE_SURGE,
    INVERSE_SWAY,
    INVERSE_YAW,
    LINEAR_SURGE,
    LINEAR_SWAY,
    LINEAR_YAW,
    PUSH_SURGE,
    PUSH_SWAY,
    PUSH_YAW,
    QUADRATIC_SURGE,
    QUADRATIC_SWAY,
    QUADRATIC_YAW,
    SIN,
    STRIDE,
    SURGE,
    SWAY,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from uwoc_gym.compiled import inlined
from uwoc_gym.elementary import fma, small_sincos
from uwoc_gym.parameters import Number, Parameters, flag, number

Array = npt.NDArray[np.float64]

MASSES = "paper, table 3 (includes added mass)"
DAMPING = "paper, table 3"
LIMITS = "project default: the paper's controllers never reach it"


@dataclass(frozen=True, kw_only=True)
class Vehicle(Parameters):
    """Parameters of the AUV: the nominal model, how the true plant departs from it, and the actuators' limits."""

    mass_surge_kg: Number = number(100.0, "kg", "mass in surge, m11", positive=True, source=MASSES)
    mass_sway_kg: Number = number(250.0, "kg", "mass in sway, m22", positive=True, source=MASSES)
    inertia_yaw_kg_m2: Number = number(80.0, "kg m^2", "inertia in yaw, m33", positive=True, source=MASSES)
    linear_damping_surge: Number = number(70.0, "kg/s", "linear damping in surge", low=0.0, source=DAMPING)
    linear_damping_sway: Number = number(100.0, "kg/s", "linear damping in sway", low=0.0, source=DAMPING)
    linear_damping_yaw: Number = number(50.0, "kg m^2/s", "linear damping in yaw", low=0.0, source=DAMPING)
    quadratic_damping_surge: Number = number(100.0, "kg/m", "quadratic damping in surge", low=0.0, source=DAMPING)
    quadratic_damping_sway: Number = number(200.0, "kg/m", "quadratic damping in sway", low=0.0, source=DAMPING)
    quadratic_damping_yaw: Number = number(100.0, "kg m^2", "quadratic damping in yaw", low=0.0, source=DAMPING)
    mass_scale: Number = number(
        1.0, "1", "true masses and inertia over nominal", positive=True, source="paper, Case II"
    )
    damping_scale: Number = number(1.0, "1", "true damping over nominal", low=0.0, source="project default")
    coriolis: bool = flag(True, "Coriolis and centripetal terms; off reproduces the paper's PD row")
    max_surge_force_n: float = number(
        2000.0, "N", "surge force at action 1", positive=True, randomisable=False, source=LIMITS
    )
    max_sway_force_n: float = number(
        2000.0, "N", "sway force at action 1", positive=True, randomisable=False, source=LIMITS
    )
    max_yaw_moment_nm: float = number(
        500.0, "N m", "yaw moment at action 1", positive=True, randomisable=False, source=LIMITS
    )

    def nominal(self) -> Vehicle:
        """The model that controllers know: scales at 1 and every range at its middle."""
        return replace(self.midpoint(), mass_scale=1.0, damping_scale=1.0)

    @property
    def force_limits(self) -> Array:
        """Actuator limits (surge force [N], sway force [N], yaw moment [N m]), shape (3,)."""
        return np.array([self.max_surge_force_n, self.max_sway_force_n, self.max_yaw_moment_nm])

    @property
    def inertia(self) -> Array:
        """Diagonal of the true mass matrix M, shape (3,) [kg, kg, kg m²]."""
        diagonal = [self.value(n) for n in ("mass_surge_kg", "mass_sway_kg", "inertia_yaw_kg_m2")]
        return np.array(diagonal) * self.value("mass_scale")

    def damping(self, velocity: npt.ArrayLike) -> Array:
        """Diagonal of the true damping matrix D(ν) at a body velocity, shape (..., 3)."""
        axes = ("surge", "sway", "yaw")
        linear = np.array([self.value(f"linear_damping_{axis}") for axis in axes])
        quadratic = np.array([self.value(f"quadratic_damping_{axis}") for axis in axes])
        diagonal: Array = linear + quadratic * np.abs(np.asarray(velocity, dtype=float))
        return diagonal * self.value("damping_scale")

    def coriolis_force(self, velocity: npt.ArrayLike, direction: npt.ArrayLike) -> Array:
        """C(ν) applied to a body-frame vector, shape (..., 3); zero where `coriolis` is off."""
        nu, w = np.broadcast_arrays(np.asarray(velocity, dtype=float), np.asarray(direction, dtype=float))
        if not self.coriolis:
            return np.zeros_like(w)
        m11, m22, _ = self.inertia
        surge_momentum, sway_momentum = m11 * nu[..., 0], m22 * nu[..., 1]
        return np.stack(
            [
                -sway_momentum * w[..., 2],
                surge_momentum * w[..., 2],
                sway_momentum * w[..., 0] - surge_momentum * w[..., 1],
            ],
            axis=-1,
        )

    def acceleration(self, velocity: npt.ArrayLike, force: npt.ArrayLike) -> Array:
        """True body acceleration ν̇ [m/s², m/s², rad/s²] under a body force [N, N, N m], shape (..., 3)."""
        nu = np.asarray(velocity, dtype=float)
        resistance = self.coriolis_force(nu, nu) + self.damping(nu) * nu
        result: Array = (np.asarray(force, dtype=float) - resistance) / self.inertia
        return result


@inlined
def set_dynamics(s, j, m11, m22, m33, d1, d2, d3, q1, q2, q3, mass_scale, damping_scale, coriolis) -> None:
    """Write one lane's equation of motion, divided by its masses, into the block's rows."""
    m11 = m11 * mass_scale
    m22 = m22 * mass_scale
    m33 = m33 * mass_scale
    s[j + INVERSE_SURGE * STRIDE] = 1.0 / m11
    s[j + INVERSE_SWAY * STRIDE] = 1.0 / m22
    s[j + INVERSE_YAW * STRIDE] = 1.0 / m33
    s[j + LINEAR_SURGE * STRIDE] = damping_scale * d1 / m11
    s[j + LINEAR_SWAY * STRIDE] = damping_scale * d2 / m22
    s[j + LINEAR_YAW * STRIDE] = damping_scale * d3 / m33
    s[j + QUADRATIC_SURGE * STRIDE] = damping_scale * q1 / m11
    s[j + QUADRATIC_SWAY * STRIDE] = damping_scale * q2 / m22
    s[j + QUADRATIC_YAW * STRIDE] = damping_scale * q3 / m33
    s[j + COUPLING_SURGE * STRIDE] = coriolis * m22 / m11
    s[j + COUPLING_SWAY * STRIDE] = -coriolis * m11 / m22
    s[j + COUPLING_YAW * STRIDE] = coriolis * (m11 - m22) / m33


@inlined
def _acceleration(push, linear, quadratic, coupling, velocity, product):
    """One axis of M⁻¹(τ − C(ν)ν − D(ν)ν); ``product`` is that of the other two velocities."""
    damping = fma(quadratic, abs(velocity), linear)
    return fma(coupling, product, fma(-damping, velocity, push))


def _make_integrator(earth_force: bool) -> Any:
    """RK4 over ``count`` steps of ``h`` seconds for the first ``lanes`` lanes of the block ``s``.

    The state is (x, y, cos yaw, sin yaw, surge, sway, yaw rate), seen within a step from the heading at its start; at
    the step's end the heading is turned exactly. That spares the stages' sines and cosines and is of order four all
    the same. A force fixed in the earth frame is turned with the body at every stage; where none acts, that is
    compiled out, and adding zeros would give the same bits.
    """

    @inlined
    def integrate(s, lanes, h, count) -> None:
        half = 0.5 * h
        sixth = h / 6.0
        for _ in range(count):
            for j in range(lanes):
                u = s[j + SURGE * STRIDE]
                v = s[j + SWAY * STRIDE]
                r = s[j + YAW_RATE * STRIDE]
                cos = s[j + COS * STRIDE]
                sin = s[j + SIN * STRIDE]
                du = s[j + LINEAR_SURGE * STRIDE]
                dv = s[j + LINEAR_SWAY * STRIDE]
                dr = s[j + LINEAR_YAW * STRIDE]
                qu = s[j + QUADRATIC_SURGE * STRIDE]
                qv = s[j + QUADRATIC_SWAY * STRIDE]
                qr = s[j + QUADRATIC_YAW * STRIDE]
                ku = s[j + COUPLING_SURGE * STRIDE]
                kv = s[j + COUPLING_SWAY * STRIDE]
                kr = s[j + COUPLING_YAW * STRIDE]
                fu1 = s[j + PUSH_SURGE * STRIDE]
                fv1 = s[j + PUSH_SWAY * STRIDE]
                fr = s[j + PUSH_YAW * STRIDE]
                fu2 = fu3 = fu4 = fu1
                fv2 = fv3 = fv4 = fv1
                if earth_force:
                    iu = s[j + INVERSE_SURGE * STRIDE]
                    iv = s[j + INVERSE_SWAY * STRIDE]
                    ex = s[j + EARTH_X * STRIDE]
                    ey = s[j + EARTH_Y * STRIDE]
                    ahead = fma(cos, ex, sin * ey)
                    aside = fma(cos, ey, -(sin * ex))
                    fu0 = fu1 + s[j + EXTRA_SURGE * STRIDE]
                    fv0 = fv1 + s[j + EXTRA_SWAY * STRIDE]
                    fr = fr + s[j + EXTRA_YAW * STRIDE]
                    fu1 = fma(iu, ahead, fu0)
                    fv1 = fma(iv, aside, fv0)

                au1 = _acceleration(fu1, du, qu, ku, u, v * r)
                av1 = _acceleration(fv1, dv, qv, kv, v, u * r)
                ar1 = _acceleration(fr, dr, qr, kr, r, u * v)

                u2 = fma(half, au1, u)
                v2 = fma(half, av1, v)
                r2 = fma(half, ar1, r)
                s2 = half * r
                c2 = 1.0
                if earth_force:
                    fu2 = fma(iu, fma(c2, ahead, s2 * aside), fu0)
                    fv2 = fma(iv, fma(c2, aside, -(s2 * ahead)), fv0)
                au2 = _acceleration(fu2, du, qu, ku, u2, v2 * r2)
                av2 = _acceleration(fv2, dv, qv, kv, v2, u2 * r2)
                ar2 = _acceleration(fr, dr, qr, kr, r2, u2 * v2)

                u3 = fma(half, au2, u)
                v3 = fma(half, av2, v)
                r3 = fma(half, ar2, r)
                s3 = half * r2
                c3 = fma(-s2, s3, 1.0)
                if earth_force:
                    fu3 = fma(iu, fma(c3, ahead, s3 * aside), fu0)
                    fv3 = fma(iv, fma(c3, aside, -(s3 * ahead)), fv0)
                au3 = _acceleration(fu3, du, qu, ku, u3, v3 * r3)
                av3 = _acceleration(fv3, dv, qv, kv, v3, u3 * r3)
                ar3 = _acceleration(fr, dr, qr, kr, r3, u3 * v3)

                u4 = fma(h, au3, u)
                v4 = fma(h, av3, v)
                r4 = fma(h, ar3, r)
                s4 = h * r3 * c3
                c4 = fma(-(h * r3), s3, 1.0)
                if earth_force:
                    fu4 = fma(iu, fma(c4, ahead, s4 * aside), fu0)
                    fv4 = fma(iv, fma(c4, aside, -(s4 * ahead)), fv0)
                au4 = _acceleration(fu4, du, qu, ku, u4, v4 * r4)
                av4 = _acceleration(fv4, dv, qv, kv, v4, u4 * r4)
                ar4 = _acceleration(fr, dr, qr, kr, r4, u4 * v4)

                ahead_2 = fma(c2, u2, -(s2 * v2)) + fma(c3, u3, -(s3 * v3))
                aside_2 = fma(s2, u2, c2 * v2) + fma(s3, u3, c3 * v3)
                moved_ahead = sixth * fma(2.0, ahead_2, u + fma(c4, u4, -(s4 * v4)))
                moved_aside = sixth * fma(2.0, aside_2, v + fma(s4, u4, c4 * v4))
                s[j + X * STRIDE] += fma(cos, moved_ahead, -(sin * moved_aside))
                s[j + Y * STRIDE] += fma(sin, moved_ahead, cos * moved_aside)

                turned = sixth * fma(2.0, r2 + r3, r + r4)
                st, ct = small_sincos(turned)
                s[j + YAW * STRIDE] += turned
                s[j + COS * STRIDE] = fma(cos, ct, -(sin * st))
                s[j + SIN * STRIDE] = fma(sin, ct, cos * st)

                s[j + SURGE * STRIDE] = fma(sixth, fma(2.0, au2 + au3, au1 + au4), u)
                s[j + SWAY * STRIDE] = fma(sixth, fma(2.0, av2 + av3, av1 + av4), v)
                s[j + YAW_RATE * STRIDE] = fma(sixth, fma(2.0, ar2 + ar3, ar1 + ar4), r)

    return integrate


integrate_in_calm = _make_integrator(False)
integrate_with_pulses = _make_integrator(True)
