"""Folders by their address: what is elsewhere gets the same files, and loses none that were whole."""

from __future__ import annotations

import gc
import json
import signal
import time
from pathlib import Path
from typing import Any

import fsspec
import pytest

from uwoc_gym.agents import places
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import protocol
from uwoc_gym.agents.learning.plans import Wish

SHORT = ["--override", "episode.duration_s=3"]
LEARN = ["--algorithm", "ppo", "--frame-stack", "1", "--envs", "4", "--set", "n_steps=16", "--set", "batch_size=32"]


@pytest.fixture(params=["memory", "file"])
def there(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of a folder that is elsewhere."""
    if request.param == "file":
        return f"file://{tmp_path}/elsewhere"
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    return "memory://elsewhere"


def names(address: str) -> set[str]:
    system, root = fsspec.core.url_to_fs(address)
    return {path[len(root) :].lstrip("/") for path in system.find(root)}


def read(address: str) -> bytes:
    with fsspec.open(address, "rb") as file:
        found: bytes = file.read()
    return found


@pytest.mark.parametrize(
    ("given", "expected"), [("s3://a/b", True), ("runs/a", False), ("a:b", False), ("C:\\a", False)]
)
def test_an_address_names_a_file_system(given: str, expected: bool) -> None:
    assert places.elsewhere(given) is expected


def test_what_changes_goes_back(there: str) -> None:
    with places.held(there) as folder:
        (folder / "sub").mkdir()
        (folder / "sub/one.txt").write_text("1")
        (folder / "two.txt").write_text("2")
        (folder / ".lock").write_text("")
        (folder / "three.txt.part").write_text("")
        places.keep(folder / "sub")
        assert {"sub/one.txt", "two.txt"} == names(there) - {".files.json"}
        assert places.address(folder / "sub" / "one.txt") == f"{there}/sub/one.txt"
        (folder / "two.txt").unlink()
        (folder / "sub/one.txt").write_text("one")
    assert names(there) == {"sub/one.txt", ".files.json"}
    with places.held(there) as folder:
        assert [path.name for path in folder.rglob("*")] == ["sub", "one.txt"]
        assert (folder / "sub/one.txt").read_text() == "one"
    assert not folder.exists()
    assert places.names(there, "su") == ["sub"]
    assert places.names(f"{there}/nothing", "") == []


def test_what_is_kept_seldom_waits(there: str) -> None:
    with places.held(there) as folder:
        (folder / "one.txt").write_text("1")
        places.keep(folder, every_s=1000.0)
        assert names(there) == set()


def test_what_has_failed_goes_back_too_and_is_named_by_its_address(there: str) -> None:
    def work() -> None:
        with places.held(there) as folder:
            (folder / "one.txt").write_text("1")
            raise CommandError(f"{folder / 'one.txt'} is damaged")

    with pytest.raises(CommandError, match=f"{there}/one.txt is damaged"):
        work()
    assert "one.txt" in names(there)


def test_what_was_removed_there_is_gone_here(there: str) -> None:
    with places.held(there) as folder:
        for name in ("one.json", "two.txt"):
            (folder / name).write_text("{}")
    assert places.local(f"{there}/one.json").is_file()
    copy = places.local(there)
    assert sorted(path.name for path in copy.iterdir()) == ["one.json", "two.txt"]
    system, root = fsspec.core.url_to_fs(there)
    system.rm_file(f"{root}/one.json")
    assert not places.local(f"{there}/one.json").exists()
    assert [path.name for path in places.local(there).iterdir()] == ["two.txt"]
    with places.held(there) as folder:
        assert [path.name for path in folder.iterdir()] == ["two.txt"]


def test_what_is_here_as_it_is_there_is_not_fetched_again(there: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with places.held(there) as folder:
        (folder / "one.json").write_text("1")
    system, root = fsspec.core.url_to_fs(there)
    real, fetched = type(system).get_file, []

    def counted(self: Any, *words: Any, **options: Any) -> None:
        fetched.append(words[0])
        real(self, *words, **options)

    monkeypatch.setattr(type(system), "get_file", counted)
    for _ in range(3):
        assert (places.local(there) / "one.json").read_text() == "1"
    assert len(fetched) == 1
    time.sleep(0.01)
    system.pipe_file(f"{root}/one.json", b"22")
    assert (places.local(there) / "one.json").read_text() == "22"


def test_folders_with_lists_of_their_own_are_left_alone(there: str) -> None:
    with places.held(f"{there}/runs/ppo-0") as folder:
        (folder / "run.json").write_text("{}")
    system, root = fsspec.core.url_to_fs(there)
    system.pipe_file(f"{root}/other.txt", b"1")
    with places.held(there) as folder:
        assert sorted(path.name for path in folder.rglob("*")) == ["other.txt"]
        (folder / "mine.txt").write_text("2")
    assert "runs/ppo-0/run.json" not in json.loads(read(f"{there}/.files.json"))


@pytest.mark.parametrize("name", ["../out.txt", "/out.txt", "a/../../out.txt"])
def test_a_list_of_files_names_none_outside(name: str, there: str, tmp_path: Path) -> None:
    system, root = fsspec.core.url_to_fs(there)
    system.makedirs(root, exist_ok=True)
    system.pipe_file(f"{root}/.files.json", json.dumps([name]).encode())
    with pytest.raises(CommandError, match=f"its list of files names '{name}'"), places.held(there):
        pass


@pytest.mark.parametrize("given", ["memory://", "memory:///", "memory://a/..", "memory://a/."])
def test_an_address_of_no_folder_is_refused(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--policy", "pd", "--out", given]) == 1
    assert f"--out: {given} is not allowed; it must name a folder" in capsys.readouterr().err


def test_a_refusal_leaves_nothing(there: str) -> None:
    system, root = fsspec.core.url_to_fs(there)
    assert main(["train", "--algorithm", "nope", "--out", f"{there}/a/b"]) == 1
    assert not system.exists(root)


def test_a_line_that_is_down_for_a_moment_loses_nothing(there: str, monkeypatch: pytest.MonkeyPatch) -> None:
    system, _ = fsspec.core.url_to_fs(there)
    real, failures = type(system).put_file, [1, 2]

    def breaking(self: Any, *words: Any, **options: Any) -> None:
        if failures:
            failures.pop()
            raise ConnectionResetError("the line is down")
        real(self, *words, **options)

    monkeypatch.setattr(type(system), "put_file", breaking)
    monkeypatch.setattr(places, "_PAUSES_S", (0.0, 0.0))
    with places.held(there) as folder:
        (folder / "one.txt").write_text("1")
    assert read(f"{there}/one.txt") == b"1"


def test_a_request_to_stop_while_files_are_put_back_is_heard_after_them(
    there: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    system, _ = fsspec.core.url_to_fs(there)
    real = type(system).put_file

    def interrupted(self: Any, *words: Any, **options: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        real(self, *words, **options)

    def work() -> None:
        with places.held(there) as folder:
            (folder / "one.txt").write_text("1")

    monkeypatch.setattr(type(system), "put_file", interrupted)
    with pytest.raises(KeyboardInterrupt):
        work()
    assert read(f"{there}/one.txt") == b"1"


def test_what_was_half_put_back_is_not_taken_for_whole(there: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with places.held(there) as folder:
        (folder / "checkpoint-000001").mkdir()
        (folder / "checkpoint-000001/last.zip").write_text("1")
    system, _ = fsspec.core.url_to_fs(there)
    real = type(system).put_file
    sent: list[str] = []

    def breaking(self: Any, local: str, remote: str, *more: Any, **options: Any) -> None:
        if sent:
            raise ConnectionResetError("the line is down")
        sent.append(local)
        real(self, local, remote, *more, **options)

    def work() -> None:
        with places.held(there) as folder:
            (folder / "checkpoint-000001").rename(folder / "checkpoint-000002")
            (folder / "checkpoint-000002/best.zip").write_text("2")

    with monkeypatch.context() as patch:
        patch.setattr(type(system), "put_file", breaking)
        patch.setattr(places, "_PAUSES_S", ())
        with pytest.raises(CommandError, match="the line is down; what it should have got stands in ") as caught:
            work()
    kept = Path(str(caught.value).rpartition(" ")[2])
    # Nothing removes it with what remembers it.
    del caught
    gc.collect()
    assert sorted(path.name for path in kept.rglob("*.zip")) == ["best.zip", "last.zip"]
    with places.held(there) as folder:
        assert [path.name for path in folder.rglob("*")] == ["checkpoint-000001", "last.zip"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("nowhere://a/b", "nowhere://a/b can't be used: ValueError: Protocol not known: nowhere"),
        ("file:///proc/uwoc-gym", "file:///proc/uwoc-gym can't be used: FileNotFoundError"),
    ],
)
@pytest.mark.parametrize("option", ["--out", "--runs"])
def test_what_cannot_be_reached_is_named(
    option: str, given: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = {"--out": "--runs", "--runs": "--out"}[option]
    assert main(["protocol", "--training-seeds", "0", option, given, other, str(tmp_path / "other")]) == 1
    assert f"uwoc-gym protocol: error: {option}: {said}" in capsys.readouterr().err


def test_a_file_elsewhere_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--out", "memory://a/b.html"]) == 1
    assert "--out memory://a/b.html is not allowed; it must be a file of this machine." in capsys.readouterr().err
    assert main(["record", "--out", "memory://a/b.gif"]) == 1
    assert "--out memory://a/b.gif is not allowed; it must be a file of this machine." in capsys.readouterr().err


def test_a_training_goes_on_elsewhere_and_its_agent_flies(
    there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In two parts and elsewhere: the agent is that of a training at a stretch and here."""
    words = ["train", *LEARN, "--eval-every", "128", "--eval-episodes", "2", "--steps", "256", *SHORT]
    assert main([*words, "--out", str(tmp_path / "here")]) == 0
    real = places.keep
    seen: list[set[str]] = []

    def lost(folder: Path, every_s: float = 0.0) -> None:
        """The process is gone after its second checkpoint."""
        real(folder, every_s)
        seen.append(names(there))
        if len(seen) == 2:
            raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(places, "keep", lost)
        assert main([*words, "--out", there]) == 1
    assert {"run.json", "model.zip", "checkpoint-000002/last.zip"} <= seen[-1]
    assert not any(name.startswith("checkpoint-000001") for name in seen[-1])
    assert main([*words, "--out", there]) == 1
    assert f"{there} holds a run already" in capsys.readouterr().err
    assert main(["train", "--resume", "--out", there]) == 0
    assert f": {there}/model.zip" in capsys.readouterr().out
    scores = {}
    for name, policy in (("here", str(tmp_path / "here")), ("there", there), ("file", f"{there}/model.zip")):
        flight = ["evaluate", policy, "--scenario", "Random", *SHORT, "--seeds", "2", "--out", str(tmp_path / name)]
        assert main(flight) == 0
        scores[name] = json.loads((tmp_path / name / "results.json").read_text())["results"][0]["measures"]
    assert scores["here"] == scores["there"] == scores["file"]


@pytest.mark.parametrize("there", ["memory"], indirect=True)
def test_a_protocol_elsewhere_gives_the_same(there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wish = Wish(algorithm="ppo", frame_stack=1, envs=4, set=("n_steps=16", "batch_size=32"), eval_episodes=2)
    monkeypatch.setitem(protocol.GROUPS, "ppo", protocol.Group(wish, 10, "ppo in a test"))
    words = ["protocol", "--groups", "ppo", "--training-seeds", "2", "--steps", "128", "--seeds", "4", "--jobs", "1"]
    words += ["--scenario", "Random", *SHORT, "--rivals", "pd"]
    assert main([*words, "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 0
    assert main([*words, "--runs", f"{there}/runs.v1/", "--out", f"{there}/out/", "--ship", f"{there}/ship"]) == 0
    here = json.loads((tmp_path / "out/results.json").read_text())["results"]
    assert json.loads(read(f"{there}/out/results.json"))["results"] == here
    assert {"out/BENCHMARK.md", "out/scores.npz", "ship/ppo/model.zip", "runs.v1/ppo-1/train.log"} <= names(there)
    # What is finished stays.
    before = read(f"{there}/runs.v1/ppo-0/results.json")
    assert main([*words, "--runs", f"{there}/runs.v1", "--out", f"{there}/again"]) == 0
    assert read(f"{there}/runs.v1/ppo-0/results.json") == before


@pytest.mark.parametrize("there", ["memory"], indirect=True)
def test_searches_and_benchmarks_elsewhere_give_the_same(there: str, tmp_path: Path) -> None:
    flights = ["benchmark", "--policy", "pd", "--scenario", "Random", *SHORT, "--seeds", "2", "--jobs", "1"]
    gains = ["tune", "pd", "--trials", "8", "--batch", "4", "--episodes", "2", "--eval-episodes", "2", *SHORT]
    learner = ["tune", "ppo", "--trials", "2", "--steps", "256", "--eval-episodes", "2", "--jobs", "1", *SHORT]
    for name, words in (("flights", flights), ("gains", [*gains, "--jobs", "1"]), ("learner", learner)):
        assert main([*words, "--out", str(tmp_path / name)]) == 0
        assert main([*words, "--out", f"{there}/{name}"]) == 0
    for name in ("flights/episodes.csv", "gains/trials.csv", "learner/trials.csv", "learner/settings.yaml"):
        mine, other = (tmp_path / name).read_text(), read(f"{there}/{name}").decode()
        # The head of settings names the command.
        assert mine.splitlines()[1:] == other.splitlines()[1:]
    assert "study.db" in names(f"{there}/gains")
    more = [*learner[:2], "--trials", "3", *learner[4:], "--resume", "--out", f"{there}/learner"]
    assert main(more) == 0
    assert {"trial-0000/model.zip", "trial-0002/model.zip"} <= names(f"{there}/learner")


@pytest.mark.parametrize("there", ["memory"], indirect=True)
def test_what_is_corrected_and_begun_at_may_be_elsewhere(
    there: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tune = [
        "tune",
        "pd",
        "--trials",
        "4",
        "--batch",
        "4",
        "--episodes",
        "2",
        "--eval-episodes",
        "2",
        "--jobs",
        "1",
        *SHORT,
    ]
    assert main([*tune, "--out", f"{there}/gains"]) == 0
    for begin in (f"{there}/gains", f"{there}/gains/gains.json"):
        assert main([*tune, "--begin", begin, "--out", str(tmp_path / begin[-4:])]) == 0
    learn = ["train", *LEARN, "--eval-every", "128", "--eval-episodes", "2", "--steps", "128", *SHORT]
    gains = json.loads(read(f"{there}/gains/gains.json"))
    for i, residual in enumerate((f"{there}/gains", f"{there}/gains/gains.json")):
        assert main([*learn, "--residual", residual, "--out", str(tmp_path / f"own-{i}")]) == 0
        assert json.loads((tmp_path / f"own-{i}/run.json").read_text())["settings"]["residual"] == gains
    assert main([*learn, "--out", f"{there}/agent"]) == 0
    assert main([*learn, "--residual", f"{there}/agent", "--out", str(tmp_path / "agent")]) == 0
    assert main(["train", "--resume", "--out", str(tmp_path / "agent")]) == 0
    capsys.readouterr()
    assert main(["evaluate", f"{there}/gains/nothing.json", "--scenario", "Random"]) == 1
    assert f"{there}/gains/nothing.json' can't be read" in capsys.readouterr().err
