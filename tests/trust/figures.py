"""What a topic hands back: pairs of words and a figure, of which some say that something is wrong."""

from __future__ import annotations


class Wrong(str):
    """A figure that shouldn't be."""

    __slots__ = ()


def share(good: int, tried: int) -> str:
    """How many of how many; wrong where it isn't all of them."""
    text = f"{good:,} of {tried:,}"
    return text if good == tried > 0 else Wrong(text)


def none_of(wrong: list[str], shown: int = 3) -> str:
    """The number of things that are wrong, with the first of them; 0 is right."""
    if not wrong:
        return "0"
    first = "; ".join(" ".join(each.split())[:300] for each in wrong[:shown])
    return Wrong(f"{len(wrong):,}: {first}")
