"""Import graph of Python packages, read from their source without importing them."""

from __future__ import annotations

import ast
import functools
import importlib.util
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

OUR_PACKAGES = ("lerobot_adamanip", "lerobot_env_adamanip", "lerobot_policy_adamanip")
_IMPORTERS = ("import_module", "importlib.import_module")


@dataclass(frozen=True)
class ImportGraph:
    """Modules of some packages, and the imports between them.

    Imports inside functions count; those under ``if TYPE_CHECKING`` do not. ``import_module(f"package.{name}")``
    counts as an import of every module with that prefix.

    Attributes:
        roots: dotted name of a package -> folder.
    """

    roots: Mapping[str, Path]

    @functools.cached_property
    def modules(self) -> Mapping[str, Path]:
        """Module -> file, sorted by name."""
        found = {}
        for package, folder in self.roots.items():
            for path in folder.rglob("*.py"):
                parts = path.relative_to(folder).with_suffix("").parts
                found[".".join((package, *(parts[:-1] if parts[-1] == "__init__" else parts)))] = path
        return dict(sorted(found.items()))

    def imports(self, module: str) -> set[str]:
        """Returns the modules of these packages that a module imports."""
        path = self.modules[module]
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        found: set[str] = set()
        for node in _running_nodes(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = package.rsplit(".", node.level - 1)[0] + "." if node.level else ""
                source = f"{base}{node.module or ''}".rstrip(".")
                # `from package import module` imports the module; `from module import name` imports its source.
                names = [f"{source}.{alias.name}" for alias in node.names]
                found |= {name if name in self.modules else source for name in names}
            elif isinstance(node, ast.Call) and ast.unparse(node.func) in _IMPORTERS and node.args:
                prefix = _constant_prefix(node.args[0])
                found |= {name for name in self.modules if prefix and name.startswith(prefix)}
        return {each for each in found if each in self.modules} - {module}

    def closure(self, entries: Iterable[str], leave_out: Iterable[str] = ()) -> frozenset[str]:
        """Returns all modules that run when ``entries`` are imported, including their packages.

        Args:
            entries: module names.
            leave_out: modules and packages that stop the search. The ``__init__`` of a root is always left out.

        Raises:
            KeyError: a module does not exist.
        """
        out, found, left = tuple(leave_out), set[str](), list(entries)
        while left:
            module = left.pop()
            if module in found or module in self.roots or is_within(module, out):
                continue
            found.add(module)
            left += self.imports(module)
            if (parent := module.rpartition(".")[0]) in self.modules:
                left.append(parent)
        return frozenset(found)


@functools.cache
def our_import_graph() -> ImportGraph:
    """Returns the graph of this project's installed packages."""
    found = {name: importlib.util.find_spec(name) for name in OUR_PACKAGES}
    folders = {name: spec.submodule_search_locations for name, spec in found.items() if spec is not None}
    return ImportGraph({name: Path(folder[0]) for name, folder in folders.items() if folder})


def is_within(module: str, packages: Iterable[str]) -> bool:
    """Returns whether a module is one of ``packages`` or inside one."""
    return any(module == each or module.startswith(f"{each}.") for each in packages)


def _running_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yields all nodes except those under `if TYPE_CHECKING`."""
    left = [tree]
    while left:
        node = left.pop()
        yield node
        guarded = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        left += node.orelse if guarded else ast.iter_child_nodes(node)  # type: ignore[attr-defined]


def _constant_prefix(argument: ast.expr) -> str:
    """Returns the constant text at the start of an expression; empty if it starts with a value."""
    first = argument.values[0] if isinstance(argument, ast.JoinedStr) and argument.values else argument
    return first.value if isinstance(first, ast.Constant) and isinstance(first.value, str) else ""
