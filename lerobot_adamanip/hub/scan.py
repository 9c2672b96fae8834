"""Searches files for folders, users, hosts, addresses and secrets before publishing."""

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

from lerobot_adamanip.datasets.cards import template_texts
from lerobot_adamanip.hub.private_data import find_addresses, find_secrets
from lerobot_adamanip.util.errors import DatasetError, listed
from lerobot_adamanip.util.machine_paths import MACHINE_PATH

_TEXT = (".json", ".jsonl", ".md", ".py", ".txt", ".yaml", ".yml", ".toml", ".csv")
_SHORTEST, _SHORTEST_IN_BYTES = 4, 7
"""Minimum length of a searched name, in text and in binary files. Shorter names occur by chance."""
_MANY = {
    "admin", "administrator", "centos", "container", "debian", "docker", "fedora", "github", "jovyan", "localhost",
    "nobody", "root", "runner", "ubuntu", "user", "vagrant",
}  # fmt: skip
"""Common names that do not identify a machine."""
_TEXT_RUN = re.compile(r"[\x20-\x7e]{24,}")
"""Pattern for text in binary files: this many letters in a row are not chance."""
_TEXT_PATH = re.compile(rf"(?:{MACHINE_PATH})[^\s\"'`,;)\]]*")
_BINARY_PATH = re.compile(r"(?<![\w.])/(?:home|root|Users|scratch)/[\w.-]+/", re.ASCII)


@dataclass(frozen=True)
class PrivateText:
    """A secret, or a name or path of a machine or person.

    Attributes:
        file: relative path.
        kind: ``path``, ``user``, ``host``, ``address``, ``e-mail``, or the name of a kind of secret.
        text: matched text; of a secret only its beginning.
    """

    file: str
    kind: str
    text: str


@dataclass(frozen=True)
class Names:
    """Names of this machine.

    Attributes:
        user: names of the user.
        host: names of the machine.
        folders: absolute paths: the user's home and the source folders.
    """

    user: tuple[str, ...]
    host: tuple[str, ...]
    folders: tuple[str, ...]

    @classmethod
    def here(cls, *folders: Path) -> Names:
        """Returns the names of this machine and user. ``folders``: further private folders."""
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


def scan(files: Mapping[str, Path], names: Names, *, owner: str = "") -> list[PrivateText]:
    """Returns findings in file names, text files, Parquet metadata and text columns, and bytes of other files.

    Args:
        files: path in the repository -> file.
        names: names of this machine. Words in our own card templates and common names are not findings.
        owner: owner of the repository, whose name is public anyway.
    """
    items: list[PrivateText] = []
    for name, path in files.items():
        suffix = path.suffix.lower()
        binary = suffix not in (".parquet", *_TEXT)
        if binary:
            texts = iter([path.read_bytes().decode("latin-1")])
        elif suffix == ".parquet":
            texts = _parquet_texts(name, path)
        else:
            texts = iter([path.read_text(encoding="utf-8", errors="replace")])
        items += _search(name, name, names, owner, binary=False)
        items += (item for text in texts for item in _search(name, text, names, owner, binary=binary))
    return list(dict.fromkeys(items))


def require_clean(files: Mapping[str, Path], names: Names, *, owner: str = "") -> None:
    """Raises `DatasetError` with the first files in which `scan` finds something."""
    if items := scan(files, names, owner=owner):
        raise DatasetError(
            "Files contain secrets, or names or addresses of a machine or a person.",
            got=listed([f"{each.file}: {each.kind} {each.text!r}" for each in items]),
            allowed="no token, key, password, folder, user, host, network address or e-mail address in any file",
            hint="edit the file, or create it again with relative paths; then run the same command again",
        )


def _search(file: str, text: str, names: Names, owner: str, *, binary: bool) -> Iterator[PrivateText]:
    """Yields the findings in a text, or in bytes decoded as Latin-1."""
    if binary:
        for path in _BINARY_PATH.finditer(text):
            yield PrivateText(file, "path", path.group()[:120])
    for folder in names.folders:
        if (folder.encode().decode("latin-1") if binary else folder) in text:
            yield PrivateText(file, "path", folder)
    for kind, name in _telling_names(names, owner, _SHORTEST_IN_BYTES if binary else _SHORTEST):
        word = name.encode().decode("latin-1") if binary else name
        if re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text, re.ASCII):
            yield PrivateText(file, kind, name)
    for part in _TEXT_RUN.findall(text) if binary else [text]:
        for path in _TEXT_PATH.finditer(part):
            yield PrivateText(file, "path", path.group()[:120])
        for kind, match in (*find_addresses(part), *find_secrets(part)):
            yield PrivateText(file, kind, match[:120])


def _telling_names(names: Names, owner: str, shortest: int) -> Iterator[tuple[str, str]]:
    for kind, known in (("user", names.user), ("host", names.host)):
        for name in known:
            harmless = name.lower() in _MANY or name == owner or name.lower() in _our_words()
            if len(name) >= shortest and not harmless:
                yield kind, name


@functools.cache
def _our_words() -> frozenset[str]:
    """Returns the words of our card templates. In a card, they do not count as user names."""
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
                yield "\n".join(map(str, values.unique().to_pylist() if _is_text(field.type) else values.to_pylist()))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DatasetError(
            "A file cannot be read.", got=f"{name}: {error}", allowed="Parquet", hint="adamanip check DIR --repair"
        ) from error


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _holds_text(kind: pa.DataType) -> bool:
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind) or pa.types.is_dictionary(kind):
        return True
    return _is_text(kind) or any(_holds_text(kind.field(number).type) for number in range(kind.num_fields))
