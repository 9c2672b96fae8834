from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lerobot_adamanip.errors import ConfigurationError, DatasetError
from lerobot_adamanip.hub.publish import publish

Refuses = Callable[[type, Callable[[], Any]], str]


def test_publishing_uploads_under_the_licence_and_our_card(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import huggingface_hub
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    pushed: list[Any] = []
    monkeypatch.setattr(
        LeRobotDataset, "push_to_hub", lambda self, **kwargs: pushed.append((self.repo_id, self.root, kwargs))
    )
    monkeypatch.setattr(
        huggingface_hub.DatasetCard, "push_to_hub", lambda self, name, **kwargs: pushed.append((name, str(self)))
    )
    publish(published, "someone/safes")
    (name, root, kwargs), (card_name, text) = pushed
    assert name == card_name == "someone/safes"
    assert root == published
    assert kwargs["license"] == "apache-2.0"
    assert "adamanip" in kwargs["tags"]
    assert "AdaManip demonstrations" in text


@pytest.mark.parametrize("name", [None, "safes", "local/safes", "someone/"])
def test_publishing_needs_a_name_on_the_hub(published: Path, refuses: Refuses, name: str) -> None:
    refuses(ConfigurationError, lambda: publish(published, name))


def test_publishing_without_a_network_is_one_clear_error(published: Path, refuses: Refuses) -> None:
    assert "login" in refuses(DatasetError, lambda: publish(published, "someone/safes"))
