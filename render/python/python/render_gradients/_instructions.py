"""The native module with the most instructions that this processor has.

A wheel for x86-64 may hold the module twice: `_native` runs on every machine, `_x86_64_v3/_native` where there are AVX2 and
FMA. Results differ in the last bits between the two. `RENDER_GRADIENTS_INSTRUCTIONS=generic` takes the first everywhere.
"""

from __future__ import annotations

import importlib
import os
import sys
from types import ModuleType

PACKAGE = __package__
CHOICES = ("", "best", "generic")


def _chosen() -> ModuleType:
    asked = os.environ.get("RENDER_GRADIENTS_INSTRUCTIONS", "")
    if asked not in CHOICES:
        raise ImportError(f"RENDER_GRADIENTS_INSTRUCTIONS: expected best or generic, found {asked!r}")
    generic = importlib.import_module(f"{PACKAGE}._native")
    if asked == "generic" or not generic.has_x86_64_v3():
        return generic
    try:
        return importlib.import_module(f"{PACKAGE}._x86_64_v3._native")
    except ModuleNotFoundError:
        return generic


native = _chosen()
# All others import it by this name.
sys.modules[f"{PACKAGE}._native"] = native
