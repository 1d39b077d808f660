"""Learning from a teacher, with networks and episodes small enough for seconds."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import checkpoints, imitation, training
from uwoc_gym.agents.learning.plans import Wish, planned
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.scenario import Scenario

SHORT = '{"episode": {"duration_s": 4.0}}'
SET = (
    "teacher=pd", "teacher_steps=20000", "critic_steps=512", "staggered=true", "n_steps=16", "batch_size=64",
    "n_epochs=2", "policy_kwargs.net_arch=[32]", "env_kwargs.scenario={}",
)  # fmt: skip


def wish(*more: str, steps: int = 512) -> Wish:
    return Wish(override=(SHORT,), envs=16, steps=steps, eval_episodes=4, set=(*SET, *more))


def command(out: Path, *more: str, steps: int = 512) -> list[str]:
    return ["train", *wish(*more, steps=steps).words(), "--out", str(out)]


def test_the_agent_comes_to_do_what_its_teacher_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(command(out)) == 0
    assert "before that at least 20,000 steps in which it copies pd" in capsys.readouterr().err
    results = json.loads((out / "results.json").read_text())
    assert results["finished"] is True
    assert results["evaluations"][0]["steps"] == 0
    # At the beginning it has learned from no reward, and after 512 steps the critic alone has.
    first, last = results["evaluations"][0]["return"]["mean"], results["evaluations"][-1]["return"]["mean"]
    assert first == last
    scenario = Scenario.named("Random").merged(json.loads(SHORT))
    seeds = range(100_000, 100_016)
    own, teacher = (fly(policy, scenario, seeds).metrics.return_ for policy in (load(str(out)), CONTROLLERS["pd"]))
    assert np.abs(own - teacher).mean() < 0.2 * teacher.mean()


@pytest.fixture
def lessons(tmp_path: Path) -> Iterator[imitation.Lessons]:
    run = training.Run(planned(wish()), tmp_path, "")
    assert run.lessons is not None
    yield run.lessons
    run.env.close()


def test_each_round_brings_it_nearer(lessons: imitation.Lessons) -> None:
    policy = lessons.model.policy
    critic = {name: each.detach().clone() for name, each in policy.named_parameters() if "value_net" in name}
    off = []
    for _ in lessons.fly():
        if len(off) < lessons.rounds:
            seen, told = lessons.seen[0], lessons.told[0]
            off.append(float((policy.get_distribution(seen).distribution.mean - told).square().mean().detach()))
    assert len(off) == imitation.ROUNDS
    assert lessons.steps >= 20000
    assert off[-1] < 0.5 * off[0]
    assert critic
    for name, each in policy.named_parameters():
        if name in critic:
            assert bool((each == critic[name]).all()), name


def test_all_that_is_labelled_is_kept(lessons: imitation.Lessons, tmp_path: Path) -> None:
    flown = lessons.fly()
    while lessons.rounds < 2:
        next(flown)
    lessons.save(tmp_path / "lessons.npz")
    before = [part.clone() for part in (*lessons.seen, *lessons.told)]
    lessons.seen, lessons.told = [], []
    lessons.restore(tmp_path / "lessons.npz")
    assert lessons.rounds == 2
    assert all(bool((own == other).all()) for own, other in zip((*lessons.seen, *lessons.told), before, strict=True))


def test_the_critic_alone_learns_where_the_rest_is_held(lessons: imitation.Lessons) -> None:
    policy = lessons.model.policy
    imitation.hold(policy, True)
    free = {name for name, each in policy.named_parameters() if each.requires_grad}
    assert free == {name for name, _ in policy.named_parameters() if "value_net" in name}
    imitation.hold(policy, False)
    assert all(each.requires_grad for each in policy.parameters())


@pytest.mark.parametrize("rounds", [0, 3])
def test_a_run_that_is_stopped_goes_on_with_what_was_labelled(
    rounds: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = imitation.Lessons.fly

    def stopped(self: Any) -> Any:
        for found in real(self):
            if self.rounds == rounds:
                os.kill(os.getpid(), signal.SIGINT)
            yield found

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(imitation.Lessons, "fly", stopped)
        assert main(command(out)) == 130
    newest = checkpoints.newest(out)
    assert newest is not None
    told = json.loads((newest / "progress.json").read_text())
    assert told["steps"] == 0
    kept = checkpoints.read_arrays(newest / "lessons.npz", ("seen",))["seen"]
    assert told["lessons"] == rounds
    assert (len(kept) > 0) == (rounds > 0)
    begun: list[tuple[int, int]] = []

    def goes_on(self: Any) -> Any:
        begun.append((self.rounds, sum(len(part) for part in self.told)))
        yield from real(self)

    with monkeypatch.context() as patch:
        patch.setattr(imitation.Lessons, "fly", goes_on)
        assert main(["train", "--resume", "--out", str(out)]) == 0
    assert begun == [(rounds, len(kept))]
    newest = checkpoints.newest(out)
    assert newest is not None
    assert json.loads((newest / "progress.json").read_text())["lessons"] == imitation.ROUNDS
    assert not (newest / "lessons.npz").exists()


def test_lessons_that_are_rounded_up_are_all_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rounds of 16 environments are more steps than were asked for, and yet not all."""
    real = imitation.Lessons.fly

    def stopped(self: Any) -> Any:
        for found in real(self):
            if self.rounds == 2:
                os.kill(os.getpid(), signal.SIGINT)
            yield found

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(imitation.Lessons, "fly", stopped)
        assert main(command(out, "teacher_steps=20")) == 130
    flown: list[int] = []

    def goes_on(self: Any) -> Any:
        flown.append(self.rounds)
        yield from real(self)
        flown.append(self.rounds)

    monkeypatch.setattr(imitation.Lessons, "fly", goes_on)
    assert main(["train", "--resume", "--out", str(out)]) == 0
    assert flown == [2, imitation.ROUNDS]


def test_a_teacher_that_was_copied_need_not_be_there_any_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone, out = tmp_path / "gone", tmp_path / "run"
    assert main(command(gone, "teacher=null", "critic_steps=0", "residual=pd", steps=64)) == 0
    sha256 = hashlib.sha256((gone / "model.zip").read_bytes()).hexdigest()
    real = training.Run.evaluate

    def stopped(self: Any) -> Any:
        if self.model.num_timesteps:
            os.kill(os.getpid(), signal.SIGINT)
        return real(self)

    with monkeypatch.context() as patch:
        patch.setattr(training.Run, "evaluate", stopped)
        words = command(out, f"teacher={gone}", "teacher_steps=200", "critic_steps=0", steps=2048)
        assert main([*words, "--eval-every", "256"]) == 130
    shutil.rmtree(gone)
    assert main(["train", "--resume", "--out", str(out)]) == 0
    results = json.loads((out / "results.json").read_text())
    assert (results["finished"], results["teacher_sha256"]) == (True, sha256)


class Fixed:
    """A teacher that does the same everywhere."""

    def __init__(self, action: list[float]) -> None:
        self._action = np.array(action, dtype=np.float32)

    def predict(self, observation: Any, **_: Any) -> tuple[Any, None]:
        return np.tile(self._action, (len(observation), 1)), None


def narrow(scenario: Scenario) -> Fixed:
    return Fixed([0.5])


def nowhere(scenario: Scenario) -> Fixed:
    return Fixed([math.nan] * 3)


def far(scenario: Scenario) -> Fixed:
    return Fixed([50.0, -50.0, 0.5])


@pytest.mark.parametrize(("name", "error"), [("narrow", "actions of shape (4, 1)"), ("nowhere", "not all finite")])
def test_a_teacher_that_gives_no_actions_is_refused(
    name: str, error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    teacher = f"teacher={Fixed.__module__}:{name}"
    assert main(command(tmp_path / "run", teacher)) == 1
    said = capsys.readouterr().err
    assert error.replace("(4, 1)", "(1, 1)") in said
    assert "teacher = " in said
    assert not (tmp_path / "run").exists()


def test_what_is_told_lies_within_the_limits(tmp_path: Path) -> None:
    run = training.Run(planned(wish(f"teacher={Fixed.__module__}:far", "teacher_steps=200")), tmp_path, "")
    assert run.lessons is not None
    for _ in run.lessons.fly():
        pass
    run.env.close()
    assert np.unique(np.concatenate([part.numpy() for part in run.lessons.told]), axis=0).tolist() == [[1.0, -1.0, 0.5]]


def test_code_that_is_named_asks_for_trust_again() -> None:
    assert wish("teacher=my.module:make").names_code
    assert not wish().names_code


def test_what_the_critic_learns_alone_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command(tmp_path / "all", "teacher_steps=20")) == 0
    told = capsys.readouterr()
    assert "in the first 512 steps its critic alone learns, which is all of them" in told.err
    assert "before it had learned from rewards" in told.out
    assert main(command(tmp_path / "some", "teacher_steps=20", "critic_steps=256")) == 0
    assert "in the first 256 steps its critic alone learns\n" in capsys.readouterr().err


def test_damaged_lessons_are_refused(tmp_path: Path, lessons: imitation.Lessons) -> None:
    path, entries = tmp_path / "lessons.npz", lessons.model.observation_space.shape[0]
    lot = 16 * -(-20000 // (16 * imitation.ROUNDS))
    for rows, width in ((7, entries), (lot, entries + 1)):
        np.savez(path, seen=np.zeros((rows, width), dtype=np.float32), told=np.zeros((rows, 3), dtype=np.float32))
        with pytest.raises(CommandError, match="can't be read: it is damaged, or of another run: its arrays don't fit"):
            lessons.restore(path)


@pytest.mark.parametrize(
    ("more", "error"),
    [
        (("teacher=clairvoyant",), "teacher = 'clairvoyant' is not allowed: it decides on what no observation tells"),
        (("residual=pd",), "teacher = 'pd' is not allowed with residual = 'pd'"),
        (("normalize=true",), "teacher = 'pd' is not allowed with normalize = True"),
        (("teacher=nobody",), "teacher = 'nobody' is not allowed; there is no policy 'nobody'"),
        (
            ("policy_kwargs.squash_output=true", "use_sde=true"),
            "teacher = 'pd' is not allowed with policy_kwargs.squash_output",
        ),
        (("teacher=null",), "critic_steps = 512 is not allowed with n_timesteps = 512; it must be less"),
        (("teacher_steps=0",), "teacher_steps = 0 is not allowed"),
        (("critic_steps=-1",), "critic_steps = -1 is not allowed"),
        (("staggered=1",), "staggered = 1 is not allowed; it must be true or false"),
    ],
)
def test_what_cant_be_copied_is_refused(
    more: tuple[str, ...], error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(tmp_path / "run", *more)) == 1
    assert error in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("setting", ["teacher=pd", "critic_steps=100"])
def test_other_algorithms_refuse_it(setting: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--algorithm", "td3", "--set", setting, "--out", str(tmp_path / "run")]) == 1
    assert "is not allowed for td3; the algorithm must be ppo" in capsys.readouterr().err
