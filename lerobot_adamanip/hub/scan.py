"""Search for folders, users, hosts and addresses in files that are about to be published."""

from __future__ import annotations

import functools
import getpass
import re
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.cards.templates import template_texts
from lerobot_adamanip.evaluation.results import MACHINE_PATH
from lerobot_adamanip.hub.private_addresses import find_addresses
from lerobot_adamanip.util.errors import DatasetError

_TEXT = (".json", ".jsonl", ".md", ".py", ".txt", ".yaml", ".yml", ".toml", ".csv")
_SHORTEST, _SHORTEST_IN_BYTES = 4, 7
"""Letters of a name below which it is found by chance, in text and in compressed bytes."""
_MANY = {
    "admin", "administrator", "centos", "container", "debian", "docker", "fedora", "github", "jovyan", "localhost",
    "nobody", "root", "runner", "ubuntu", "user", "vagrant",
}  # fmt: skip
"""Names that thousands of machines share, and that tell of none."""
_TEXT_RUN = re.compile(rb"[\x20-\x7e]{24,}")
"""Text among other bytes: so many letters in a row are no chance."""
_POSIX_PATH = re.compile(rb"(?<![\w.])/(?:home|root|Users|scratch)/[\w.-]+/")


@dataclass(frozen=True)
class Finding:
    """A name or path of a machine or person.

    Attributes:
        file: relative path.
        kind: ``path``, ``user``, ``host``, ``address`` or ``e-mail``.
        text: what was found.
    """

    file: str
    kind: str
    text: str


@dataclass(frozen=True)
class Names:
    """Names of this machine.

    Attributes:
        user: names of its user.
        host: names of the machine.
        folders: absolute paths: the user's home and where things are published from.
    """

    user: tuple[str, ...]
    host: tuple[str, ...]
    folders: tuple[str, ...]

    @classmethod
    def here(cls, *folders: Path) -> Names:
        """Returns those of this process; ``folders`` are further ones that shall not be named."""
        home, host = Path.home(), socket.gethostname()
        try:
            user = getpass.getuser()
        except (OSError, KeyError):  # a user id without a name, as in containers
            user = ""
        known = [path for path in (home, Path.cwd(), *folders) if len(path.parts) > 2]
        return cls(
            user=tuple(dict.fromkeys((user, home.name))),
            host=tuple(dict.fromkeys((host, host.partition(".")[0]))),
            folders=tuple(dict.fromkeys(str(path.absolute()) for path in known)),
        )


def scan(files: Mapping[str, Path], names: Names, *, owner: str = "") -> list[Finding]:
    """Returns findings in text, in Parquet metadata and columns of text, and in headers of other files.

    Args:
        files: path in the repository -> file.
        names: of this machine. Names that are words of our own cards, or shared by thousands, are no findings.
        owner: of the repository, under whose name all is published anyway.
    """
    found: list[Finding] = []
    for name, path in files.items():
        suffix = Path(name).suffix.lower()
        if suffix == ".parquet":
            texts: Iterator[str] = _parquet_texts(name, path)
        elif suffix in _TEXT:
            texts = iter([path.read_text(encoding="utf-8", errors="replace")])
        else:
            found += _in_bytes(name, path.read_bytes(), names, owner)
            continue
        found += [finding for text in (name, *texts) for finding in _in_text(name, text, names, owner)]
    return list(dict.fromkeys(found))


def require_clean(files: Mapping[str, Path], names: Names, *, owner: str = "") -> None:
    """Raises `DatasetError` that names each file in which `scan` finds something."""
    if found := scan(files, names, owner=owner):
        told = "; ".join(f"{each.file}: {each.kind} {each.text!r}" for each in found[:5])
        more = f"; and {len(found) - 5} more" if len(found) > 5 else ""
        raise DatasetError(
            "This would publish what belongs to a machine.",
            got=told + more,
            allowed="no folder, user, host, network address or e-mail address in any file",
            hint="edit the file, or make it again with relative paths; then the same command again",
        )


def _in_text(file: str, text: str, names: Names, owner: str) -> Iterator[Finding]:
    for path in re.finditer(rf"(?:{MACHINE_PATH})[^\s\"'`,;)\]]*", text):
        yield Finding(file, "path", path.group()[:120])
    for folder in names.folders:
        if folder in text:
            yield Finding(file, "path", folder)
    for kind, mine in _telling(names, owner):
        if found := re.search(rf"(?<![A-Za-z0-9_]){re.escape(mine)}(?![A-Za-z0-9_])", text):
            yield Finding(file, kind, found.group())

    for kind, address in find_addresses(text):
        yield Finding(file, kind, address[:120])


def _in_bytes(file: str, content: bytes, names: Names, owner: str) -> Iterator[Finding]:
    for run in _TEXT_RUN.finditer(content):
        for kind, address in find_addresses(run.group().decode("ascii")):
            yield Finding(file, kind, address[:120])
    for path in _POSIX_PATH.finditer(content):
        yield Finding(file, "path", path.group().decode(errors="replace"))
    for folder in names.folders:
        if folder.encode() in content:
            yield Finding(file, "path", folder)
    for kind, mine in _telling(names, owner):
        if len(mine) >= _SHORTEST_IN_BYTES and re.search(rb"(?<!\w)" + re.escape(mine.encode()) + rb"(?!\w)", content):
            yield Finding(file, kind, mine)


def _telling(names: Names, owner: str) -> Iterator[tuple[str, str]]:
    for kind, known in (("user", names.user), ("host", names.host)):
        for name in known:
            said_anyway = name.lower() in _MANY or name == owner or name.lower() in _our_words()
            if len(name) >= _SHORTEST and not said_anyway:
                yield kind, name


@functools.cache
def _our_words() -> frozenset[str]:
    """Words that every card has, so a user of such a name is not named by them."""
    return frozenset(word.lower() for text in template_texts() for word in re.findall(r"[A-Za-z0-9]+", text))


def _parquet_texts(name: str, path: Path) -> Iterator[str]:
    try:
        file = pq.ParquetFile(path)
        yield str(file.metadata.created_by)
        for key, value in (file.schema_arrow.metadata or {}).items():
            yield key.decode(errors="replace") + "\n" + value.decode(errors="replace")
        for field in file.schema_arrow:
            yield field.name
            if _holds_text(field.type):
                values = file.read(columns=[field.name]).column(field.name)
                yield "\n".join(map(str, values.unique().to_pylist() if _plain(field.type) else values.to_pylist()))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DatasetError(
            "A file cannot be read, so it is not published.",
            got=f"{name}: {error}",
            allowed="Parquet",
            hint="repair it",
        ) from error


def _plain(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _holds_text(kind: pa.DataType) -> bool:
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind) or pa.types.is_dictionary(kind):
        return True
    inner = [kind.field(number).type for number in range(kind.num_fields)] if kind.num_fields else []
    return _plain(kind) or any(map(_holds_text, inner))
