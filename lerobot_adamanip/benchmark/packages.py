"""Methods that installed packages add to a declaration."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points

from lerobot_adamanip.benchmark.declaration import Declaration, Method, check_method
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.json_fields import record

METHODS_GROUP = "lerobot_adamanip.benchmark_methods"
"""Entry point group for methods of other packages; each one loads the content of a table ``[methods.NAME]``."""


def with_packages(declaration: Declaration) -> Declaration:
    """Returns a declaration with the methods of installed packages added; raises `ConfigurationError`."""
    points = sorted(entry_points(group=METHODS_GROUP))
    declared = {point.name: _declared_by(point, declaration) for point in points}
    return replace(declaration, methods={**declaration.methods, **declared})


def _declared_by(point: EntryPoint, declaration: Declaration) -> Method:
    package = point.dist.name if point.dist is not None else point.module
    try:
        if point.name in declaration.methods:
            raise ValueError("the declaration has a method of that name")
        method = record(Method)(point.name, point.load())
        check_method(declaration, point.name, method)
    except Exception as error:  # importing another package may raise any exception
        raise ConfigurationError(
            f"The benchmark method {point.name!r} cannot be used.",
            got=f"{point.value} of {package}: {error}",
            allowed="a table like [methods.NAME], see docs/extending_policy.md",
            hint=f"repair {package}, or uninstall it",
        ) from error
    return replace(method, package=package)
