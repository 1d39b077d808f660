"""Elementary functions without branches or library calls, so that loops over simulations vectorise.

Every function here works on float64 scalars inside compiled code, gives the same bits on any vector width, and is
tested against NumPy (see each docstring for the error). Multiply-adds are written as explicit `fma`, since leaving
their formation to the compiler would let results depend on the shape of the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from uwoc_gym.compute.compiled import inlined

# Numba's own decorator has no types that mypy could follow.
_intrinsic: Callable[[Callable[..., Any]], Callable[..., Any]] = intrinsic

_HALF_PI_HIGH = math.pi / 2
_HALF_PI_LOW = 6.123233995736766e-17
_LN2_HIGH = 0.6931471805599453
_LN2_LOW = 2.3190468138462996e-17
_SQRT2 = math.sqrt(2.0)
_MANTISSA = 0x000FFFFFFFFFFFFF
_ONE_BITS = 0x3FF0000000000000


@_intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Fused multiply-add a·b + c, rounded once."""
    signature = types.float64(types.float64, types.float64, types.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return signature, generate


@_intrinsic
def floor(typing_context: Any, x: Any) -> Any:
    """The largest whole number that isn't above x, as a float."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.DoubleType()
        function = builder.module.declare_intrinsic("llvm.floor", [kind])
        return builder.call(function, arguments)

    return types.float64(types.float64), generate


@_intrinsic
def whole(typing_context: Any, number: Any) -> Any:
    """The whole number itself, but no literal to Numba, which would compile everything anew for each literal.

    LLVM still knows what it is, so that a loop over one lane is no loop in machine code.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return arguments[0]

    return types.int64(types.int64), generate


@_intrinsic
def _float_to_bits(typing_context: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@_intrinsic
def _bits_to_float(typing_context: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate


@inlined
def small_sincos(x: float) -> tuple[float, float]:
    r"""Sine and cosine by their Taylor series to x⁵ and x⁶; error below \|x\|⁷/5040, 5e-15 at 0.03."""
    z = x * x
    sine = x * fma(z, fma(z, 1 / 120, -1 / 6), 1.0)
    cosine = fma(z, fma(z, fma(z, -1 / 720, 1 / 24), -0.5), 1.0)
    return sine, cosine


@inlined
def sincos(x: float) -> tuple[float, float]:
    """Sine and cosine of x [rad]; error below 3e-16 for \\|x\\| ≤ 1e6."""
    k = floor(x * (2 / math.pi) + 0.5)
    r = fma(-k, _HALF_PI_LOW, fma(-k, _HALF_PI_HIGH, x))
    z = r * r
    s = fma(z, fma(z, -1 / 1307674368000, 1 / 6227020800), -1 / 39916800)
    s = fma(z, fma(z, fma(z, fma(z, s, 1 / 362880), -1 / 5040), 1 / 120), -1 / 6)
    s = fma(r * z, s, r)
    c = fma(z, fma(z, 1 / 20922789888000, -1 / 87178291200), 1 / 479001600)
    c = fma(z, fma(z, fma(z, fma(z, fma(z, c, -1 / 3628800), 1 / 40320), -1 / 720), 1 / 24), -0.5)
    c = fma(z, c, 1.0)
    quadrant = k - 4.0 * floor(0.25 * k)
    odd = (quadrant == 1.0) or (quadrant == 3.0)
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quadrant >= 2.0 else sine
    cosine = -cosine if (quadrant == 1.0) or (quadrant == 2.0) else cosine
    return sine, cosine


@inlined
def log(x: float) -> float:
    """Natural logarithm of a positive, normal x; relative error below 4e-16."""
    bits = _float_to_bits(x)
    exponent = float((bits >> 52) - 1023)
    mantissa = _bits_to_float((bits & _MANTISSA) | _ONE_BITS)
    large = mantissa > _SQRT2
    mantissa = 0.5 * mantissa if large else mantissa
    exponent = exponent + 1.0 if large else exponent
    f = (mantissa - 1.0) / (mantissa + 1.0)
    z = f * f
    series = fma(z, fma(z, 1 / 21, 1 / 19), 1 / 17)
    series = fma(z, fma(z, fma(z, fma(z, series, 1 / 15), 1 / 13), 1 / 11), 1 / 9)
    series = fma(z, fma(z, fma(z, series, 1 / 7), 1 / 5), 1 / 3)
    tail = fma(2.0 * f * z, series, exponent * _LN2_LOW)
    return fma(exponent, _LN2_HIGH, fma(2.0, f, tail))


@inlined
def exp(x: float) -> float:
    """Exponential of x, saturating outside [-700, 700]; relative error below 4e-16."""
    x = min(max(x, -700.0), 700.0)
    k = floor(x * (1 / _LN2_HIGH) + 0.5)
    r = fma(-k, _LN2_LOW, fma(-k, _LN2_HIGH, x))
    series = fma(r, fma(r, fma(r, 1 / 6227020800, 1 / 479001600), 1 / 39916800), 1 / 3628800)
    series = fma(r, fma(r, fma(r, fma(r, series, 1 / 362880), 1 / 40320), 1 / 5040), 1 / 720)
    series = fma(r, fma(r, fma(r, fma(r, series, 1 / 120), 1 / 24), 1 / 6), 0.5)
    series = fma(r * r, series, r) + 1.0
    return series * _bits_to_float((int(k) + 1023) << 52)


@inlined
def atan_below_one(t: float) -> float:
    """Arc tangent of t in [0, 1]; error below 4e-16."""
    # Two half-angle steps bring the argument below tan(π/16), where the series is short.
    t = t / (1.0 + math.sqrt(fma(t, t, 1.0)))
    t = t / (1.0 + math.sqrt(fma(t, t, 1.0)))
    z = t * t
    series = fma(z, fma(z, fma(z, 1 / 21, -1 / 19), 1 / 17), -1 / 15)
    series = fma(z, fma(z, fma(z, fma(z, series, 1 / 13), -1 / 11), 1 / 9), -1 / 7)
    series = fma(z, fma(z, series, 1 / 5), -1 / 3)
    return 4.0 * fma(t * z, series, t)


@inlined
def atan2(y: float, x: float) -> float:
    """Angle of the vector (x, y) in (-π, π]; 0 for the zero vector; error below 5e-16."""
    ax = abs(x)
    ay = abs(y)
    high = max(ax, ay)
    low = min(ax, ay)
    angle = atan_below_one(low / high if high > 0.0 else 0.0)
    angle = _HALF_PI_HIGH - angle if ay > ax else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@inlined
def wrap(angle: float) -> float:
    """The same angle in [-π, π), to within rounding."""
    return angle - 2.0 * math.pi * floor(angle * (0.5 / math.pi) + 0.5)
