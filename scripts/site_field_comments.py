"""Griffe extension of the API reference: the comment above a configuration's field is its documentation.

LeRobot's options are documented that way, and `lerobot-train --help` prints them.
"""

from __future__ import annotations

from typing import Any

from griffe import Attribute, Class, Docstring, Extension


class FieldComments(Extension):
    """Takes the comment lines right above a class attribute for its docstring, if it has none."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Called by Griffe for each attribute it has read."""
        if attr.docstring is not None or not isinstance(attr.parent, Class) or attr.lineno is None:
            return
        lines = attr.lines_collection[attr.filepath]
        first = attr.lineno - 1
        while lines[first - 1].lstrip().startswith("# "):
            first -= 1
        text = " ".join(line.strip().removeprefix("# ") for line in lines[first : attr.lineno - 1])
        if text:
            attr.docstring = Docstring(text, lineno=first + 1, parent=attr)
