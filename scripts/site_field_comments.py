"""Griffe extension for the API reference: uses the comment above a configuration field as its documentation.

LeRobot's options are documented this way, and `lerobot-train --help` prints these comments.
"""

from __future__ import annotations

from typing import Any

from griffe import Attribute, Class, Docstring, Extension


class FieldComments(Extension):
    """Uses the comment lines directly above a class attribute as its docstring, if it has none."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Sets a missing docstring. Griffe calls it for each attribute."""
        if attr.docstring is not None or not isinstance(attr.parent, Class) or attr.lineno is None:
            return
        lines = attr.lines_collection[attr.filepath]
        first = attr.lineno - 1
        while lines[first - 1].lstrip().startswith("# "):
            first -= 1
        text = " ".join(line.strip().removeprefix("# ") for line in lines[first : attr.lineno - 1])
        if text:
            attr.docstring = Docstring(text, lineno=first + 1, parent=attr)
