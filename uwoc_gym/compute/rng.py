"""Counter-based random numbers: a draw is a pure function of (seed, episode, stream, step).

Philox4x32-10 of Salmon, Moraes, Dror and Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3" (SC 2011). Since no
generator carries state, a simulation's draws depend neither on the batch it runs in nor on what ran before it.

Each thing that is random has a stream of its own, declared where it stands, so that switching one off leaves the
others' draws alone. Streams and counters are floats because Numba would compile `draw` anew for each whole number.
"""

from __future__ import annotations

import hashlib
import math
import re

import numpy as np

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import log, sincos
from uwoc_gym.compute.records import rows

STREAM = 1.0
"""The stream of the numbers that a scenario leaves to be drawn."""

STATE = rows("key_0", "key_1", "episode")
"""The seed's key and the number of the episode: all that a draw depends on besides its place."""

_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_ROUNDS = 10


@inlined
def philox(
    key0: np.uint64, key1: np.uint64, c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Philox4x32-10: four random 32-bit words (held in uint64) from a 64-bit key and a 128-bit counter."""
    for _ in range(_ROUNDS):
        product0 = _MULTIPLIER_0 * c0
        product1 = _MULTIPLIER_1 * c2
        c0 = (product1 >> _SHIFT) ^ c1 ^ key0
        c1 = product1 & _LOW
        c2 = (product0 >> _SHIFT) ^ c3 ^ key1
        c3 = product0 & _LOW
        key0 = (key0 + _WEYL_0) & _LOW
        key1 = (key1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@inlined
def draw(b, j: int, stream: float, step: float, index: float) -> tuple[float, float, float, float]:
    """Four uniforms in (0, 1), 32 bits each, for lane ``j`` at the given place in the given stream."""
    w0, w1, w2, w3 = philox(
        np.uint64(b.random.key_0[j]) & _LOW,
        np.uint64(b.random.key_1[j]) & _LOW,
        np.uint64(step) & _LOW,
        np.uint64(b.random.episode[j]) & _LOW,
        np.uint64(stream),
        np.uint64(index),
    )
    scale = 1.0 / 4294967296.0
    return (
        (float(w0) + 0.5) * scale,
        (float(w1) + 0.5) * scale,
        (float(w2) + 0.5) * scale,
        (float(w3) + 0.5) * scale,
    )


@inlined
def normal_pair(uniform0: float, uniform1: float) -> tuple[float, float]:
    """Two independent standard normal numbers from two uniforms in (0, 1), by Box and Muller's transform."""
    radius = math.sqrt(-2.0 * log(uniform0))
    sine, cosine = sincos(2.0 * math.pi * uniform1)
    return radius * cosine, radius * sine


def key_from_seed(seed: int) -> tuple[float, float]:
    """The 64-bit Philox key of a seed, as two floats that hold 32-bit words exactly.

    Seeds below 2⁶⁴ are keys as they are, since Philox needs no scrambled ones; longer ones are hashed.

    Args:
        seed: Any non-negative integer.
    """
    if seed < 2**64:
        return float(seed & 0xFFFFFFFF), float(seed >> 32)
    words = np.random.SeedSequence(seed).generate_state(2, np.uint32)
    return float(words[0]), float(words[1])


def counter(path: str) -> tuple[float, float]:
    """Step and index of the draw of a scenario's number, which hang on nothing but its path.

    Args:
        path: The number's path in the scenario, of a ship's path with its kind instead of its place among the
            alternatives, "ship.circle.radius_m": alternatives of one kind share their draws.
    """
    if path in _FROZEN:
        return 0.0, float(_FROZEN.index(path))
    if path == "ship":
        return 1.0, 0.0
    pulse = re.fullmatch(r"sea\.pulses\[(\d+)\]\.(\w+)", path)
    if pulse is not None and pulse[2] in _FROZEN_PULSE:
        return 0.0, float(len(_FROZEN) + 6 * int(pulse[1]) + _FROZEN_PULSE.index(pulse[2]))
    _, _, of_ship = path.partition("ship.")
    kind, _, name = of_ship.partition(".")
    if name in _FROZEN_SHIP.get(kind, ()):
        return 2.0, float(_FROZEN_SHIP[kind].index(name))
    word = hashlib.blake2b(path.encode(), digest_size=4).digest()
    return 3.0, float(int.from_bytes(word, "little"))


# The places that numbers had when draws were counted, which v0 keeps for ever. What is new is found by its hash.
_FROZEN = (
    "link.power_w", "link.half_power_angle_rad", "link.detector_area_m2", "link.field_of_view_rad",
    "link.refractive_index", "link.responsivity_a_per_w", "link.attenuation_per_m", "link.filter_bandwidth_nm",
    "link.solar_irradiance_w_per_m2_nm", "link.water_transmittance",
    "vehicle.mass_surge_kg", "vehicle.mass_sway_kg", "vehicle.inertia_yaw_kg_m2",
    "vehicle.linear_damping_surge", "vehicle.linear_damping_sway", "vehicle.linear_damping_yaw",
    "vehicle.quadratic_damping_surge", "vehicle.quadratic_damping_sway", "vehicle.quadratic_damping_yaw",
    "vehicle.mass_scale", "vehicle.damping_scale",
    "sea.current.speed_mps", "sea.current.direction_rad", "sea.current.std_mps", "sea.current.correlation_time_s",
    "sensors.position_std_m", "sensors.yaw_std_rad", "sensors.velocity_std_mps", "sensors.yaw_rate_std_rad_s",
    "start.x_m", "start.y_m", "start.yaw_rad", "start.surge_mps", "start.sway_mps", "start.yaw_rate_rad_s",
    "depth_m",
)  # fmt: skip
_FROZEN_PULSE = ("start_s", "duration_s", "force_x_n", "force_y_n", "moment_nm")
_FROZEN_SHIP = {
    "paper": ("radius_m", "rate_rad_s", "swing_rad"),
    "straight": ("x_m", "y_m", "course_rad", "speed_mps"),
    "circle": ("x_m", "y_m", "radius_m", "speed_mps", "start_angle_rad"),
    "random": (
        "x_m", "y_m", "course_rad", "speed_mps", "wander", "shortest_period_s", "longest_period_s",
    ),
    "lawn-mower": ("x_m", "y_m", "course_rad", "leg_length_m", "spacing_m", "speed_mps"),
}  # fmt: skip
