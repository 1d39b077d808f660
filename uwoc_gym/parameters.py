"""Frozen, validated parameter classes: the shared mechanics of every setting in the package.

A parameter class is a frozen dataclass that derives from `Parameters`; each field is made by `number`, `flag`,
`choice`, `child` or `children`, which hold its unit, its bounds and the source of its default. All checking, merging
and JSON conversion happens here, once.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, cast

import numpy as np


class SettingError(ValueError):
    """A setting that is unknown, has the wrong type or lies outside what is allowed."""


class Range(NamedTuple):
    """An interval from which every episode draws a value, uniformly."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """The interval's midpoint."""
        return 0.5 * (self.low + self.high)


Number = float | tuple[float, float]
"""A number, or a pair (low, high) that becomes a `Range`."""


def closest(name: str, known: Sequence[str]) -> str:
    """The hint that ends an error about an unknown name: the nearest valid one and all of them."""
    matches = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    hint = f"did you mean {matches[0]!r}? " if matches else ""
    return f"{hint}Valid names: {', '.join(known)}."


@dataclasses.dataclass(frozen=True)
class _Spec:
    """How the value of one field is parsed, described and written."""

    description: str = ""
    since: str = dataclasses.field(default="", kw_only=True)
    """The version that brought it, if not the first: what was written before can't say it."""

    @property
    def differs(self) -> bool:
        """Whether the value may differ from episode to episode."""
        return False

    def coded(self, value: Any) -> Any:
        """The value as a number for compiled code, or a range of them."""
        return math.nan if value is None else value

    def parse(self, value: Any, where: str) -> Any:
        raise AssertionError("every kind of field parses its own values")

    def dump(self, value: Any) -> Any:
        return value


@dataclasses.dataclass(frozen=True)
class NumberSpec(_Spec):
    """A number with a unit and bounds, possibly a range that each episode draws from."""

    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    randomisable: bool = True
    optional: bool = False
    source: str = ""

    @property
    def differs(self) -> bool:
        return self.randomisable

    @property
    def allowed(self) -> str:
        """What the field accepts, in words."""
        left = "(" if self.open_low or math.isinf(self.low) else "["
        right = ")" if self.open_high or math.isinf(self.high) else "]"
        text = f"a number in {left}{self.low:g}, {self.high:g}{right} [{self.unit}]"
        if self.randomisable:
            text += " or a pair (low, high) of such numbers to draw from"
        return text + (" or None" if self.optional else "")

    def _inside(self, value: float) -> bool:
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return math.isfinite(value) and above and below

    def parse(self, value: Any, where: str) -> float | Range | None:
        if value is None and self.optional:
            return None
        if isinstance(value, (list, tuple, np.ndarray)) and self.randomisable:
            pair = [_as_float(item) for item in value]
            if len(pair) == 2 and None not in pair:
                low, high = cast(list[float], pair)
                if self._inside(low) and self._inside(high) and low <= high:
                    return Range(low, high)
        else:
            single = _as_float(value)
            if single is not None and self._inside(single):
                return single
        raise SettingError(f"{where} = {value!r} is not allowed; it must be {self.allowed}.")

    def dump(self, value: Any) -> Any:
        return list(value) if isinstance(value, Range) else value


@dataclasses.dataclass(frozen=True)
class FlagSpec(_Spec):
    """True or False."""

    def parse(self, value: Any, where: str) -> bool:
        if isinstance(value, (bool, np.bool_)):
            return bool(value)
        raise SettingError(f"{where} = {value!r} is not allowed; it must be True or False.")


@dataclasses.dataclass(frozen=True)
class ChoiceSpec(_Spec):
    """One of a few names, or several of them that each episode draws from."""

    options: tuple[str, ...] = ()
    randomisable: bool = True

    @property
    def differs(self) -> bool:
        return self.randomisable

    def coded(self, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(self.options.index(each) for each in value)
        return self.options.index(value)

    def parse(self, value: Any, where: str) -> str | tuple[str, ...]:
        if isinstance(value, str) and value in self.options:
            return str(value)
        several = isinstance(value, (list, tuple)) and self.randomisable
        if several and value and all(each in self.options for each in value) and len(set(value)) == len(value):
            return str(value[0]) if len(value) == 1 else tuple(name for name in self.options if name in value)
        unknown = next((each for each in value if each not in self.options), value) if several and value else value
        also = " A list of several is drawn from." if self.randomisable else ""
        raise SettingError(f"{where} = {value!r} is not allowed; {closest(str(unknown), self.options)}{also}")

    def dump(self, value: Any) -> Any:
        return list(value) if isinstance(value, tuple) else value


@dataclasses.dataclass(frozen=True)
class NamesSpec(_Spec):
    """Some of a few names, in an order that matters."""

    options: tuple[str, ...] = ()

    def parse(self, value: Any, where: str) -> tuple[str, ...]:
        names = tuple(value) if isinstance(value, (list, tuple)) else ()
        for name in names:
            if name not in self.options:
                raise SettingError(f"{where} = {value!r} is not allowed; {closest(str(name), self.options)}")
        if not names or len(set(names)) < len(names):
            raise SettingError(
                f"{where} = {value!r} is not allowed; it must be a list of names, each of them once. "
                f"Valid names: {', '.join(self.options)}."
            )
        return names

    def dump(self, value: Any) -> Any:
        return list(value)


@dataclasses.dataclass(frozen=True)
class SamplesSpec(_Spec):
    """A sequence of finite numbers."""

    unit: str = ""
    optional: bool = False

    def parse(self, value: Any, where: str) -> tuple[float, ...] | None:
        if value is None and self.optional:
            return None
        try:
            samples = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            samples = np.empty((0, 0))
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise SettingError(f"{where} must be a one-dimensional sequence of finite numbers [{self.unit}].")
        return tuple(samples.tolist())

    def dump(self, value: Any) -> Any:
        return None if value is None else list(value)


@dataclasses.dataclass(frozen=True)
class ChildSpec(_Spec):
    """Another parameter class (or one of several), or a tuple of them."""

    types: tuple[type[Parameters], ...] = ()
    many: bool = False
    one_or_many: bool = False

    def parse(self, value: Any, where: str) -> Any:
        if self.many or (self.one_or_many and isinstance(value, (list, tuple))):
            if not isinstance(value, (list, tuple)):
                raise SettingError(f"{where} = {value!r} is not allowed; it must be a list of {self._names()}.")
            if self.one_or_many and not value:
                raise SettingError(f"{where} = [] is not allowed; it needs at least one of {self._names()}.")
            return tuple(self._parse_one(item, f"{where}[{i}]") for i, item in enumerate(value))
        return self._parse_one(value, where)

    def _names(self) -> str:
        return ", ".join(each.__name__ for each in self.types)

    def _parse_one(self, value: Any, where: str) -> Parameters:
        if isinstance(value, self.types):
            return value
        if not isinstance(value, Mapping):
            raise SettingError(f"{where} = {value!r} is not allowed; it must be a {self._names()} or a mapping.")
        if len(self.types) == 1:
            return self.types[0].from_dict(value)
        return self._by_kind(value, where).from_dict({k: v for k, v in value.items() if k != "kind"})

    def _by_kind(self, value: Mapping[str, Any], where: str) -> type[Parameters]:
        kinds = {each.kind: each for each in self.types}
        if "kind" not in value:
            raise SettingError(f"{where} needs a 'kind'. Valid names: {', '.join(kinds)}.")
        if str(value["kind"]) not in kinds:
            raise SettingError(
                f"{where}.kind = {value['kind']!r} is not allowed; {closest(str(value['kind']), list(kinds))}"
            )
        return kinds[value["kind"]]

    def merge(self, old: Any, value: Any, where: str) -> Any:
        """The old child with a mapping of overrides, or a whole new one where the kind changes."""
        mapping = isinstance(old, Parameters) and isinstance(value, Mapping)
        if mapping and value.get("kind", old.kind) == old.kind:
            return old.merged({k: v for k, v in value.items() if k != "kind"})
        return self.parse(value, where)

    def dump(self, value: Any) -> Any:
        if isinstance(value, tuple):
            return [self.dump(item) for item in value]
        kind = {"kind": value.kind} if len(self.types) > 1 else {}
        return kind | value.to_dict()


def _as_float(value: Any) -> float | None:
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return None
    return None


def number(
    default: float | Sequence[float] | None,
    unit: str,
    description: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    positive: bool = False,
    open_high: bool = False,
    randomisable: bool = True,
    optional: bool = False,
    source: str = "",
    since: str = "",
) -> Any:
    """A dataclass field for a number [unit] in [low, high]; `positive` makes it (0, high]."""
    spec = NumberSpec(
        description=description,
        unit=unit,
        low=0.0 if positive else low,
        high=high,
        open_low=positive,
        open_high=open_high,
        randomisable=randomisable,
        optional=optional,
        source=source,
        since=since,
    )
    return dataclasses.field(default=cast(Any, default), metadata={"spec": spec})


def flag(default: bool, description: str, *, since: str = "") -> Any:
    """A dataclass field for a switch."""
    return dataclasses.field(default=default, metadata={"spec": FlagSpec(description=description, since=since)})


def choice(
    default: str, options: tuple[str, ...], description: str, *, randomisable: bool = True, since: str = ""
) -> Any:
    """A dataclass field for one of a few names; unless `randomisable` is off, several of them are drawn from."""
    spec = ChoiceSpec(description=description, options=options, randomisable=randomisable, since=since)
    return dataclasses.field(default=default, metadata={"spec": spec})


def names(default: tuple[str, ...], options: tuple[str, ...], description: str, *, since: str = "") -> Any:
    """A dataclass field for some of a few names, in an order that matters."""
    spec = NamesSpec(description=description, options=options, since=since)
    return dataclasses.field(default=default, metadata={"spec": spec})


def samples(unit: str, description: str, *, optional: bool = False) -> Any:
    """A dataclass field for a sequence of numbers, required unless optional."""
    spec = SamplesSpec(description=description, unit=unit, optional=optional)
    if optional:
        return dataclasses.field(default=None, metadata={"spec": spec})
    return dataclasses.field(metadata={"spec": spec})


def child(
    default: Parameters | tuple[Parameters, ...],
    types: tuple[type[Parameters], ...],
    description: str,
    *,
    many: bool = False,
    one_or_many: bool = False,
    since: str = "",
) -> Any:
    """A dataclass field for other parameters; `many` for a tuple of them, `one_or_many` for alternatives."""
    spec = ChildSpec(description=description, types=types, many=many, one_or_many=one_or_many, since=since)
    return dataclasses.field(default=default, metadata={"spec": spec})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameters:
    """Base of all parameter classes: checks itself, merges overrides, converts from and to plain data."""

    kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, spec in self.specs().items():
            value = spec.parse(getattr(self, name), f"{type(self).__name__}.{name}")
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        """Checks that involve several fields; subclasses raise `SettingError` here."""

    @property
    def random(self) -> bool:
        """Whether it makes episodes differ from seed to seed even where all its settings are single values."""
        return False

    def family(self) -> Iterator[Parameters]:
        """These parameters and all below them."""
        yield self
        for name, spec in self.specs().items():
            if isinstance(spec, ChildSpec):
                value = getattr(self, name)
                for each in value if isinstance(value, tuple) else (value,):
                    yield from each.family()

    def derived(self) -> dict[str, float]:
        """What compiled code needs besides the settings themselves, by name."""
        return {}

    @classmethod
    def specs(cls) -> dict[str, _Spec]:
        """The kind, unit, bounds, description and source of each field by name."""
        return {field.name: field.metadata["spec"] for field in dataclasses.fields(cls)}

    @classmethod
    def _refuse_unknown(cls, names: Any) -> None:
        known = list(cls.specs())
        for name in names:
            if name not in known:
                raise SettingError(f"{cls.__name__} has no setting {name!r}; {closest(str(name), known)}")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Build from a mapping of plain data.

        Raises:
            SettingError: A key is unknown (the nearest valid name is given) or a value isn't allowed.
        """
        cls._refuse_unknown(data)
        required = [f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
        for name in required:
            if name not in data:
                raise SettingError(f"{cls.__name__} needs the setting {name!r}.")
        return cls(**data)

    def to_dict(self) -> dict[str, Any]:
        """All settings as plain data that `from_dict` and JSON take."""
        return {name: spec.dump(getattr(self, name)) for name, spec in self.specs().items()}

    def merged(self, overrides: Mapping[str, Any]) -> Self:
        """A copy with the overrides merged in, level by level.

        Raises:
            SettingError: A key is unknown (the nearest valid name is given) or a value isn't allowed.
        """
        if not isinstance(overrides, Mapping):
            raise SettingError(f"{type(self).__name__} overrides must be a mapping, got {overrides!r}.")
        self._refuse_unknown(overrides)
        changes: dict[str, Any] = {}
        for name, value in overrides.items():
            spec = self.specs()[name]
            old = getattr(self, name)
            where = f"{type(self).__name__}.{name}"
            changes[name] = spec.merge(old, value, where) if isinstance(spec, ChildSpec) else value
        return dataclasses.replace(self, **changes)

    def numbers(self) -> Iterator[tuple[str, Number]]:
        """Name and value of each number of this class that an episode may draw."""
        for name, spec in self.specs().items():
            if isinstance(spec, NumberSpec) and spec.randomisable and getattr(self, name) is not None:
                yield name, getattr(self, name)

    @classmethod
    def drawn(cls) -> list[str]:
        """Names of the settings that may differ from episode to episode: numbers that may be ranges, and choices."""
        return [name for name, spec in cls.specs().items() if spec.differs]

    def drawn_values(self) -> dict[str, Number]:
        """What compiled code is given for each of `drawn`: not a number for None, its place for a choice."""
        return {name: self.specs()[name].coded(getattr(self, name)) for name in self.drawn()}

    def fixed_values(self) -> dict[str, float]:
        """What compiled code is given for the numbers and switches that every episode shares, and `derived`."""
        specs = self.specs()
        own = {
            name: specs[name].coded(getattr(self, name))
            for name in specs
            if not specs[name].differs and isinstance(specs[name], (NumberSpec, FlagSpec, ChoiceSpec))
        }
        return own | self.derived()

    def value(self, name: str) -> float:
        """The number called ``name``.

        Raises:
            SettingError: The number is a range, so that it has no value before an episode draws one.
        """
        number = getattr(self, name)
        if isinstance(number, Range):
            raise SettingError(
                f"{type(self).__name__}.{name} is the range {tuple(number)}, which has a value only within an "
                "episode; use midpoint() for one with every range at its middle."
            )
        return float(number)

    def option(self, name: str) -> str:
        """The choice called ``name``.

        Raises:
            SettingError: There are several, of which none is chosen before an episode draws one.
        """
        chosen = getattr(self, name)
        if isinstance(chosen, tuple):
            raise SettingError(
                f"{type(self).__name__}.{name} is one of {chosen}, which is only drawn within an episode; use "
                "midpoint() for the first."
            )
        return str(chosen)

    def midpoint(self) -> Self:
        """A copy with every range at its middle and every list of choices at its first, down to the last child."""
        changes: dict[str, Any] = {}
        for name in self.specs():
            value = getattr(self, name)
            spec = self.specs()[name]
            if isinstance(value, Range):
                changes[name] = value.middle
            elif isinstance(spec, ChoiceSpec) and isinstance(value, tuple):
                changes[name] = value[0]
            elif isinstance(value, Parameters):
                changes[name] = value.midpoint()
            elif isinstance(value, tuple) and value and isinstance(value[0], Parameters):
                changes[name] = tuple(item.midpoint() for item in value)
        return dataclasses.replace(self, **changes) if changes else self
