"""The record of a block and that of the world's settings, put together from what each effect declares.

A fleet's memory is one array of float64, so that a step hands over as few arrays as possible: the settings (`WORLD`),
the numbers to draw (`DRAW`), the rows that are observed, the splines of recorded paths, and the blocks, each a `BLOCK`
followed by one `pulses.PULSE` for each pulse of the scenario.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute import rng
from uwoc_gym.compute.records import (
    CLOCK,
    LANES,
    ROW_BYTES,
    Spec,
    block_type,
    count,
    flat,
    lane_type,
    row_numbers,
    rows,
    table_type,
)
from uwoc_gym.compute.rng import counter
from uwoc_gym.parameters import ChoiceSpec, Number, Parameters
from uwoc_gym.scenario import Scenario
from uwoc_gym.task import action, ending, observation, reward
from uwoc_gym.task.reward import RewardSettings
from uwoc_gym.world.auv import fixes, horizontal, sensors
from uwoc_gym.world.optics import link
from uwoc_gym.world.sea import current, pulses
from uwoc_gym.world.ship import paths

Array = npt.NDArray[np.float64]

COMPONENTS = {
    "link": "link",
    "vehicle": "vehicle",
    "current": "sea.current",
    "sensors": "sensors",
    "fixes": "fixes",
    "start": "start",
    "reward": "reward",
    "observation": "observation",
    "episode": "episode",
    "scenario": "",
}
"""Path in `Scenario` of the settings that compiled code finds at ``b.drawn.<name>`` and ``world.<name>``."""


def component(scenario: Scenario, name: str) -> Parameters:
    """The settings of that name."""
    found: Any = scenario
    for part in filter(None, COMPONENTS[name].split(".")):
        found = getattr(found, part)
    return found  # type: ignore[no-any-return]


def _drawn() -> dict[str, Spec]:
    groups: dict[str, Spec] = {name: rows(*component(Scenario(), name).drawn()) for name in COMPONENTS}
    return {name: group for name, group in groups.items() if group} | {"ship": rows("choice") | paths.DRAWN}


MODULES: dict[str, ModuleType] = {
    "action": action,
    "auv": horizontal,
    "current": current,
    "ship": paths,
    "link": link,
    "sensors": sensors,
    "fix": fixes,
    "ending": ending,
}
"""What compiled code finds at ``b.<name>``: the module's `STATE`; its `MEASURE` and `COST` stand with all others."""


def _declared(what: str) -> dict[str, dict[str, Any]]:
    return {name: getattr(module, what) for name, module in MODULES.items() if hasattr(module, what)}


def _merged(groups: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {name: shape for group in groups.values() for name, shape in group.items()}


MEASURES = _declared("MEASURE")
COSTS = _declared("COST")
OUT = {
    # A single cost is the sum of all.
    **({"cost": _merged(COSTS)} if len(_merged(COSTS)) > 1 else {}),
    "measure": _merged(MEASURES),
    "total": rows("cost"),
    "term": reward.TERM,
    "outcome": ending.OUTCOME,
}
"""The rows that a step hands out."""

SPEC: Spec = {
    "clock": CLOCK,
    "random": rng.STATE,
    "water": horizontal.WATER,
    "wrench": horizontal.WRENCH,
    "path": paths.PATH,
    **_declared("STATE"),
    "cost": _merged(COSTS),
    **OUT,
    "observed": observation.OBSERVED,
    "drawn": _drawn(),
    "origin": rows("scenario"),
}
"""Every row of a block but those of the pulses."""

BLOCK = block_type(SPEC)
DRAW = np.dtype([(name, "f8") for name in ("row", "low", "high", "step", "index", "only", "mask")])
"""A number to draw: the fields of `Drawn`."""

DRAW_DOUBLES = DRAW.itemsize // 8
BLOCK_DOUBLES = BLOCK.itemsize // 8
ROW = dict(row_numbers(SPEC))
"""Number of each row by its dotted name."""
FIRST_OUT = next(ROW[f"{group}.{name}"] for group, own in OUT.items() for name in own)
OUT_ROWS = sum(count(group) for group in OUT.values())
ORIGIN = ROW["origin.scenario"]
"""The row that says of which scenario a state is."""
CURRENT = [ROW["current.x"], ROW["current.y"], ROW["drawn.current.speed_mps"], ROW["drawn.current.std_mps"]]
"""The rows that are 0 where no current flows."""
SEGMENTS = [ROW["drawn.ship.first_segment"], ROW["drawn.ship.segments"]]
"""The rows that say where a recorded path's segments stand among all, and how many they are."""
DRAWN_SHIP = (ROW["drawn.ship.choice"], ROW["drawn.ship.choice"] + count(SPEC["drawn"]["ship"]))
"""First of the rows of the ship's path, and the one after the last."""

_PREFIXES = {"cost": "cost_", "term": "reward_"}
MEASURE_NAMES = tuple(f"{_PREFIXES.get(group, '')}{name}" for group, own in OUT.items() for name in own)
"""Names of the measures that a step writes out, in their order."""

FLAGS = ("terminated", "truncated", "in_cone", "is_success")
"""The measures that are true or false."""

FLAG_ROWS = tuple(FIRST_OUT + MEASURE_NAMES.index(name) for name in FLAGS)
"""Numbers of their rows."""


def info_names(scenario: Scenario) -> tuple[str, ...]:
    """Keys of `info` at every step, in the order of the measures.

    What an effect measures is shown where it acts, what it costs where another costs too, and a reward term whose
    weight is 0 by default where it has one, so that what is new doesn't change old worlds.
    """
    weights = (RewardSettings(), scenario.reward)
    silent = {f"reward_{name}" for name in reward.TERM if all(getattr(each, name) == 0.0 for each in weights)}
    for name, own in MEASURES.items():
        if not _acts(scenario, name):
            silent |= set(own)
    costs = {f"cost_{cost}" for name, own in COSTS.items() if _acts(scenario, name) for cost in own}
    silent |= {f"cost_{cost}" for cost in _merged(COSTS)} - (costs if len(costs) > 1 else set())
    return tuple(name for name in MEASURE_NAMES if name not in {"reward", "terminated", "truncated"} | silent)


def _acts(scenario: Scenario, name: str) -> bool:
    """Whether an effect is executed."""
    return name not in COMPONENTS or bool(component(scenario, name).fixed_values().get("acts", True))


class _Layout(NamedTuple):
    """Where the parts of the memory begin [doubles], and what else a step has to know of it."""

    draws: float = 0.0
    observed: float = 0.0
    segments: float = 0.0
    blocks: float = 0.0
    block_doubles: float = 0.0
    autoreset: float = 0.0


def _world(scenario: Scenario, layout: _Layout) -> dict[str, Any]:
    fixed = {name: component(scenario, name).fixed_values() for name in COMPONENTS}
    groups = {name: values for name, values in fixed.items() if values}
    return groups | {"ship": paths.kinds(scenario.ship_paths), "layout": layout._asdict()}


WORLD = table_type(_world(Scenario(), _Layout()))


class Drawn(NamedTuple):
    """A number that an episode may draw."""

    path: str
    """Its path in the scenario; empty for what follows from the kind of the ship's path."""
    row: int
    low: float
    high: float
    counter: tuple[float, float]
    only: int = -1
    """The alternative of the ship's path to which it belongs; −1 for all."""
    mask: int = 0
    """If it is a choice, the places that may be drawn, as bits."""
    options: tuple[str, ...] = ()
    """Names of all places; none for the ship's paths, which have only their place."""

    @property
    def allowed(self) -> tuple[str, ...]:
        """The names of the places that may be drawn."""
        return tuple(name for place, name in enumerate(self.options) if self.mask >> place & 1)


def _range(value: Number) -> tuple[float, float]:
    low, high = (min(value), max(value)) if isinstance(value, tuple) else (value, value)
    return float(low), float(high)


def _mask(places: Any) -> int:
    """The places of a choice as bits."""
    return sum(1 << int(place) for place in (places if isinstance(places, tuple) else (places,)))


def drawn_numbers(scenario: Scenario) -> list[Drawn]:
    """All numbers that episodes of the scenario may draw."""
    found = []
    for name, prefix in COMPONENTS.items():
        own = component(scenario, name)
        rows_of = {key: ROW[f"drawn.{name}.{key}"] for key in own.drawn()}
        found += numbers_of(own, f"{prefix}.", f"{prefix}.", rows_of)
    for i, pulse in enumerate(scenario.sea.pulses):
        first = BLOCK.itemsize // ROW_BYTES + i * count(pulses.ROWS)
        rows_of = {key: first + k for k, key in enumerate(pulses.ROWS)}
        found += numbers_of(pulse, f"sea.pulses[{i}].", f"sea.pulses[{i}].", rows_of)
    alternatives = scenario.ship_paths
    last = len(alternatives) - 1
    everyone = _mask(tuple(range(last + 1)))
    found.append(Drawn("ship", ROW["drawn.ship.choice"], 0.0, last, counter("ship"), mask=everyone))
    first_segment = 0
    for i, path in enumerate(alternatives):
        place = f"ship[{i}]." if isinstance(scenario.ship, tuple) else "ship."
        rows_of = {key: ROW[f"drawn.ship.{key}"] for key in paths.DRAWN}
        found += numbers_of(path, place, f"ship.{path.kind}.", rows_of, i)
        further = paths.further_numbers(path, first_segment)
        first_segment += further["segments"]
        found += [Drawn("", rows_of[key], value, value, (0.0, 0.0), i) for key, value in further.items()]
    return found


def varying(scenario: Scenario) -> tuple[str, ...]:
    """Paths of the numbers and choices that differ from episode to episode."""
    return tuple(each.path for each in drawn_numbers(scenario) if each.path and each.low < each.high)


def numbers_of(own: Parameters, place: str, name: str, rows_of: dict[str, int], only: int = -1) -> list[Drawn]:
    """The numbers and choices of one component, whose draws hang on ``name``."""
    specs = own.specs()
    found = []
    for key, value in own.drawn_values().items():
        spec = specs[key]
        choice: dict[str, Any] = {"mask": _mask(value), "options": spec.options} if isinstance(spec, ChoiceSpec) else {}
        path, draw = (f"{prefix}{key}".lstrip(".") for prefix in (place, name))
        found.append(Drawn(path, rows_of[key], *_range(value), counter(draw), only, **choice))
    return found


class Memory(NamedTuple):
    """A fleet's memory and its parts, all views of one array."""

    array: Array
    world: Any
    """The settings, a record of type `WORLD`."""
    blocks: Any
    """The blocks, records of type `BLOCK`, shape (blocks,)."""
    rows: Array
    """All rows of the blocks with their pulses, shape (blocks, rows, LANES)."""
    segments: int
    """How many segments recorded paths have in all."""


def view(array: Array) -> Memory:
    """The parts of a fleet's memory."""
    world = array[: WORLD.itemsize // 8].view(WORLD)[0]
    sizes = world["layout"]
    first, size = int(sizes["blocks"]), int(sizes["block_doubles"])
    blocks = array[first:].reshape(-1, size)
    stride = ROW_BYTES // 8
    return Memory(
        array=array,
        world=world,
        blocks=blocks[:, :BLOCK_DOUBLES].view(BLOCK)[:, 0],
        rows=blocks.reshape(len(blocks), size // stride, stride)[:, :, : stride - 8],
        segments=(first - int(sizes["segments"])) // paths.SEGMENT_DOUBLES,
    )


def build(scenario: Scenario, size: int, max_steps: int, autoreset: int) -> Memory:
    """The memory of a fleet of that many simulations, with all rows 0."""
    draws = np.array(
        [(each.row, each.low, each.high, *each.counter, each.only, each.mask) for each in drawn_numbers(scenario)],
        dtype=np.float64,
    )
    rows_of = {name: ROW[f"observed.{observation.row_name(name)}"] for name in scenario.observation.groups}
    observed = np.concatenate(
        [first + np.arange(len(observation.GROUPS[name]), dtype=np.float64) for name, first in rows_of.items()]
    )
    splines = np.concatenate([path.segments() for path in scenario.ship_paths])
    draws_at, observed_at, segments_at, blocks_at = np.cumsum(
        [WORLD.itemsize // 8, draws.size, observed.size, splines.size]
    ).tolist()
    doubles = BLOCK_DOUBLES + len(scenario.sea.pulses) * pulses.DOUBLES
    world = _world(scenario, _Layout(draws_at, observed_at, segments_at, blocks_at, doubles, autoreset))
    world["episode"]["max_steps"] = max_steps
    return view(np.concatenate([flat(world), draws.ravel(), observed, splines, np.zeros(-(-size // LANES) * doubles)]))


def origin(scenario: Scenario) -> float:
    """A number that tells scenarios apart."""
    return float(int(scenario.digest()[:13], 16))


def lane_record(scenario: Scenario) -> np.dtype[Any]:
    """The record of the whole state of one lane: its names are those of the rows."""
    own = {f"pulse_{i}": pulses.ROWS for i in range(len(scenario.sea.pulses))}
    return lane_type({**SPEC, "pulses": own} if own else SPEC)
