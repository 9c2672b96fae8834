"""Streaming a dataset of ours is refused where LeRobot would train on nothing, or on actions that were not executed."""

from __future__ import annotations

from typing import Any

import pytest

from lerobot_adamanip import lerobot_streaming
from lerobot_adamanip.errors import AdaManipError
from lerobot_adamanip.schema import ACTION

HISTORY = {ACTION: [-0.25, 0.0]}
CHUNK = {ACTION: [0.0, 0.25]}


@pytest.mark.parametrize(("window", "shards", "said"), [(HISTORY, 4, "streaming=false"), (CHUNK, 0, "num_workers=1")])
def test_what_cannot_be_streamed_is_refused_with_the_reason(window: Any, shards: int, said: str) -> None:
    with pytest.raises(AdaManipError, match=said):
        lerobot_streaming.require_streamable(window, shards)
    lerobot_streaming.require_streamable(CHUNK, 1)


def test_lerobots_own_factory_asks_and_leaves_other_datasets_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.datasets import factory

    class Streamed:
        def __init__(self, repo_id: str, **_: Any) -> None:
            self.meta = type("Meta", (), {"features": {"ours": repo_id == "local/ours"}})

    monkeypatch.setattr(factory, "StreamingLeRobotDataset", Streamed)
    lerobot_streaming.register(lambda features: bool(features["ours"]))
    once = factory.StreamingLeRobotDataset
    lerobot_streaming.register(lambda features: True)
    assert factory.StreamingLeRobotDataset is once
    assert isinstance(once("someone/else", delta_timestamps=HISTORY, max_num_shards=0), Streamed)
    with pytest.raises(AdaManipError, match="history of actions"):
        once("local/ours", delta_timestamps=HISTORY, max_num_shards=4)
