"""Garbage collection at resets: ManiSkill asks for a full one before each scene."""

from __future__ import annotations

import functools
import gc


@functools.cache
def leave_out_what_is_loaded() -> None:
    """Takes all objects that exist now out of later collections, once a process.

    A process that has imported torch and LeRobot holds a million of them, none of which is garbage; looking at each
    took 0.25 s of every reset. What is made later, scenes above all, is collected as ever.
    """
    gc.collect()
    gc.freeze()
