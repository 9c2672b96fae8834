"""Putting a dataset on the Hugging Face Hub, under our card."""

from __future__ import annotations

from pathlib import Path

from lerobot_adamanip.demos.loading import load_check
from lerobot_adamanip.errors import ConfigurationError, DatasetError
from lerobot_adamanip.hub.cards import LICENSE, TAGS


def require_hub_name(repo_id: str | None) -> str:
    """Returns ``repo_id`` if it can be a Hub repository; raises `ConfigurationError` if not."""
    owner, _, name = (repo_id or "").partition("/")
    if not owner or not name or owner == "local":
        raise ConfigurationError(
            "Not a repository of the Hub.",
            got=repr(repo_id),
            allowed="user/name",
            hint="--push-to-hub --repo-id YOUR_NAME/adamanip_safe",
        )
    return repo_id or ""


def publish(root: str | Path, repo_id: str, *, private: bool = False) -> None:
    """Uploads a complete dataset with LeRobot's own call, then its card in place of LeRobot's generic one.

    Raises:
        ConfigurationError: if ``repo_id`` is not ``user/name``.
        DatasetError: if the dataset is not whole, or the Hub refuses (no network, no login, no right to write).
    """
    name = require_hub_name(repo_id)
    folder = Path(root).absolute()
    load_check(folder)
    from huggingface_hub import DatasetCard
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(name, root=folder)
    try:
        dataset.push_to_hub(tags=[tag for tag in TAGS if tag != "LeRobot"], license=LICENSE, private=private)
        DatasetCard.load(folder / "README.md").push_to_hub(name, repo_type="dataset")
    except (HfHubHTTPError, OfflineModeIsEnabled, ConnectionError, OSError) as error:
        raise DatasetError(
            "The Hub did not take the dataset.",
            got=str(error),
            allowed="a login with the right to write",
            hint="hf auth login, then the same command again; what was collected is kept",
        ) from error
