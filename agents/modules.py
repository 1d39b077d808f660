"""Modules of users, which commands import by name."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType


def import_here(name: str) -> ModuleType:
    """Import a module, which may stand in the working folder.

    Raises:
        Exception: Whatever the import raises.
    """
    # Console scripts, unlike `python -m`, don't look there.
    sys.path.insert(0, "")
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove("")
