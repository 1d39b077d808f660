"""Frozen, validated parameter classes: the shared mechanics of every setting in the package.

A parameter class is a frozen dataclass that derives from `Parameters`; each field is made by `number`, `flag`,
`choice`, `child` or `children`, which hold its unit, its bounds and the source of its default. All checking, merging
and JSON conversion happens here, once.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, cast

from uwoc_gym.given import LIMITS, as_number, as_numbers, is_sequence, scalar, shown, values_of
from uwoc_gym.given import SettingError as SettingError
from uwoc_gym.given import closest as closest


class Range(NamedTuple):
    """An interval from which every episode draws a value, uniformly."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """The interval's midpoint."""
        return 0.5 * (self.low + self.high)


ANY_ANGLE = 4.0 * math.pi
"""Bound of angles [rad], which mean the same a turn further on."""

FARTHEST_M = 1e7
"""Bound of places [m]; grid coordinates of recorded tracks lie within it."""

Number = float | tuple[float, float]
"""A number, or a pair (low, high) that becomes a `Range`."""


_PATH = re.compile(r"(\w+)(?:\[([0-9]{1,9}|\*)\])?(?:\.(\S.*?))?(\s*\*=)?")


class Change(NamedTuple):
    """One entry of overrides, as a component reads it whose setting it changes or leads to."""

    name: str
    """The setting."""
    place: str | None
    """Which of a list: digits, or "*" for all of them; None where no brackets stand."""
    rest: str
    """The path on, below the setting; "" where the setting itself is meant."""
    scales: bool
    """Whether the value is a factor."""
    value: Any

    @classmethod
    def read(cls, key: str, value: Any) -> Change | None:
        """The entry with that key; None where it isn't written as a path is."""
        found = _PATH.fullmatch(key)
        if found is None:
            return None
        name, place, rest, scales = found.groups()
        return cls(name, place, rest or "", scales is not None, value)

    @property
    def below(self) -> tuple[str, Any]:
        """The same entry as the component below reads it."""
        return f"{self.rest} *=" if self.scales else self.rest, self.value


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

    def changed(self, old: Any, changes: Sequence[Change], where: str) -> Any:
        """The value after the changes, one after the other, still to be parsed."""
        value = old
        for each in changes:
            if each.place is not None or each.rest:
                part = f"[{each.place}]" if each.place is not None else f".{each.rest}"
                raise SettingError(f"{where}{part} is not there; the path must end at {where}, a single setting.")
            value = self.scaled(value, each.value, where) if each.scales else each.value
        return value

    def scaled(self, value: Any, factor: Any, where: str) -> Any:
        """The value times a factor, where it is made of numbers."""
        raise SettingError(f"{where} = {shown(value)} can't be scaled; it must be a number, a range or samples.")


def _factor(factor: Any, where: str) -> float:
    number = as_number(factor)
    if number is None or not math.isfinite(number):
        raise SettingError(f"{where} *= {shown(factor)} is not allowed; it must be a finite number.")
    return number


@dataclasses.dataclass(frozen=True)
class NumberSpec(_Spec):
    """A number with a unit and bounds, possibly a range that each episode draws from."""

    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    randomisable: bool = True
    optional: bool = False
    source: str = ""

    @property
    def differs(self) -> bool:
        return self.randomisable

    @property
    def allowed(self) -> str:
        """What the field accepts, in words."""
        text = f"a number in [{self.low:g}, {self.high:g}] [{self.unit}]"
        if self.randomisable:
            text += " or a pair (low, high) of such numbers to draw from"
        return text + (" or None" if self.optional else "")

    def _inside(self, value: float) -> bool:
        return self.low <= value <= self.high

    def parse(self, value: Any, where: str) -> float | Range | None:
        if value is None and self.optional:
            return None
        if is_sequence(value) and len(value) == 2 and self.randomisable:
            low, high = (as_number(item) for item in value)
            if low is not None and high is not None and self._inside(low) and self._inside(high) and low <= high:
                return Range(low, high)
        single = as_number(value)
        if single is not None and self._inside(single):
            return single
        raise SettingError(f"{where} = {shown(value)} is not allowed; it must be {self.allowed}.")

    def dump(self, value: Any) -> Any:
        return list(value) if isinstance(value, Range) else value

    def scaled(self, value: Any, factor: Any, where: str) -> Any:
        number, known = _factor(factor, where), self.parse(value, where)
        if isinstance(known, Range):
            # A factor below 0 turns the ends round.
            return sorted(end * number for end in known)
        return super().scaled(value, factor, where) if known is None else known * number


@dataclasses.dataclass(frozen=True)
class FlagSpec(_Spec):
    """True or False."""

    def parse(self, value: Any, where: str) -> bool:
        plain = scalar(value)
        if isinstance(plain, bool):
            return plain
        raise SettingError(f"{where} = {shown(value)} is not allowed; it must be True or False.")


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
        plain = scalar(value)
        if isinstance(plain, str) and plain in self.options:
            return str(plain)
        several = values_of(value) if self.randomisable else ()
        unknown = [each for each in several if not (isinstance(each, str) and each in self.options)]
        if several and not unknown and len(set(several)) == len(several):
            return str(several[0]) if len(several) == 1 else tuple(name for name in self.options if name in several)
        also = " A list of several is drawn from." if self.randomisable else ""
        hint = closest(unknown[0] if unknown else plain, self.options)
        raise SettingError(f"{where} = {shown(value)} is not allowed; {hint}{also}")

    def dump(self, value: Any) -> Any:
        return list(value) if isinstance(value, tuple) else value


@dataclasses.dataclass(frozen=True)
class NamesSpec(_Spec):
    """Some of a few names, in an order that matters."""

    options: tuple[str, ...] = ()

    def parse(self, value: Any, where: str) -> tuple[str, ...]:
        names = values_of(value)
        for name in names:
            if not isinstance(name, str) or name not in self.options:
                raise SettingError(f"{where} = {shown(value)} is not allowed; {closest(name, self.options)}")
        if not names or len(set(names)) < len(names):
            raise SettingError(
                f"{where} = {shown(value)} is not allowed; it must be a list of names, each of them once. "
                f"Valid names: {', '.join(self.options)}."
            )
        return tuple(map(str, names))

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
        most = int(LIMITS["samples"].high)
        short = not is_sequence(value) or len(value) <= most
        samples = as_numbers(value) if short else None
        if samples is not None and samples.ndim == 1 and samples.size <= most:
            return tuple(samples.tolist())
        for i, each in enumerate(value if is_sequence(value) and short else ()):
            if as_numbers(each, ()) is None:
                raise SettingError(
                    f"{where}[{i}] = {shown(each)} is not allowed; it must be a finite number [{self.unit}]."
                )
        raise SettingError(
            f"{where} = {shown(value)} is not allowed; it must be a one-dimensional sequence of finite numbers "
            f"[{self.unit}], at most {most:_}."
        )

    def dump(self, value: Any) -> Any:
        return None if value is None else list(value)

    def scaled(self, value: Any, factor: Any, where: str) -> Any:
        number, known = _factor(factor, where), self.parse(value, where)
        return super().scaled(value, factor, where) if known is None else [each * number for each in known]


class _Part:
    """A component on its way through the changes to it."""

    def __init__(self, own: Parameters) -> None:
        self.own = own
        self.waiting: list[tuple[Any, Any]] = []

    def take(self, spec: ChildSpec, change: Change, where: str) -> None:
        value = change.value
        if change.rest:
            self.waiting.append(change.below)
        elif change.scales:
            raise SettingError(
                f"{where} can't be scaled; it is a {type(self.own).__name__}. The path must name a number in it: "
                f"{', '.join(name for name, _ in self.own.numbers())}."
            )
        elif isinstance(value, Mapping) and self._keeps(scalar(value.get("kind", self.own.kind))):
            self.waiting += [(key, each) for key, each in value.items() if key != "kind"]
        else:
            if self.waiting:
                raise _replaced(where, value)
            self.own = spec.parse_one(value, where)

    def has(self, path: str) -> bool:
        """Whether it has the setting that a path begins with."""
        change = Change.read(path, None)
        return change is not None and change.name in self.own.specs()

    def _keeps(self, kind: Any) -> bool:
        return isinstance(kind, str) and kind == self.own.kind

    def done(self) -> Parameters:
        return self.own.changed(self.waiting) if self.waiting else self.own


def _replaced(where: str, value: Any) -> SettingError:
    return SettingError(
        f"{where} = {shown(value)} is not allowed after an entry that changes a part of it, which would be lost; "
        "it must stand before that: put the whole first."
    )


@dataclasses.dataclass(frozen=True)
class ChildSpec(_Spec):
    """Another parameter class (or one of several), or a tuple of them."""

    types: tuple[type[Parameters], ...] = ()
    many: bool = False
    one_or_many: bool = False

    def parse(self, value: Any, where: str) -> Any:
        if self.many or (self.one_or_many and isinstance(value, (list, tuple))):
            most = int(LIMITS["items"].high)
            if not isinstance(value, (list, tuple)) or len(value) > most:
                raise SettingError(
                    f"{where} = {shown(value)} is not allowed; it must be a list of at most {most} {self._names()}."
                )
            if self.one_or_many and not value:
                raise SettingError(f"{where} = [] is not allowed; it needs at least one of {self._names()}.")
            return tuple(self.parse_one(item, f"{where}[{i}]") for i, item in enumerate(value))
        return self.parse_one(value, where)

    def _names(self) -> str:
        return ", ".join(each.__name__ for each in self.types)

    def parse_one(self, value: Any, where: str) -> Parameters:
        if isinstance(value, self.types):
            return value
        if not isinstance(value, Mapping):
            raise SettingError(f"{where} = {shown(value)} is not allowed; it must be a {self._names()} or a mapping.")
        if len(self.types) == 1:
            return self.types[0].from_dict(value)
        return self._by_kind(value, where).from_dict({k: v for k, v in value.items() if k != "kind"})

    def _by_kind(self, value: Mapping[str, Any], where: str) -> type[Parameters]:
        kinds = {each.kind: each for each in self.types}
        if "kind" not in value:
            raise SettingError(f"{where} needs a 'kind'. Valid names: {', '.join(kinds)}.")
        kind = scalar(value["kind"])
        if not isinstance(kind, str) or kind not in kinds:
            raise SettingError(f"{where}.kind = {shown(kind)} is not allowed; {closest(kind, kinds)}")
        return kinds[kind]

    def changed(self, old: Any, changes: Sequence[Change], where: str) -> Any:
        """The old child, or each of several, with mappings and paths merged in; a whole new one where one is given."""
        several = isinstance(old, tuple)
        parts = [_Part(each) for each in (old if several else (old,))]
        for each in changes:
            if each.place is not None:
                chosen = self._chosen(each.place, len(parts), several, where)
                # Alternatives of other kinds may lack a setting.
                having = [i for i in chosen if parts[i].has(each.rest)] if each.place == "*" else []
                for i in having or chosen:
                    parts[i].take(self, each, f"{where}[{i}]")
            elif not several and (each.rest or each.scales or not isinstance(each.value, (list, tuple))):
                parts[0].take(self, each, where)
            elif each.rest or each.scales:
                raise SettingError(
                    f"{where}{'.' + each.rest if each.rest else ' *='} names none of a list of {len(parts)}; it must "
                    f"name one by its place, as {where}[0], or all by {where}[*]."
                )
            else:
                if any(part.waiting for part in parts):
                    raise _replaced(where, each.value)
                found = self.parse(each.value, where)
                several = isinstance(found, tuple)
                parts = [_Part(own) for own in (found if several else (found,))]
        return tuple(part.done() for part in parts) if several else parts[0].done()

    def _chosen(self, place: str, size: int, several: bool, where: str) -> Sequence[int]:
        """Places in the list that are meant; alternatives of which there is one are a list of it."""
        if not several and not self.one_or_many:
            raise SettingError(f"{where}[{place}] is not there; {where} is no list, so that there must be no brackets.")
        places = range(size) if place == "*" else [int(place)]
        if not size:
            raise SettingError(f"{where}[{place}] is not there; the list is empty, and must have elements for that.")
        if places[-1] >= size:
            last = f" to [{size - 1}]" if size > 1 else " alone"
            raise SettingError(f"{where}[{place}] is not there; it must be [0]{last}, or [*] for all.")
        return places

    def dump(self, value: Any) -> Any:
        if isinstance(value, tuple):
            return [self.dump(item) for item in value]
        kind = {"kind": value.kind} if len(self.types) > 1 else {}
        return kind | value.to_dict()


def number(
    default: float | Sequence[float] | None,
    unit: str,
    description: str,
    *,
    low: float,
    high: float,
    randomisable: bool = True,
    optional: bool = False,
    source: str = "",
    since: str = "",
) -> Any:
    """A dataclass field for a number [unit] in [low, high], beyond which no vehicle, sea or light is."""
    spec = NumberSpec(
        description=description,
        unit=unit,
        low=low,
        high=high,
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
        try:
            self._check()
        except ArithmeticError as error:
            # Each value is allowed, but what follows from all of them is beyond the range of numbers.
            raise SettingError(
                f"{type(self).__name__} = {shown(self.to_dict())} is not allowed; what follows from its values must be "
                f"finite: {error}."
            ) from None

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
        return {field.name: field.metadata["spec"] for field in dataclasses.fields(cls) if field.init}

    @classmethod
    def _refuse_unknown(cls, names: Iterable[Any]) -> None:
        known = list(cls.specs())
        for name in names:
            if not isinstance(name, str) or name not in known:
                raise SettingError(f"{cls.__name__} has no setting {shown(name)}; {closest(name, known)}")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Build from a mapping of plain data.

        Raises:
            SettingError: A key is unknown (the nearest valid name is given) or a value isn't allowed.
        """
        if not isinstance(data, Mapping):
            raise SettingError(f"{cls.__name__} = {shown(data)} is not allowed; it must be a mapping of settings.")
        cls._refuse_unknown(data)
        required = [f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
        for name in required:
            if name not in data:
                raise SettingError(f"{cls.__name__} needs the setting {name!r}.")
        return cls(**data)

    def to_dict(self) -> dict[str, Any]:
        """All settings as plain data that `from_dict` and JSON take."""
        return {name: spec.dump(getattr(self, name)) for name, spec in self.specs().items()}

    def essence(self) -> dict[str, Any]:
        """`to_dict` without settings that a later version brought and that are as if it hadn't."""
        found = self.to_dict()
        for name, spec in self.specs().items():
            value = getattr(self, name)
            if spec.since and value == getattr(type(self), name):
                del found[name]
            elif isinstance(spec, ChildSpec):
                several = isinstance(value, tuple)
                told = found[name] if several else [found[name]]
                parts = [
                    {key: part[key] for key in part.keys() - each.specs().keys()} | each.essence()
                    for each, part in zip(value if several else (value,), told, strict=True)
                ]
                found[name] = parts if several else parts[0]
        return found

    def merged(self, overrides: Mapping[str, Any]) -> Self:
        """A copy with the overrides merged in, level by level.

        A key is a setting's name or a path, as in `to_dict` and `parameters()`: ``"sea.pulses[1].force_x_n": 500.0``
        changes one number and leaves the others of that pulse, ``"ship[*].speed_mps": 1.0`` that of every ship that has
        one. With ``" *="`` at a key's end the value is a factor: ``"sea.pulses[*].force_x_n *=": 0.1`` scales numbers,
        samples, and both ends of ranges. Entries hold one after the other, so that a factor multiplies what an entry
        before it has set; what follows from all of them together is checked once, at the end.

        A list that is given is the whole new list: in ``{"sea": {"pulses": [{"force_x_n": 500.0}]}}`` what the mapping
        leaves out has its class's default, whatever stood there before.

        Raises:
            SettingError: A key is unknown (the nearest valid name is given), a path leads nowhere, a value isn't
                allowed, or a whole is given after a change to a part of it.
        """
        if not isinstance(overrides, Mapping):
            raise SettingError(
                f"{type(self).__name__} = {shown(overrides)} is not allowed; changes to it must be a mapping."
            )
        return self.changed(overrides.items())

    def changed(self, entries: Iterable[tuple[Any, Any]]) -> Self:
        """`merged` for entries of which several may have the same key."""
        by_name: dict[str, list[Change]] = {}
        for key, value in entries:
            change = Change.read(key, value) if isinstance(key, str) else None
            if change is None and isinstance(key, str) and not key.isidentifier():
                raise SettingError(
                    f"{type(self).__name__} has no setting {shown(key)}; a path must be written like "
                    "'sea.pulses[1].force_x_n', with [*] for all of a list and ' *=' at its end for a factor."
                )
            self._refuse_unknown([key if change is None else change.name])
            assert change is not None
            by_name.setdefault(change.name, []).append(change)
        specs = self.specs()
        return dataclasses.replace(
            self,
            **{
                name: specs[name].changed(getattr(self, name), changes, f"{type(self).__name__}.{name}")
                for name, changes in by_name.items()
            },
        )

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
