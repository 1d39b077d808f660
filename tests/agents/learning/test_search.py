"""Searches: what they find, and that they can be stopped and resumed."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import search
from uwoc_gym.agents.learning.search import Dimension

BOX = {"a": Dimension(-2.0, 2.0), "b": Dimension(0.01, 10.0, log=True)}


def bowl(points):
    return [((p["a"] - 0.5) ** 2 + np.log(p["b"]) ** 2, {"sum": p["a"] + p["b"]}) for p in points]


def run(folder, trials=48, evaluate=bowl, **changes):
    options = {"batch": 8, "seed": 3, "direction": "minimize", "sampler": "cma-es"} | changes
    return search.search(folder, {"target": "bowl"}, BOX, evaluate, trials=trials, **options)


def tried(folder):
    return list(csv.DictReader((folder / "trials.csv").read_text(encoding="utf-8").splitlines()))


@pytest.mark.parametrize("sampler", ["cma-es", "tpe"])
def test_search_finds_the_bottom_and_writes_what_it_tried(tmp_path, sampler):
    found = run(tmp_path, 96, sampler=sampler)
    assert found.finished
    assert found.best.score < 0.05
    rows = tried(tmp_path)
    assert len(rows) == found.trials == 96
    assert min(float(row["score"]) for row in rows) == found.best.score
    assert found.best.outcome["sum"] == found.best.values["a"] + found.best.values["b"]


def test_same_seed_tries_the_same(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        run(tmp_path / name, 24)
    assert (tmp_path / "one/trials.csv").read_text() == (tmp_path / "two/trials.csv").read_text()


def test_points_to_begin_with_are_tried_first(tmp_path):
    run(tmp_path, 8, begin=[{"a": 0.5, "b": 1.0}])
    first = tried(tmp_path)[0]
    assert (float(first["a"]), float(first["b"]), float(first["score"])) == (0.5, 1.0, 0.0)


def test_interrupted_search_keeps_its_batches_and_goes_on(tmp_path):
    batches = []

    def stop(points):
        batches.append(points)
        if len(batches) == 3:
            raise KeyboardInterrupt
        return bowl(points)

    found = run(tmp_path, evaluate=stop)
    assert not found.finished
    assert found.trials == 16
    before = (tmp_path / "trials.csv").read_text().splitlines()
    assert len(before) == 17
    again = run(tmp_path, resume=True)
    assert again.finished
    assert again.trials == 48
    assert (tmp_path / "trials.csv").read_text().splitlines()[:17] == before
    assert again.best.score <= found.best.score


def test_refuses_folders_that_do_not_fit(tmp_path):
    with pytest.raises(CommandError, match=r"--resume: there is no .*study\.db"):
        run(tmp_path, resume=True)
    run(tmp_path, 8)
    with pytest.raises(CommandError, match="holds a search already"):
        run(tmp_path)
    with pytest.raises(CommandError, match="holds a search with another target"):
        search.search(
            tmp_path, {"target": "dome"}, BOX, bowl,
            trials=16, batch=8, seed=3, direction="minimize", sampler="cma-es", resume=True,
        )  # fmt: skip
    (tmp_path / "study.db").write_bytes(b"not a database")
    with pytest.raises(CommandError, match="can't be used"):
        run(tmp_path, resume=True)


def test_interrupted_before_the_first_batch(tmp_path):
    def stop(points):
        raise KeyboardInterrupt

    with pytest.raises(CommandError, match="nothing was found"):
        run(tmp_path, evaluate=stop)
