"""``meta/selection.json``: the source episodes of a partial dataset, so that `adamanip merge` can restore it.

A part of a part refers to the first dataset. The file may be untrusted, so every field is checked.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import integer, listing, read, table, text

FORMAT = 1
_MOST = 10_000_000
_COMMANDS = ("filter", "split")
_LONGEST, _MOST_COMMANDS = 4000, 100


def _command(name: str, value: object) -> str:
    """Checks a command that selected episodes; a card shows it to be typed."""
    command: str = text(rf"[^\x00-\x1f\x7f`]{{1,{_LONGEST}}}", "a command")(name, value)
    words = shlex.split(command)
    if words[:1] != ["adamanip"] or words[1:2] not in ([each] for each in _COMMANDS) or shlex.join(words) != command:
        raise ValueError(f"{name} is {command[:80]!r}, not a command of adamanip {' or '.join(_COMMANDS)}")
    return command


_SELECTION = table(
    {
        "format": integer(FORMAT, FORMAT),
        "source": text(r"[0-9a-f]{32}", "a hash"),
        "source_episodes": integer(1, _MOST),
        "episodes": listing(integer(0, _MOST), 1, _MOST),
        "made_with": listing(_command, 0, _MOST_COMMANDS),
    }
)


@dataclass(frozen=True)
class Selection:
    """Episodes of a dataset."""

    source: str
    """Hash of the dataset's metadata, see `identity`."""
    source_episodes: int
    """Number of its episodes."""
    episodes: tuple[int, ...]
    """Episode indices in that dataset, in the order of the part."""
    made_with: tuple[str, ...] = ()
    """Commands that selected the episodes, as far as they are known, in order; DATASET stands for the result of the
    previous one."""

    @property
    def is_whole(self) -> bool:
        """Whether these are all episodes of the dataset, once each and in order."""
        return self.episodes == tuple(range(self.source_episodes))

    def of(self, chosen: Sequence[int], command: Sequence[str]) -> Selection:
        """Returns the selection of some of these episodes, given their positions in `episodes`.

        ``command`` are the words of the command that selected them, without a path. One that a card could not show,
        and the earliest of very many, are left out.
        """
        episodes = tuple(self.episodes[place] for place in chosen)
        commands = self.made_with
        with contextlib.suppress(ValueError):
            commands = (*commands, _command("the command", shlex.join(command)))[-_MOST_COMMANDS:]
        return Selection(self.source, self.source_episodes, episodes, commands)


def selection_path(root: Path) -> Path:
    """Returns the path of a part's selection."""
    return root / "meta" / "selection.json"


def read_selection(root: Path, episodes: int) -> Selection:
    """Returns the selection of a part; for other datasets, all their ``episodes``.

    Raises:
        DatasetError: the file cannot be read, or lists another number of episodes.
    """
    path = selection_path(root)
    if not path.exists():
        return Selection(identity(root), episodes, tuple(range(episodes)))
    try:
        content = _SELECTION("the selection", read(path, max_bytes=100_000_000))
        content.pop("format")
        selection = Selection(**content)
        if len(selection.episodes) != episodes or max(selection.episodes) >= selection.source_episodes:
            raise ValueError(f"it lists {len(selection.episodes)} episodes of {selection.source_episodes}")
    except (OSError, ValueError) as error:
        raise DatasetError(
            "Cannot read which episodes this part of a dataset holds.",
            got=f"{path}: {error}",
            allowed=f"{episodes} indices, as `adamanip filter` and `adamanip split` write them",
            hint=f"rename {path.name}: the dataset is then independent of others",
        ) from error
    return selection


def write_selection(root: Path, selection: Selection) -> None:
    """Writes the selection of a part; writes nothing for a whole dataset."""
    if not selection.is_whole:
        content = json.dumps({"format": FORMAT, **vars(selection)}, sort_keys=True)
        files.write_atomically(selection_path(root), f"{content}\n".encode())


def identity(root: Path) -> str:
    """Returns a hash of a dataset's metadata, which include statistics of every episode."""
    digest = hashlib.sha256()
    for path in (root / "meta" / "info.json", *sorted((root / "meta" / "episodes").glob("*/*.parquet"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]
