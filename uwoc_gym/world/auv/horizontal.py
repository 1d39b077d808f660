"""The AUV: three degrees of freedom in the horizontal plane, its parameters and its integration.

    M ν̇ + C(ν)ν + D(ν)ν = τ + τ_w,   η̇ = R(ϱ)ν        (paper, sec. 3.1)

with η = (x, y, yaw) in the earth frame and ν = (surge, sway, yaw rate) in the body frame. The plant is the nominal
model times `mass_scale` and `damping_scale`; controllers know the nominal model only. In moving water the equation
holds for the velocity relative to it (Fossen, "Handbook of Marine Craft Hydrodynamics and Motion Control", sec. 8.1).
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import inlined, over_arrays
from uwoc_gym.compute.elementary import fma, sincos, small_sincos
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import Number, Parameters, flag, number

Array = npt.NDArray[np.float64]

MASSES = "paper, table 3 (includes added mass)"
DAMPING = "paper, table 3"
ACTUATORS = "project default: the paper's controllers never reach it"

FASTEST = 1000.0
"""Surge, sway [m/s] or yaw rate [rad/s] beyond which the integration has diverged: nothing moves so under water."""

STATE = rows(
    "x", "y", "yaw", "cos", "sin", "surge", "sway", "yaw_rate",
    # The actuators' force in the last control period, and what it and the plant make of the equation of motion.
    "force_surge", "force_sway", "moment_yaw",
    "push_surge", "push_sway", "push_yaw",
    "linear_surge", "linear_sway", "linear_yaw",
    "quadratic_surge", "quadratic_sway", "quadratic_yaw",
    "coupling_surge", "coupling_sway", "coupling_yaw",
    "inverse_surge", "inverse_sway", "inverse_yaw",
)  # fmt: skip

WATER = rows("x", "y")
"""Velocity of the water where the AUV is, in the earth frame [m/s]: what an effect's `flow` adds to."""

WRENCH = rows("surge", "sway", "yaw", "x", "y")
"""Force and moment in the body frame [N, N, N m], and force fixed in the earth frame [N]: what a `push` adds to."""


@dataclass(frozen=True, kw_only=True)
class Vehicle(Parameters):
    """Parameters of the AUV: the nominal model, how the true plant departs from it, and the actuators' limits."""

    mass_surge_kg: Number = number(100.0, "kg", "mass in surge, m11", low=1.0, high=1e5, source=MASSES)
    mass_sway_kg: Number = number(250.0, "kg", "mass in sway, m22", low=1.0, high=1e5, source=MASSES)
    inertia_yaw_kg_m2: Number = number(80.0, "kg m^2", "inertia in yaw, m33", low=0.01, high=1e6, source=MASSES)
    linear_damping_surge: Number = number(70.0, "kg/s", "linear damping in surge", low=0.0, high=1e5, source=DAMPING)
    linear_damping_sway: Number = number(100.0, "kg/s", "linear damping in sway", low=0.0, high=1e5, source=DAMPING)
    linear_damping_yaw: Number = number(50.0, "kg m^2/s", "linear damping in yaw", low=0.0, high=1e6, source=DAMPING)
    quadratic_damping_surge: Number = number(
        100.0, "kg/m", "quadratic damping in surge", low=0.0, high=1e5, source=DAMPING
    )
    quadratic_damping_sway: Number = number(
        200.0, "kg/m", "quadratic damping in sway", low=0.0, high=1e5, source=DAMPING
    )
    quadratic_damping_yaw: Number = number(
        100.0, "kg m^2", "quadratic damping in yaw", low=0.0, high=1e6, source=DAMPING
    )
    mass_scale: Number = number(
        1.0, "1", "true masses and inertia over nominal", low=0.1, high=10.0, source="paper, Case II"
    )
    damping_scale: Number = number(1.0, "1", "true damping over nominal", low=0.0, high=100.0, source="project default")
    coriolis: bool = flag(True, "Coriolis and centripetal terms; off reproduces the paper's PD row")
    max_surge_force_n: Number = number(2000.0, "N", "surge force at action 1", low=0.0, high=1e5, source=ACTUATORS)
    max_sway_force_n: Number = number(2000.0, "N", "sway force at action 1", low=0.0, high=1e5, source=ACTUATORS)
    max_yaw_moment_nm: Number = number(500.0, "N m", "yaw moment at action 1", low=0.0, high=1e5, source=ACTUATORS)

    def nominal(self) -> Vehicle:
        """The model that controllers know: scales at 1 and every range at its middle."""
        return replace(self.midpoint(), mass_scale=1.0, damping_scale=1.0)

    @property
    def force_limits(self) -> Array:
        """The most that the actuators can (surge force [N], sway force [N], yaw moment [N m]), shape (3,)."""
        limits = (self.max_surge_force_n, self.max_sway_force_n, self.max_yaw_moment_nm)
        return np.array([np.max(limit) for limit in limits], dtype=float)

    def derived(self) -> dict[str, float]:
        """Whether there is any force along each axis."""
        return dict(zip(("surges", "sways", "yaws"), (self.force_limits > 0.0).tolist(), strict=True))

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
        nu, tau = np.broadcast_arrays(np.asarray(velocity, dtype=float), np.asarray(force, dtype=float))
        dynamics = self._dynamics
        others = ((1, 2), (0, 2), (0, 1))
        axes = [
            _axis_acceleration(
                tau[..., i] * dynamics.inverse[i],
                dynamics.linear[i],
                dynamics.quadratic[i],
                dynamics.coupling[i],
                nu[..., i],
                nu[..., j] * nu[..., k],
            )
            for i, (j, k) in enumerate(others)
        ]
        return np.stack(axes, axis=-1)

    @cached_property
    def _dynamics(self) -> _Dynamics:
        dynamics: _Dynamics = _equation(**{name: self.value(name) for name in _PLANT}, coriolis=float(self.coriolis))
        return dynamics

    def velocity_slope(self, velocity: npt.ArrayLike) -> Array:
        """How `acceleration` changes with a velocity of shape (..., 3), by differences: shape (..., 3, 3)."""
        nu = np.asarray(velocity, dtype=float)
        small = 1e-4
        aside = small * np.eye(3).reshape(3, *(1,) * (nu.ndim - 1), 3)
        ahead, behind = self.acceleration(np.stack([nu + aside, nu - aside]), np.zeros(3))
        slope: Array = np.moveaxis(ahead - behind, 0, -1) / (2.0 * small)
        return slope


class _Dynamics(NamedTuple):
    """An equation of motion divided by its masses, each for surge, sway and yaw."""

    inverse: tuple[float, float, float]
    linear: tuple[float, float, float]
    quadratic: tuple[float, float, float]
    coupling: tuple[float, float, float]


def _equation(
    mass_surge_kg, mass_sway_kg, inertia_yaw_kg_m2,
    linear_damping_surge, linear_damping_sway, linear_damping_yaw,
    quadratic_damping_surge, quadratic_damping_sway, quadratic_damping_yaw,
    mass_scale, damping_scale, coriolis,
):  # fmt: skip
    """The equation of motion of the true plant from the numbers of `Vehicle`."""
    m11 = mass_surge_kg * mass_scale
    m22 = mass_sway_kg * mass_scale
    m33 = inertia_yaw_kg_m2 * mass_scale
    return _Dynamics(
        (1.0 / m11, 1.0 / m22, 1.0 / m33),
        (
            damping_scale * linear_damping_surge / m11,
            damping_scale * linear_damping_sway / m22,
            damping_scale * linear_damping_yaw / m33,
        ),
        (
            damping_scale * quadratic_damping_surge / m11,
            damping_scale * quadratic_damping_sway / m22,
            damping_scale * quadratic_damping_yaw / m33,
        ),
        (coriolis * m22 / m11, -coriolis * m11 / m22, coriolis * (m11 - m22) / m33),
    )


_PLANT = tuple(name for name in inspect.signature(_equation).parameters if name != "coriolis")
_compiled_equation = inlined(_equation)


@inlined
def axis_acceleration(push, linear, quadratic, coupling, velocity, product):
    """One axis of M⁻¹(τ − C(ν)ν − D(ν)ν); ``product`` is that of the other two velocities."""
    damping = fma(quadratic, abs(velocity), linear)
    return fma(coupling, product, fma(-damping, velocity, push))


_axis_acceleration = over_arrays(axis_acceleration)


@inlined
def begin(b, j, world) -> None:
    """Write the equation of motion of the plant that the lane has drawn."""
    p = b.drawn.vehicle
    dynamics = _compiled_equation(
        p.mass_surge_kg[j], p.mass_sway_kg[j], p.inertia_yaw_kg_m2[j],
        p.linear_damping_surge[j], p.linear_damping_sway[j], p.linear_damping_yaw[j],
        p.quadratic_damping_surge[j], p.quadratic_damping_sway[j], p.quadratic_damping_yaw[j],
        p.mass_scale[j], p.damping_scale[j], world.vehicle.coriolis,
    )  # fmt: skip
    a = b.auv
    a.inverse_surge[j], a.inverse_sway[j], a.inverse_yaw[j] = dynamics.inverse
    a.linear_surge[j], a.linear_sway[j], a.linear_yaw[j] = dynamics.linear
    a.quadratic_surge[j], a.quadratic_sway[j], a.quadratic_yaw[j] = dynamics.quadratic
    a.coupling_surge[j], a.coupling_sway[j], a.coupling_yaw[j] = dynamics.coupling
    a.force_surge[j] = 0.0
    a.force_sway[j] = 0.0
    a.moment_yaw[j] = 0.0


@inlined
def turn_to_heading(b, j) -> None:
    """Write cosine and sine of yaw."""
    b.auv.sin[j], b.auv.cos[j] = sincos(b.auv.yaw[j])


@inlined
def actuate(b, j, world) -> None:
    """Turn the lane's action into the force that acts throughout the control period."""
    a = b.auv
    limits = b.drawn.vehicle
    a.force_surge[j] = b.action.surge[j] * limits.max_surge_force_n[j]
    a.force_sway[j] = b.action.sway[j] * limits.max_sway_force_n[j]
    a.moment_yaw[j] = b.action.yaw[j] * limits.max_yaw_moment_nm[j]
    a.push_surge[j] = a.force_surge[j] * a.inverse_surge[j]
    a.push_sway[j] = a.force_sway[j] * a.inverse_sway[j]
    a.push_yaw[j] = a.moment_yaw[j] * a.inverse_yaw[j]


@inlined
def calm(b, j) -> None:
    """Still water, to which flows are added."""
    b.water.x[j] = 0.0
    b.water.y[j] = 0.0


@inlined
def release(b, j) -> None:
    """No force besides the actuators', to which pushes are added."""
    b.wrench.surge[j] = 0.0
    b.wrench.sway[j] = 0.0
    b.wrench.yaw[j] = 0.0
    b.wrench.x[j] = 0.0
    b.wrench.y[j] = 0.0


@inlined
def change_to_water(b, j, sense) -> None:
    """Add ``sense`` times the water's velocity, seen from the body, to surge and sway."""
    cx = sense * b.water.x[j]
    cy = sense * b.water.y[j]
    cosine = b.auv.cos[j]
    sine = b.auv.sin[j]
    b.auv.surge[j] += fma(cosine, cx, sine * cy)
    b.auv.sway[j] += fma(cosine, cy, -(sine * cx))


@inlined
def carry(b, j, duration_s) -> None:
    """Carry the lane along with the water."""
    b.auv.x[j] = fma(duration_s, b.water.x[j], b.auv.x[j])
    b.auv.y[j] = fma(duration_s, b.water.y[j], b.auv.y[j])


@inlined
def follows(b, j):
    """Whether the motion is one that the integrator has followed; written so that what is not a number isn't."""
    a = b.auv
    return (
        (abs(a.surge[j]) <= FASTEST)
        & (abs(a.sway[j]) <= FASTEST)
        & (abs(a.yaw_rate[j]) <= FASTEST)
        & (abs(a.x[j]) + abs(a.y[j]) + abs(a.yaw[j]) <= 1e12)
    )


@inlined
def give_up(b, j, distance_m) -> None:
    """Put an AUV that has diverged to rest at a distance from where the ship was."""
    a = b.auv
    a.x[j] = b.ship.x[j] + distance_m
    a.y[j] = b.ship.y[j]
    a.yaw[j] = 0.0
    a.surge[j] = a.sway[j] = a.yaw_rate[j] = 0.0


def _make_integrator(pushed: bool) -> Any:
    """An RK4 step of ``h`` seconds for lane ``j``, with or without what stands in ``b.wrench``.

    The state is (x, y, cos yaw, sin yaw, surge, sway, yaw rate), seen within a step from the heading at its start; at
    the step's end the heading is turned exactly. That spares the stages' sines and cosines and is of order four all
    the same. A force fixed in the earth frame is turned with the body at every stage; where nothing pushes, that is
    compiled out, and adding zeros would give the same bits.
    """

    @inlined
    def integrate(b, j, h) -> None:
        half = 0.5 * h
        sixth = h / 6.0
        a = b.auv
        u = a.surge[j]
        v = a.sway[j]
        r = a.yaw_rate[j]
        cos = a.cos[j]
        sin = a.sin[j]
        du = a.linear_surge[j]
        dv = a.linear_sway[j]
        dr = a.linear_yaw[j]
        qu = a.quadratic_surge[j]
        qv = a.quadratic_sway[j]
        qr = a.quadratic_yaw[j]
        ku = a.coupling_surge[j]
        kv = a.coupling_sway[j]
        kr = a.coupling_yaw[j]
        fu1 = a.push_surge[j]
        fv1 = a.push_sway[j]
        fr = a.push_yaw[j]
        fu2 = fu3 = fu4 = fu1
        fv2 = fv3 = fv4 = fv1
        if pushed:
            iu = a.inverse_surge[j]
            iv = a.inverse_sway[j]
            ex = b.wrench.x[j]
            ey = b.wrench.y[j]
            ahead = fma(cos, ex, sin * ey)
            aside = fma(cos, ey, -(sin * ex))
            fu0 = fu1 + b.wrench.surge[j] * iu
            fv0 = fv1 + b.wrench.sway[j] * iv
            fr = fr + b.wrench.yaw[j] * a.inverse_yaw[j]
            fu1 = fma(iu, ahead, fu0)
            fv1 = fma(iv, aside, fv0)

        au1 = axis_acceleration(fu1, du, qu, ku, u, v * r)
        av1 = axis_acceleration(fv1, dv, qv, kv, v, u * r)
        ar1 = axis_acceleration(fr, dr, qr, kr, r, u * v)

        u2 = fma(half, au1, u)
        v2 = fma(half, av1, v)
        r2 = fma(half, ar1, r)
        s2 = half * r
        c2 = 1.0
        if pushed:
            fu2 = fma(iu, fma(c2, ahead, s2 * aside), fu0)
            fv2 = fma(iv, fma(c2, aside, -(s2 * ahead)), fv0)
        au2 = axis_acceleration(fu2, du, qu, ku, u2, v2 * r2)
        av2 = axis_acceleration(fv2, dv, qv, kv, v2, u2 * r2)
        ar2 = axis_acceleration(fr, dr, qr, kr, r2, u2 * v2)

        u3 = fma(half, au2, u)
        v3 = fma(half, av2, v)
        r3 = fma(half, ar2, r)
        s3 = half * r2
        c3 = fma(-s2, s3, 1.0)
        if pushed:
            fu3 = fma(iu, fma(c3, ahead, s3 * aside), fu0)
            fv3 = fma(iv, fma(c3, aside, -(s3 * ahead)), fv0)
        au3 = axis_acceleration(fu3, du, qu, ku, u3, v3 * r3)
        av3 = axis_acceleration(fv3, dv, qv, kv, v3, u3 * r3)
        ar3 = axis_acceleration(fr, dr, qr, kr, r3, u3 * v3)

        u4 = fma(h, au3, u)
        v4 = fma(h, av3, v)
        r4 = fma(h, ar3, r)
        s4 = h * r3 * c3
        c4 = fma(-(h * r3), s3, 1.0)
        if pushed:
            fu4 = fma(iu, fma(c4, ahead, s4 * aside), fu0)
            fv4 = fma(iv, fma(c4, aside, -(s4 * ahead)), fv0)
        au4 = axis_acceleration(fu4, du, qu, ku, u4, v4 * r4)
        av4 = axis_acceleration(fv4, dv, qv, kv, v4, u4 * r4)
        ar4 = axis_acceleration(fr, dr, qr, kr, r4, u4 * v4)

        ahead_2 = fma(c2, u2, -(s2 * v2)) + fma(c3, u3, -(s3 * v3))
        aside_2 = fma(s2, u2, c2 * v2) + fma(s3, u3, c3 * v3)
        moved_ahead = sixth * fma(2.0, ahead_2, u + fma(c4, u4, -(s4 * v4)))
        moved_aside = sixth * fma(2.0, aside_2, v + fma(s4, u4, c4 * v4))
        a.x[j] += fma(cos, moved_ahead, -(sin * moved_aside))
        a.y[j] += fma(sin, moved_ahead, cos * moved_aside)

        turned = sixth * fma(2.0, r2 + r3, r + r4)
        st, ct = small_sincos(turned)
        a.yaw[j] += turned
        a.cos[j] = fma(cos, ct, -(sin * st))
        a.sin[j] = fma(sin, ct, cos * st)

        a.surge[j] = fma(sixth, fma(2.0, au2 + au3, au1 + au4), u)
        a.sway[j] = fma(sixth, fma(2.0, av2 + av3, av1 + av4), v)
        a.yaw_rate[j] = fma(sixth, fma(2.0, ar2 + ar3, ar1 + ar4), r)

    return integrate


integrate_in_calm = _make_integrator(False)
integrate_pushed = _make_integrator(True)
