"""The wheel holds what the tree holds."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = {"uwoc_gym": "uwoc_gym", "baselines": "uwoc_gym/baselines", "agents": "uwoc_gym/agents"}
"""Where the files of each folder are installed."""

COMMAND = "uwoc_gym_command.py"
"""What the command begins with stands beside the packages, in the tree as in the wheel."""

SUFFIXES = {".py", ".yaml", ".html", ".zip", ".json", ".npz", ".pkl", ".typed"}


def test_the_wheel_holds_the_tree_file_by_file(tmp_path: Path) -> None:
    # Built from a copy: a build folder left in the tree would bring files that are gone.
    for name in (*PACKAGES, COMMAND, "pyproject.toml", "README.md", "LICENSE"):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copyfile
        copy(ROOT / name, tmp_path / name)
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), "."]
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = (tmp_path / "dist").iterdir()
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    stands = {
        f"{PACKAGES[path.relative_to(ROOT).parts[0]]}/{'/'.join(path.relative_to(ROOT).parts[1:])}"
        for folder in PACKAGES
        for path in (ROOT / folder).rglob("*")
        if path.suffix in SUFFIXES or path.name == "CARD.md"
    }
    assert len(stands) > 60
    assert held == stands | {COMMAND}
