"""Counter-based random numbers: a draw is a pure function of (seed, episode, stream, step).

Philox4x32-10 of Salmon, Moraes, Dror and Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3" (SC 2011). Since no
generator carries state, a simulation's draws depend neither on the batch it runs in nor on what ran before it.
"""

from __future__ import annotations

import math

import numpy as np

from uwoc_gym.compiled import inlined
from uwoc_gym.elementary import log, sincos

# Streams: one for each thing that is random, so that switching one off leaves the others' draws alone.
STREAM_PARAMETERS = 1
STREAM_SHIP = 2
STREAM_CURRENT = 3
STREAM_SENSORS = 4

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
def draw(
    key0: float, key1: float, episode: float, stream: int, step: float, block: int
) -> tuple[float, float, float, float]:
    """Four uniforms in (0, 1), 32 bits each, for the given place in the given stream."""
    w0, w1, w2, w3 = philox(
        np.uint64(key0) & _LOW,
        np.uint64(key1) & _LOW,
        np.uint64(step) & _LOW,
        np.uint64(episode) & _LOW,
        np.uint64(stream),
        np.uint64(block),
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
