"""`adamanip push`: publishes datasets, policies and the environments on the Hugging Face Hub."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from lerobot_adamanip.cli.arguments import CategoryOrAll, print_result, require_effects
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.datasets.repository_names import require_hub_name, require_release_name
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.hub.push import PushResult
    from lerobot_adamanip.hub.staging import Staged


@dataclass
class PushCommand:
    """Publishes a dataset, a policy or the environments with a card generated from their content.

    Checks the files, creates the repository, uploads, and moves the version tag. After an interruption, the same
    command resumes; files already uploaded are not sent again. Names of this machine are removed or refused.
    """

    kind: tyro.conf.Positional[Literal["dataset", "model", "environment"]]
    """Kind of publication."""

    repo_id: str
    """Name on the Hub: USER/NAME."""

    folder: tyro.conf.Positional[Path | None] = None
    """Folder of the dataset, or pretrained_model of a checkpoint."""

    results: tuple[Path, ...] = ()
    """Evaluations for the card of a policy or of the environments: files of `adamanip report LOG --out FILE --command
    '...'`."""

    dataset: str | None = None
    """Hub name of a policy's training dataset. Default: from its training configuration."""

    assets: Path | None = None
    """Folder of the external assets used for a dataset, if any."""

    category: CategoryOrAll = ALL
    """Category of the environment that env.py opens; all for the nine together."""

    release: str | None = None
    """Tag of this publication, e.g. release-1. A tag that looks like a version is refused."""

    private: bool = False
    """Make the repository private."""

    dry_run: bool = False
    """Check and list the files, and print the card, but upload nothing."""

    json: bool = False
    """Print one JSON object when done. Progress goes to stderr."""

    def run(self) -> int:
        """Publishes and prints. Returns 0 when the Hub has the files."""
        sizes, result, card = self.publish()
        values = {"dry_run": True, "files": sizes, "card": card} if result is None else asdict(result)
        print_result(self.json, values, self._text(sizes, result, card))
        return 0

    def publish(self) -> tuple[dict[str, int], PushResult | None, str]:
        """Publishes. Returns the file sizes [bytes], the result, which is None for a dry run, and the card."""
        self._check()
        from lerobot_adamanip.hub.push import push

        with tempfile.TemporaryDirectory(prefix="adamanip-push-") as scratch, contextlib.redirect_stdout(sys.stderr):
            staged = self._staged(Path(scratch) / "staged")
            sizes = {name: path.stat().st_size for name, path in staged.files().items()}
            card = staged.files()["README.md"].read_text(encoding="utf-8")
            return sizes, None if self.dry_run else push(staged, private=self.private, release=self.release), card

    def _check(self) -> None:
        require_hub_name(self.repo_id)
        if self.release is not None:
            require_release_name(self.release)
        if self.dataset is not None:
            require_hub_name(self.dataset)
        if (self.folder is None) != (self.kind == "environment"):
            raise ConfigurationError(
                "A dataset or model needs a folder; the environment takes none.",
                got=f"{self.kind} {self.folder or ''}".strip(),
                allowed="dataset DIR, model DIR or environment",
                hint="adamanip push dataset outputs/demos --repo-id YOU/adamanip-safe",
            )

        of_kind = {"model": ("dataset", "results"), "dataset": ("assets",), "environment": ("category", "results")}
        others = {name for names in of_kind.values() for name in names} - {*of_kind[self.kind]}
        require_effects(
            self, {f"with {kind}": [name for name in names if name in others] for kind, names in of_kind.items()}
        )

    def _staged(self, into: Path) -> Staged:
        from lerobot_adamanip.evaluation.results import read_result
        from lerobot_adamanip.hub.staging import stage_dataset, stage_environment, stage_model

        into.mkdir()
        results = [read_result(path) for path in self.results]
        if self.kind == "environment":
            from lerobot_adamanip.evaluation.provenance import present_origin

            origin = present_origin()
            commit = "" if origin.changed else origin.commit or ""
            return stage_environment(self.repo_id, into, category=self.category, results=results, commit=commit)
        assert self.folder is not None
        if self.kind == "model":
            return stage_model(self.folder, self.repo_id, into, results=results, dataset=self.dataset)
        return stage_dataset(self.folder, self.repo_id, into, assets=self.assets)

    def _text(self, sizes: dict[str, int], result: PushResult | None, card: str) -> str:
        if result is None:
            files = [f"{size:>12}  {name}" for name, size in sizes.items()]
            total = f"{len(sizes)} files, {sum(sizes.values()) / 1e6:.1f} MB"
            return "\n".join([card, *files, f"{total}, for {self.repo_id}. Nothing was sent."])
        state = "published" if result.changed else "was there already"
        tags = f", tagged {', '.join(result.tags)}" if result.tags else ""
        return f"{result.url} {state}: {result.files} files, {result.bytes / 1e6:.1f} MB, commit {result.commit}{tags}."
