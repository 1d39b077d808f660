"""The file of an agent: one zip, as Stable-Baselines3 saves it, in which ``agent.json`` says all that acting needs.

Stable-Baselines3 loads it too, and then runs the pickled objects of its member ``data``. Here that is never looked at:
``agent.json`` has the settings and the normalisation statistics, and tensors are read by weights alone. All of an agent
is in the one file, so that what belongs together is replaced together.
"""

from __future__ import annotations

import hashlib
import io
import json
import reprlib
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.policies.algorithms import ALGORITHMS, policy_arguments
from uwoc_gym.given import check_plain

MEMBER = "agent.json"
"""What makes a zip file of Stable-Baselines3 an agent of this package."""

CORRECTED = "corrected.zip"
"""The file of the agent that this one corrects, if it corrects one."""

FORMAT = 2
_POLICY = "policy.pth"
_LARGEST_TEXT, _LARGEST_TENSORS = 2**24, 2**31
"""Bytes of ``agent.json`` and of a file of tensors above which neither is read."""

Array = npt.NDArray[np.float64]


class Member(io.BytesIO):
    """A file that another one holds, read into memory."""

    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(data)
        self._name = name

    def __str__(self) -> str:
        return self._name


Source = Path | Member
"""An agent's file."""


@dataclass(frozen=True)
class Statistics:
    """Running statistics of a normalisation, as Stable-Baselines3 keeps them."""

    mean: Array
    variance: Array
    count: float

    def to_dict(self) -> dict[str, Any]:
        """As plain data, to the last bit."""
        return {"mean": self.mean.tolist(), "variance": self.variance.tolist(), "count": float(self.count)}


@dataclass(frozen=True)
class Normalisation:
    """The normalisation that an agent was trained in; observations as VecNormalize gives them, with it frozen.

    Attributes:
        observations: Statistics of shape (size,); None where observations are left as they are.
        returns: Statistics of shape (), which only training needs.
        clip: Bound of a normalised entry.
        epsilon: What is added to the variance.
    """

    observations: Statistics | None
    returns: Statistics
    clip: float
    epsilon: float

    def __call__(self, observations: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Normalised observations, of the shape that they are given in."""
        seen = self.observations
        if seen is None:
            return observations
        scaled = (observations - seen.mean) / np.sqrt(seen.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """As plain data, to the last bit."""
        return {
            "observations": self.observations.to_dict() if self.observations is not None else None,
            "returns": self.returns.to_dict(),
            "clip": float(self.clip),
            "epsilon": float(self.epsilon),
        }


@dataclass(frozen=True, kw_only=True)
class Description:
    """What ``agent.json`` says."""

    description: str
    algorithm: str
    env: str
    """The environment's ID."""
    observation: dict[str, Any] | None
    """Names of entries and actions, and scales; None for environments of others."""
    control_period_s: float | None
    policy: str
    """The network's name in Stable-Baselines3, such as MlpPolicy."""
    policy_kwargs: dict[str, Any]
    """As a settings file says them."""
    use_sde: bool
    frame_stack: int
    normalisation: Normalisation | None
    residual: dict[str, Any] | None
    """What it corrects and by what scale: "gains", "policy" or "agent" (a member of its file), and "scale"."""
    beliefs: list[str] | None = None
    """What filters add to its observations; None for nothing."""

    @property
    def seen(self) -> int:
        """How many entries it sees at a time, in an environment of this package."""
        assert self.observation is not None
        return len(self.observation["entries"]) + len(self.beliefs or ())

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        normalisation = self.normalisation.to_dict() if self.normalisation is not None else None
        return {"format": FORMAT, **vars(self), "normalisation": normalisation}


def write(model: Any, description: Description, file: IO[bytes], corrected: bytes | None = None) -> None:
    """Save a model with what it needs to act.

    Args:
        model: A model of Stable-Baselines3 or sb3-contrib.
        description: What else there is to say.
        file: Open for reading and writing.
        corrected: The file of the agent that it corrects, if it corrects one.
    """
    model.save(file)
    if corrected is not None:
        with zipfile.ZipFile(file, "a") as archive:
            archive.writestr(CORRECTED, corrected)
    _describe(file, description)


def write_for_acting(source: Path, file: IO[bytes], text: str) -> None:
    """Copy an agent without what only training needs.

    Args:
        source: The agent's file.
        file: Open for reading and writing.
        text: Its description in a line.

    Raises:
        CommandError: The source can't be read.
    """
    import torch

    description = read(source)
    with _opened(source) as archive, zipfile.ZipFile(file, "w") as copy:
        for name in archive.namelist():
            if name.endswith("optimizer.pth"):
                # The optimisers' moments are a third of the file and of no use to act.
                state = {**_tensors(archive, name, source), "state": {}}
                with copy.open(name, "w") as member:
                    torch.save(state, member)
            elif name != MEMBER:
                copy.writestr(name, archive.read(name))
    _describe(file, Description(**{**vars(description), "description": text}))


def _describe(file: IO[bytes], description: Description) -> None:
    with zipfile.ZipFile(file, "a") as archive:
        said = {**description.to_dict(), "policy_sha256": hashlib.sha256(archive.read(_POLICY)).hexdigest()}
        try:
            text = json.dumps(said, indent=1, allow_nan=False)
        except ValueError:
            raise CommandError(
                "the agent can't be saved: its normalisation statistics are not all finite; the training has diverged."
            ) from None
        archive.writestr(MEMBER, text + "\n")


@contextmanager
def _opened(path: Source) -> Iterator[zipfile.ZipFile]:
    """An agent's file to read from.

    Raises:
        CommandError: It can't be read, or isn't whole.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, NotImplementedError, RuntimeError, OSError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or f"it is damaged: {error}"
        raise CommandError(f"{str(path)!r} can't be read: {' '.join(str(reason).split())}.") from None


def is_agent(path: Path) -> bool:
    """Whether a file is an agent of this package rather than anything else.

    Raises:
        CommandError: It is no zip file of Stable-Baselines3.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, OSError):
        names = []
    if MEMBER not in names and "data" not in names:
        raise CommandError(f"{str(path)!r} is not a zip file saved by Stable-Baselines3.")
    return MEMBER in names


def read(path: Source) -> Description:
    """What the ``agent.json`` in an agent's file says.

    Raises:
        CommandError: The file can't be read, or says what isn't allowed.
    """
    with _opened(path) as archive:
        return _read(archive, path)[0]


def _read(archive: zipfile.ZipFile, path: Source) -> tuple[Description, str]:
    """What ``agent.json`` says, and the digest of the weights that it was written for."""
    text = _member(archive, MEMBER, _LARGEST_TEXT, path)
    try:
        said = json.loads(text, parse_constant=_no_number)
        check_plain(said)
    except (ValueError, RecursionError) as error:
        _refuse(path, f"is no JSON: {' '.join(str(error).split())}")
    if not isinstance(said, dict):
        _refuse(path, "is not an object")
    if said.get("format") != FORMAT:
        _refuse(path, f"has format = {reprlib.repr(said.get('format'))}; this version reads {FORMAT}")
    fields: dict[str, Any] = {}
    # Before there were filters nobody said that there were none.
    said.setdefault("beliefs", None)
    for name, (allowed, check) in _FIELDS.items():
        if name not in said:
            _refuse(path, f"lacks {name}; it must be {allowed}")
        if not check(said[name]):
            _refuse(path, f"has {name} = {reprlib.repr(said[name])}, which is not allowed; it must be {allowed}")
        fields[name] = said[name]
    digest = fields.pop("policy_sha256")
    return Description(**{**fields, "normalisation": _normalisation(said["normalisation"])}), digest


def _member(archive: zipfile.ZipFile, name: str, largest: int, path: Source) -> bytes:
    size = archive.getinfo(name).file_size
    if size > largest:
        raise CommandError(f"{str(path)!r} can't be read: its {name} has {size} bytes; it must have {largest} at most.")
    return archive.read(name)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def _refuse(path: Source, reason: str) -> NoReturn:
    raise CommandError(f"{str(path)!r} doesn't describe an agent: its {MEMBER} {reason}.")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(_is_text(each) for each in value)


def _is_layout(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"entries", "scales", "actions"}
        and _are_texts(value["entries"])
        and _are_texts(value["actions"])
        and isinstance(value["scales"], dict)
        and all(_is_number(each) for each in value["scales"].values())
    )


def _are_numbers(value: Any) -> bool:
    """Whether it is a number or, level by level, a list of such that makes an array."""
    return _is_number(value) or (
        isinstance(value, list)
        and len(value) > 0
        and all(_are_numbers(each) for each in value)
        and len({np.shape(each) for each in value}) == 1
    )


def _are_statistics(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"mean", "variance", "count"}
        and all(_are_numbers(each) for each in value.values())
        and np.shape(value["mean"]) == np.shape(value["variance"])
        and bool(np.min(value["variance"]) >= 0.0)
        and _is_number(value["count"])
        and value["count"] > 0.0
    )


def _is_normalisation(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"observations", "returns", "clip", "epsilon"}
        and (value["observations"] is None or _are_statistics(value["observations"]))
        and _are_statistics(value["returns"])
        and all(_is_number(value[key]) and value[key] >= 0.0 for key in ("clip", "epsilon"))
    )


def _normalisation(said: Mapping[str, Any] | None) -> Normalisation | None:
    if said is None:
        return None
    seen = said["observations"]
    return Normalisation(
        None if seen is None else _statistics(seen), _statistics(said["returns"]), said["clip"], said["epsilon"]
    )


def _statistics(said: Mapping[str, Any]) -> Statistics:
    return Statistics(np.array(said["mean"], dtype=float), np.array(said["variance"], dtype=float), said["count"])


_CORRECTED: dict[str, Callable[[Any], bool]] = {
    "gains": lambda value: isinstance(value, dict),
    "policy": _is_text,
    "agent": lambda value: value == CORRECTED,
}
"""How a file may tell what its agent corrects."""


def _is_residual(value: Any) -> bool:
    return isinstance(value, dict) and any(
        value.keys() == {key, "scale"} and check(value[key]) for key, check in _CORRECTED.items()
    )


_FIELDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "description": ("text", _is_text),
    "algorithm": (f"one of {', '.join(ALGORITHMS)}", lambda value: _is_text(value) and value in ALGORITHMS),
    "env": ("the ID of an environment", _is_text),
    "observation": (
        "null or an object with entries and actions, lists of names, and scales, numbers by name",
        lambda value: value is None or _is_layout(value),
    ),
    "control_period_s": (
        "null or a time above 0 [s]", lambda value: value is None or (_is_number(value) and value > 0.0)
    ),
    "policy": ("the name of a network, such as MlpPolicy", _is_text),
    "policy_kwargs": ("an object of the network's settings", lambda value: isinstance(value, dict)),
    "use_sde": ("true or false", lambda value: isinstance(value, bool)),
    "frame_stack": (
        "a whole number of at least 1",
        lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= 1,
    ),
    "normalisation": (
        "null or an object with the statistics of observations, if they are normalised, and of returns (finite numbers "
        "mean, variance and count), clip and epsilon",
        lambda value: value is None or _is_normalisation(value),
    ),
    "residual": (
        "null or an object with a scale and with gains, the name of a policy, or that of an agent's file in this one",
        lambda value: value is None or _is_residual(value),
    ),
    "beliefs": (
        "null or a list of the entries that filters add",
        lambda value: value is None or (isinstance(value, list) and bool(value) and all(map(_is_text, value))),
    ),
    "policy_sha256": (
        "the SHA-256 of policy.pth, 64 hexadecimal digits", lambda value: _is_text(value) and len(value) == 64
    ),
}  # fmt: skip
"""What each field may be, in words and as a check; what is read elsewhere, such as gains, is checked there."""


def _tensors(archive: zipfile.ZipFile, name: str, path: Source) -> dict[str, Any]:
    """What a member holds: tensors and numbers by name, read without running anything."""
    import torch

    data = _member(archive, name, _LARGEST_TENSORS, path)
    try:
        found = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:
        # PyTorch's own advice is to read it as a pickle after all.
        raise CommandError(
            f"{str(path)!r} can't be read: its {name} is not tensors alone ({type(error).__name__})."
        ) from None
    if not isinstance(found, dict):
        raise CommandError(f"{str(path)!r} can't be read: its {name} holds a {type(found).__name__}, not tensors.")
    return found


def read_policy(path: Source) -> tuple[Any, Description]:
    """The network of an agent in an environment of this package, ready to act, and its description.

    Raises:
        CommandError: It can't be read, its parts don't belong together, or what it needs isn't installed.
    """
    import torch
    from gymnasium import spaces

    with _opened(path) as archive:
        said, digest = _read(archive, path)
        if hashlib.sha256(_member(archive, _POLICY, _LARGEST_TENSORS, path)).hexdigest() != digest:
            raise CommandError(
                f"{str(path)!r} can't be flown: its {_POLICY} and its {MEMBER} are not of one agent; the SHA-256 in "
                "agent.json is another file's."
            )
        weights = _tensors(archive, _POLICY, path)
    kind = ALGORITHMS[said.algorithm]
    require(kind.module)
    aliases = kind.load().policy_aliases
    if said.policy not in aliases:
        _refuse(path, f"has policy = {said.policy!r}, which is not allowed; it must be one of {', '.join(aliases)}")
    if said.observation is None:
        raise CommandError(
            f"policy {str(path)!r} was trained in {said.env!r}, whose observations are not this package's."
        )
    entries = said.seen
    seen = said.normalisation.observations if said.normalisation is not None else None
    if seen is not None and seen.mean.shape != (entries,):
        _refuse(path, f"has statistics of shape {seen.mean.shape} for {entries} entries; they must be of one length")
    _check_sizes(path, said, entries * said.frame_stack, weights)
    options = {"use_sde": True} if said.use_sde else {}
    try:
        policy = aliases[said.policy](
            spaces.Box(-np.inf, np.inf, (entries * said.frame_stack,), np.float32),
            spaces.Box(-1.0, 1.0, (len(said.observation["actions"]),), np.float32),
            _no_learning,
            **policy_arguments(said.policy_kwargs),
            **options,
        )
        # The network isn't made by what it is told alone: weights of other shapes are refused here.
        policy.load_state_dict(weights)
        if said.use_sde:
            policy.reset_noise()
    except CommandError as error:
        raise CommandError(f"{str(path)!r} can't be flown: {error}") from None
    except Exception as error:
        text = " ".join(str(error).split())
        raise CommandError(
            f"{str(path)!r} can't be flown: the network that its {MEMBER} describes and its weights don't fit: "
            f"{type(error).__name__}: {text[:200]}"
        ) from None
    if not all(bool(torch.isfinite(each).all()) for each in weights.values()):
        raise CommandError(f"{str(path)!r} can't be flown: its weights are not all finite.")
    policy.set_training_mode(False)
    return policy, said


def read_corrected(path: Source) -> Member:
    """The file of the agent that an agent corrects.

    Raises:
        CommandError: It can't be read.
    """
    with _opened(path) as archive:
        return Member(_member(archive, CORRECTED, _LARGEST_TENSORS, path), f"{path}, {CORRECTED}")


def _no_learning(progress_remaining: float) -> float:
    return 0.0


def _check_sizes(path: Source, said: Description, seen: int, weights: Mapping[str, Any]) -> None:
    """Refuse a description of a network larger than its weights before anything of its size is made."""
    import torch

    if not weights or not all(isinstance(each, torch.Tensor) and each.is_contiguous() for each in weights.values()):
        raise CommandError(f"{str(path)!r} can't be read: its {_POLICY} is not tensors alone.")
    largest = max(len(weights), *(size for each in weights.values() for size in each.shape), 1)
    sizes = {"frame_stack": seen, "policy_kwargs": _largest_in(said.policy_kwargs)}
    for name, size in sizes.items():
        if not size <= largest:
            value = reprlib.repr(getattr(said, name))
            _refuse(path, f"has {name} = {value}, which is not allowed; the weights have nothing of that size")


def _largest_in(value: Any) -> float:
    """The largest number or length in settings."""
    if isinstance(value, (int, float)):
        return abs(value)
    if isinstance(value, dict):
        value = list(value.values())
    return max([len(value), *(_largest_in(each) for each in value)]) if isinstance(value, list) else 0.0


def read_training(path: Path, model: Any) -> Description:
    """Put all that training changes in a model back in place: weights, optimisers and other tensors.

    Args:
        path: The agent's file.
        model: A model made with the same settings; counters and replay buffer are not in the file.

    Returns:
        The description, which has the normalisation's statistics.

    Raises:
        CommandError: The file can't be read, or is of another model.
    """
    from stable_baselines3.common.save_util import recursive_getattr

    with _opened(path) as archive:
        said, _ = _read(archive, path)
        found = {
            name.removesuffix(".pth"): _tensors(archive, name, path)
            for name in archive.namelist()
            if name.endswith(".pth") and archive.getinfo(name).file_size
        }
    variables = found.pop("pytorch_variables", {})
    try:
        model.set_parameters(found, exact_match=True, device="cpu")
        for name, value in variables.items():
            if value is not None:
                recursive_getattr(model, name).data = value.data
    except Exception as error:
        text = " ".join(str(error).split())
        raise CommandError(f"{str(path)!r} is of another model: {type(error).__name__}: {text[:200]}") from None
    return said
