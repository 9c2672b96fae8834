"""Stages the files of a repository: checks them, links them into a folder and adds a card. Sources stay unchanged."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from lerobot_adamanip.collection.trained_policy import PIPELINES, pipeline_steps
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.datasets.cards import check_card, dataset_card
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.opening import as_typed
from lerobot_adamanip.evaluation.results import ResultFile
from lerobot_adamanip.hub.environment import environment_files
from lerobot_adamanip.hub.model_card import CARD_FIELDS, Checkpoint, model_card
from lerobot_adamanip.hub.portable_config import shareable
from lerobot_adamanip.hub.scan import Names, require_clean
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import DatasetError, listed

_LARGE = (".parquet", ".mp4", ".safetensors")
"""Endings of files that are linked, not copied."""
_DATASET = ("meta/", "data/", "videos/")
_MODEL = ("model.", "model-", "policy_preprocessor", "policy_postprocessor")
"""Name prefixes of a checkpoint's weights, pipelines and pipeline states."""
_STATE_FILE = re.compile(r"[\w.-]+\.safetensors")


@dataclass(frozen=True)
class Staged:
    """Files to publish.

    Attributes:
        kind: repository type on the Hub: ``dataset`` or ``model`` (also for environments).
        repo_id: repository name on the Hub.
        folder: folder with the files or links to them.
        replaced: name prefixes in the repository. Other files under them are deleted there.
        version_tag: tag that must be at the newest commit, or None.
        hashes: path in the repository -> SHA-256 of the scanned file. Only these files are published.
    """

    kind: str
    repo_id: str
    folder: Path
    replaced: tuple[str, ...] = ()
    version_tag: str | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)

    def sealed(self) -> Staged:
        """Returns a copy with the current hashes of the files."""
        return replace(self, hashes={name: _sha256(path) for name, path in self.files().items()})

    def require_unchanged(self) -> None:
        """Raises `DatasetError` if a file or link target has changed since the scan."""
        now = self.sealed().hashes
        if changed := sorted(name for name in {**now, **self.hashes} if now.get(name) != self.hashes.get(name)):
            raise DatasetError(
                "Files changed after they were checked for publishing.",
                got=listed(changed),
                allowed="files that no process writes to",
                hint="run the same command again when nothing writes to them",
            )

    def files(self) -> dict[str, Path]:
        """Returns the files: path in the repository -> file."""
        paths = (path for path in sorted(self.folder.rglob("*")) if path.is_file())
        return {path.relative_to(self.folder).as_posix(): path for path in paths}


def stage_dataset(root: Path, repo_id: str, into: Path, *, assets: Path | None = None) -> Staged:
    """Checks all rows and video frames of a dataset and stages it with a card.

    Args:
        root: folder of the dataset.
        repo_id: repository name on the Hub.
        into: an empty folder.
        assets: folder of the external assets used for its collection, if any.

    Raises:
        DatasetError: the dataset is missing, unfinished or damaged, or contains names of a machine or person.
    """
    name, root = root.absolute().name, root.resolve()
    version = str(Dataset(root).info.get("codebase_version"))
    result = check(root, assets=assets)
    if failures := [finding for finding in result.findings if finding.fails]:
        raise DatasetError(
            "This dataset is damaged.",
            got=f"{root.name}: {result.total(fails=True)} findings, the first: {failures[0]}",
            allowed="a dataset in which `adamanip check` finds nothing",
            hint=f"adamanip check {as_typed(root)} --repair repairs damage from a crash",
        )
    _link(root, (file for file in _file_names(root) if file.startswith(_DATASET) and "/." not in file), into)
    card = dataset_card(root, name, repo_id, assets)
    return _finish(Staged("dataset", repo_id, into, _DATASET, version), card, root)


def stage_model(
    folder: Path, repo_id: str, into: Path, *, results: Sequence[ResultFile] = (), dataset: str | None = None
) -> Staged:
    """Checks a checkpoint and stages it: weights, both pipelines and their states, configurations free of local paths.

    Args:
        folder: ``pretrained_model`` of a checkpoint, or the checkpoint.
        repo_id: repository name on the Hub.
        into: an empty folder.
        results: evaluation results for the card.
        dataset: Hub name of the training dataset.

    Raises:
        DatasetError: a file is missing or damaged, or contains names of a machine or person.
    """
    folder = folder.resolve()
    folder = inner if (inner := folder / "pretrained_model").is_dir() else folder
    states = _check_checkpoint(folder)
    _link(folder, ("model.safetensors", *PIPELINES, *states), into)
    for name in ("config.json", "train_config.json"):
        config = shareable(json.loads((folder / name).read_text()), dataset)
        (into / name).write_text(json.dumps(config, indent=4) + "\n", encoding="utf-8")
    card = model_card(Checkpoint.read(into), repo_id, results=results, dataset=dataset)
    return _finish(Staged("model", repo_id, into, _MODEL), card, folder)


def stage_environment(
    repo_id: str,
    into: Path,
    *,
    category: str = ALL,
    results: Sequence[ResultFile] = (),
    commit: str = "",
) -> Staged:
    """Stages the environments' repository in an empty folder. Other arguments and errors: see `environment_files`."""
    files = environment_files(repo_id, category=category, results=results, commit=commit)
    (into / "envs").mkdir()
    for name, text in files.items():
        (into / name).write_text(text, encoding="utf-8")
    return _finish(Staged("model", repo_id, into, ("envs/",)), files["README.md"], into)


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _finish(staged: Staged, card: str, source: Path) -> Staged:
    """Adds the card. Raises `DatasetError` if a file contains names of a machine or person."""
    check_card(card, staged.kind)
    (staged.folder / "README.md").write_text(card, encoding="utf-8")
    sealed = staged.sealed()  # before the scan, so that later changes are detected
    require_clean(staged.files(), Names.here(source), owner=staged.repo_id.partition("/")[0])
    return sealed


def _file_names(root: Path) -> Iterator[str]:
    """Yields the names of all files in a folder and in linked folders. Visits each folder once."""
    seen: set[Path] = set()
    for folder, folders, names in os.walk(root, followlinks=True):
        if (real := Path(folder).resolve()) in seen:
            folders.clear()
            continue
        seen.add(real)
        folders.sort()
        paths = (Path(folder) / name for name in sorted(names))
        yield from (path.relative_to(root).as_posix() for path in paths if path.is_file())


def _link(source: Path, names: Iterable[str], into: Path) -> None:
    """Links large files, and copies the others, which so cannot change after the scan."""
    for name in names:
        target = into / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.suffix in _LARGE:
            target.symlink_to((source / name).resolve())
        else:
            shutil.copyfile(source / name, target)


def _check_checkpoint(folder: Path) -> list[str]:
    """Returns the names of the pipelines' state files. Raises `DatasetError` if a file is missing or damaged."""
    try:
        for name, fields_of_card in CARD_FIELDS.items():
            fields_of_card(name, json_fields.read(folder / name))
        states = list(_state_files(pipeline_steps(folder)))
        for name in ("model.safetensors", *states):
            if not (folder / name).is_file():
                raise ValueError(f"no {name}")
            try:
                with safe_open(folder / name, framework="np"):  # checks header and length
                    pass
            except SafetensorError as error:
                raise ValueError(f"{name}: {error}") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = f"no {Path(error.filename).name}" if isinstance(error, FileNotFoundError) else str(error)
        raise DatasetError(
            "This is not a complete checkpoint.",
            got=f"{folder}: {reason}"[:400],
            allowed="the folder pretrained_model of a LeRobot checkpoint: weights, configurations, both pipelines",
            hint="adamanip push model outputs/train/checkpoints/last/pretrained_model --repo-id YOU/NAME",
        ) from error
    return states


def _state_files(steps: Iterable[dict[str, Any]]) -> Iterator[str]:
    for name in (step.get("state_file") for step in steps):
        if name is not None:
            if not isinstance(name, str) or _STATE_FILE.fullmatch(name) is None:
                raise ValueError(f"{str(name)[:80]!r} is no file of states")
            yield name
