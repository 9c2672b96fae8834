"""Every dataset that a command of ours makes is accepted by every command that takes one.

Where a pair makes no sense, `REFUSED` has the error: it names the command to use instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from every_maker import DENSE, RECORDING, ROLLOUT, TICKS_ALONE, EveryDataset
from sound_demos import POINTS, make_sound_env

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_env_adamanip import make_environment as factory

COLLECTED = (
    "collect", "collect, other seed", "collect --no-images", "collect of several categories", "collect --policy",
    "collect --keep-failed", "render", "filter", "split",
)  # fmt: skip
ROBOTS = ("keyframes", "keyframes of a roll-out")
MIXED = ("keyframes, mixed with collect", "merge", "merge of corrections", "filter of a mix")
MAKERS = (*COLLECTED, *ROBOTS, *MIXED, *DENSE)
EACH_KIND = ("collect", "collect --policy", "keyframes", "filter of a mix", RECORDING, TICKS_ALONE)
"""Makers that every run of the tests tries."""
TAKERS = ("check", "stats", "view", "push", "filter", "split", "merge", "replay", "keyframes", "train")
NEED_KEY_FRAMES = ("stats", "view", "push", "replay", "train")
REFUSED: Mapping[tuple[str, str], str] = {
    **{(maker, taker): "adamanip keyframes" for maker in (RECORDING, ROLLOUT) for taker in NEED_KEY_FRAMES},
    **{(TICKS_ALONE, taker): "lerobot-record" for taker in NEED_KEY_FRAMES},
    (TICKS_ALONE, "train"): "adamanip collect",
    (TICKS_ALONE, "keyframes"): "--camera with a depth camera",
    **{(maker, "replay"): "adamanip view" for maker in (*ROBOTS, *MIXED)},
    **{(maker, "keyframes"): "adamanip merge" for maker in (*COLLECTED, *ROBOTS, *MIXED)},
}
"""(maker, taker) -> command that the error names."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    datasets = EveryDataset(tmp_path_factory.mktemp("made"))
    assert set(datasets.makers) | {"collect --keep-failed", "split"} == set(MAKERS)
    return datasets


@pytest.fixture(autouse=True)
def _fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(factory, "make_environment", make_sound_env)


def words(taker: str, root: Path, out: Path) -> list[str]:
    """A command as typed."""
    return {
        "check": ["check", str(root)],
        "stats": ["stats", str(root)],
        "view": ["view", str(root), "--out", str(out / "view.png")],
        "push": ["push", "dataset", str(root), "--repo-id", "someone/demos", "--dry-run"],
        "filter": ["filter", str(root), "--where", "episode_index=0", "--out", str(out / "filtered")],
        "split": ["split", str(root), "--parts", "a=0.5,b=0.5", "--out", str(out / "parts")],
        "merge": ["merge", *(str(out / "parts" / name) for name in "ab"), "--out", str(out / "merged")],
        "replay": ["replay", str(root)],
        "keyframes": ["keyframes", str(root), "--out", str(out / "keyframes"), "--num-points", str(POINTS)],
    }[taker]


def train(root: Path) -> None:
    """Two steps of the default policy, as `lerobot-train` makes dataset, policy and batches."""
    import torch
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.datasets.factory import resolve_delta_timestamps
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.policies.factory import make_policy, make_policy_config, make_pre_post_processors

    import lerobot_policy_adamanip  # noqa: F401  (registers it)

    sizes = {"num_points": POINTS, "encoder_dims": (16, 24), "encoder_out_dim": 16, "training_points": 8}
    config = make_policy_config("dp3_adaptive", device="cpu", push_to_hub=False, **sizes)
    meta = LeRobotDatasetMetadata("local/demos", root=root)
    dataset = LeRobotDataset("local/demos", root=root, delta_timestamps=resolve_delta_timestamps(config, meta))
    policy: Any = make_policy(config, ds_meta=dataset.meta)
    before, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-3)
    batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=8)))
    for _ in range(2):
        loss, _ = policy.forward(before(dict(batch)))
        assert torch.isfinite(loss)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def outcome(taker: str, root: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Returns the error; nothing if there is none."""
    capsys.readouterr()
    if taker != "train":
        status = main(words(taker, root, out))
        told = capsys.readouterr()
        return "" if status == 0 else told.err + told.out
    try:
        train(root)
    except AdaManipError as error:
        return f"error: {error}"
    return ""


@pytest.mark.parametrize(
    "maker", [pytest.param(name, marks=() if name in EACH_KIND else pytest.mark.nightly) for name in MAKERS]
)
def test_it_is_accepted_by_every_command(
    maker: str, made: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for taker in TAKERS:
        told = outcome(taker, made[maker], tmp_path, capsys)
        wanted = REFUSED.get((maker, taker))
        if wanted is None:
            assert told == "", (maker, taker, told)
        else:
            assert told.count("error: ") == 1, (maker, taker, told)
            assert wanted in told.partition("try:")[2], (maker, taker, told)
    merged = tmp_path / "merged"
    assert read_info(merged)["total_episodes"] == read_info(made[maker])["total_episodes"]
    assert check(merged).findings == []
    if maker in (RECORDING, ROLLOUT):  # its cameras' calibration came along
        assert main(["keyframes", str(merged), "--out", str(tmp_path / "again"), "--num-points", str(POINTS)]) == 0
        assert read_info(tmp_path / "again")["total_frames"] == read_info(tmp_path / "keyframes")["total_frames"]
