"""The examples of the documents run and print what the documents say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def test_the_planner_prints_what_its_page_says():
    text = (DOCS / "planning.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    printed = subprocess.check_output([sys.executable, "-c", code], text=True, timeout=300).strip()
    assert printed in re.findall(r"It prints `(.*?)`", text)
