"""Modules of users, which commands import by name."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


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


def named_object(name: str) -> Any:
    """What "module:name" names, of which the name may have dots.

    Raises:
        Exception: Whatever the import raises, or there is nothing of that name.
    """
    module, _, attributes = name.partition(":")
    found: Any = import_here(module)
    for each in attributes.split("."):
        found = getattr(found, each)
    return found
