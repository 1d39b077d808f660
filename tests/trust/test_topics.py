"""The command that measures what is held on trust, and those of its topics that no other test goes through."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

for module in ("yaml", "stable_baselines3", "optuna", "pygame", "plotly", "matplotlib", "imageio_ffmpeg"):
    pytest.importorskip(module)

from tests.trust import __main__ as trust  # noqa: E402
from tests.trust import files as damage  # noqa: E402
from tests.trust import memory  # noqa: E402
from tests.trust.figures import Wrong, none_of, share  # noqa: E402


@pytest.fixture
def topics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three topics: one in which all is well, one that finds something, and one that breaks."""

    def broken(long: bool) -> list[tuple[str, str]]:
        raise RuntimeError("it broke")

    measures = {
        "well": lambda long: [("kept", share(3, 3)), ("lost", none_of([])), ("form", "long" if long else "short")],
        "ill": lambda long: [("kept", share(2, 3)), ("lost", none_of(["a | b"]))],
        "broken": broken,
    }
    monkeypatch.setattr(trust, "TOPICS", dict.fromkeys(measures, "words"))
    for name, measure in measures.items():
        module = ModuleType(name)
        module.measure = measure  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, f"tests.trust.{name}", module)


@pytest.mark.usefixtures("topics")
def test_what_is_wrong_stands_in_the_table_and_in_the_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new/trust.md"
    assert trust.main(["well", "--long", "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert "python -m tests.trust well --long" in text
    assert "numba " in text
    assert [line.split()[-2] for line in text.splitlines() if line.startswith("| well")] == ["3", "0", "long"]
    assert trust.main([]) == 1
    said = capsys.readouterr()
    assert "**2 of 3**" in said.out
    assert "**RuntimeError: it broke**" in said.out
    assert "ill: 2 wrong" in said.err
    with pytest.raises(SystemExit):
        trust.main(["nothing"])


def test_every_topic_measures() -> None:
    for name in trust.TOPICS:
        assert callable(__import__(f"tests.trust.{name}", fromlist=["measure"]).measure)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_memory_does_not_grow() -> None:
    figures = memory.measure(False)
    assert not [each for each in figures if isinstance(each[1], Wrong)], figures


def test_damaged_files_give_one_clear_line_or_do_no_harm() -> None:
    for name, (tally, faults) in damage.tried(damage.EXAMPLES).items():
        assert faults == [], name
        assert tally["a clear line"] > 0, name
