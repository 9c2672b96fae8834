"""Parsing of untrusted XML and numbers; errors name the file."""

from __future__ import annotations

import functools
import logging
import math
import shlex
from pathlib import Path
from typing import Any

from lerobot_adamanip.util.errors import ConfigurationError

HUGE = 1e4
"""Larger than any number in the description of a household object."""
warn_once_about_asset = functools.cache(logging.getLogger(__name__).warning)
"""Logs a warning once, although objects are loaded repeatedly."""


def broken(
    path: Path, what: str, got: object, allowed: object, *, hint: str = "the file as it was published"
) -> Exception:
    """Returns the error for an unusable file."""
    return ConfigurationError(f"{path}: {what}", got=got, allowed=allowed, hint=hint)


def annotate_hint(path: Path, category: str) -> str:
    """Returns the command that annotates the object whose URDF or annotation is at ``path``."""
    return f"adamanip annotate {shlex.quote(str(path.parent))} --category {category}"


def parse_xml(path: Path, text: bytes) -> Any:
    """Returns the root element of XML without a document type; raises `ConfigurationError` for anything else."""
    import defusedxml
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        return fromstring(text, forbid_dtd=True)
    except defusedxml.DefusedXmlException as error:
        what = "has a document type or entities, which are not read."
        raise broken(path, what, type(error).__name__, "plain XML", hint="a file without <!DOCTYPE ...>") from error
    except (ParseError, ValueError, LookupError, RecursionError) as error:
        raise broken(path, "not XML.", error, "well-formed XML") from error


def numbers(path: Path, text: str, count: int, what: str) -> tuple[float, ...]:
    """Parses ``count`` finite numbers; raises `ConfigurationError` otherwise."""
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(math.isfinite(v) and abs(v) < HUGE for v in values):
        allowed = f"{count} number(s) below {HUGE:g}"
        raise broken(path, f"{what} is not {count} finite number(s).", repr(text[:80]), allowed)
    return values
