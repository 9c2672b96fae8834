"""Writes the site's pages of commands and environments into a folder: ``python scripts/make_reference.py FOLDER``.

They come from the source of the options. scripts/site_hooks.py runs this while the site is built.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.cli.main import COMMANDS, load
from lerobot_adamanip.contract.categories import CATEGORIES

GROUPS = {
    "collect": ("Collect demonstrations", ("collect", "replay", "render", "keyframes", "memory")),
    "datasets": ("Work with datasets", ("check", "stats", "view", "merge", "filter", "split", "push")),
    "evaluate": ("Evaluate and compare", ("report", "benchmark", "expert")),
    "setup": ("Objects, cameras, installation", ("doctor", "objects", "annotate", "calibrate")),
}
IN_PYTHON = {
    "episode_length": "`max_key_frames`", "workspace_lower": "`workspace`", "workspace_upper": "`workspace`",
    **dict.fromkeys(("task", "max_parallel_tasks", "fps"), ""),
}  # fmt: skip
"""Option of LeRobot's commands -> option of `KeyframeEnv`, where the two differ."""


class Option(NamedTuple):
    """A field of an options class: name, annotation as in the source, and help text."""

    name: str
    kind: str
    text: str


def options(cls: type) -> Iterator[Option]:
    """Yields the documented fields of a dataclass and its bases, in order of definition."""
    for each in reversed(cls.__mro__):
        if each.__module__.split(".")[0] in ("lerobot_adamanip", "lerobot_env_adamanip"):
            yield from _own_options(each)


def _own_options(cls: type) -> Iterator[Option]:
    source = textwrap.dedent(inspect.getsource(cls))
    lines, body = source.splitlines(), ast.parse(source).body[0].body  # type: ignore[attr-defined]
    for node, following in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.AnnAssign) or "ClassVar" in ast.unparse(node.annotation):
            continue
        value = following.value if isinstance(following, ast.Expr) else None
        text = value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else ""
        if not text:
            first = node.lineno - 1
            while lines[first - 1].lstrip().startswith("# "):
                first -= 1
            text = " ".join(line.strip().removeprefix("# ") for line in lines[first : node.lineno - 1])
        if text and not text.startswith(("Set automatically", "Without effect")):
            yield Option(node.target.id, ast.unparse(node.annotation), " ".join(text.split()))  # type: ignore[union-attr]


def _table(rows: Sequence[tuple[str, ...]], head: Sequence[str] = ("option", "default", "meaning")) -> str:
    cells = [tuple(cell.replace("|", "\\|") for cell in row) for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in (head, *cells)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def _default(cls: type, option: Option) -> str:
    field = next(each for each in dataclasses.fields(cls) if each.name == option.name)
    if field.default is dataclasses.MISSING:
        return "required" if field.default_factory is dataclasses.MISSING else ""
    return "" if field.default in (None, (), "") else f"`{field.default}`"


def _section(name: str) -> str:
    rows, positional = [], []
    command = load(name)
    for option in options(command):
        if "Positional" in option.kind or "DatasetFolder" in option.kind:
            folders = {"DatasetFolder": "DIR", "DatasetFolders": "DIR [DIR ...]"}
            positional.append(folders.get(option.kind, option.name.upper()))
            rows.append((f"`{positional[-1]}`", _default(command, option), option.text))
        else:
            renamed = re.search(r"arg\(name='([\w-]+)'\)", option.kind)  # by tyro
            name_shown = renamed[1] if renamed else option.name.replace("_", "-")
            rows.append((f"`--{name_shown}`", _default(command, option), option.text))
    usage = " ".join(["adamanip", name, *positional, "[OPTIONS]"])
    summary = COMMANDS[name].help[0].upper() + COMMANDS[name].help[1:]
    return f"## {name}\n\n{summary}.\n\n```text\n{usage}\n```\n\n{_table(rows)}\n"


def _command_pages() -> Iterator[tuple[str, str]]:
    lines = [
        f"| [`{name}`]({page}.md#{name}) | {COMMANDS[name].help} |"
        for page, (_, names) in GROUPS.items()
        for name in names
    ]
    index = "\n".join(["| command | does |", "|---|---|", *lines])
    text = "Every command has `--help`. Those that report numbers have `--json`. A dataset's folder comes first."
    yield "command_line/index.md", f"# Command line\n\n{text}\n\n{index}\n"
    for page, (title, names) in GROUPS.items():
        yield f"command_line/{page}.md", "\n".join([f"# Command line: {title.lower()}\n", *map(_section, names)])


def _environments() -> str:
    classes = {name: EnvConfig.get_choice_class(f"adamanip_{name}") for name in CATEGORIES}
    suite = EnvConfig.get_choice_class("adamanip")
    shared = [each for each in options(suite) if each.name != "categories"]
    names = {each.name for each in shared}
    rows = [
        (f"`--env.{each.name}`", IN_PYTHON.get(each.name, f"`{each.name}`"), _default(suite, each), each.text)
        for each in shared
    ]
    own = [(name, each) for name, cls in classes.items() for each in options(cls) if each.name not in names]
    hidden = [f"| `{name}` | `--env.{each.name}` | {each.text} |" for name, each in own]
    types = [
        f"| `adamanip_{name}` | `{category.keyframe_id}` | {category.instruction} |"
        for name, category in CATEGORIES.items()
    ]
    page = [
        "# Environments\n",
        "Options of `lerobot-train` and `lerobot-eval` (`--env.NAME=VALUE`), and of Python, in "
        "`KeyframeEnv(\"safe\", NAME=VALUE)` and `gymnasium.make(\"AdaManipKeyframe-Safe-v0\", NAME=VALUE)`.\n",
        "## Which environments are there?\n",
        "| `--env.type` | `gymnasium.make` | task |", "|---|---|---|", *types,
        "| `adamanip` | | all nine in turn; `--env.categories=safe,door` chooses |",
        "\n## Options of every environment\n", _table(rows, ("option", "in Python", "default", "meaning")),
        "\n## How do I fix a hidden value?\n",
        "In Python: `hidden_overrides={\"locked\": True}`, as an option or in `reset(options=...)`.\n",
        "| category | option | meaning |", "|---|---|---|", *hidden, "",
    ]  # fmt: skip
    return "\n".join(page)


def pages() -> dict[str, str]:
    """Returns path on the site -> Markdown."""
    import lerobot_env_adamanip  # noqa: F401  (registers the configurations)

    return {**dict(_command_pages()), "environments.md": _environments()}


def main(folder: Path) -> None:
    """Writes the pages into ``folder``."""
    for path, text in pages().items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
