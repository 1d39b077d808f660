"""Networks as small as those of the tests gain nothing from more threads than one."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
