"""The short form of `hashes`."""

from __future__ import annotations

from tests.trust.hashes import compare


def test_flights_are_the_same_bit_for_bit() -> None:
    compared, different = compare(long=False)
    assert different == []
    assert compared == 3 * 2 * 2 * (5 + 33)
