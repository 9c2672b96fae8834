"""Recordings of the former format: read, refused where a policy would learn a clock from them, and converted."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from dense_helpers import dense_episode, dense_features, write_recording

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.hardware.features import ARM, is_dense, is_former, recorded_features
from lerobot_adamanip.lerobot_patches.durable_recording import comparing
from lerobot_adamanip.recordings.recording import DenseRecording
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError

EPISODES = (dense_episode(seed=1), dense_episode(seed=2, opens=False))


@pytest.fixture(scope="module")
def former(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("former") / "recording", *EPISODES, former=True)


@pytest.fixture
def converted(former: Path, tmp_path: Path) -> Path:
    root = Path(shutil.copytree(former, tmp_path / "recording"))
    assert main(["check", str(root), "--repair"]) == 0
    return root


def described(features: dict[str, Any]) -> dict[str, Any]:
    return {key: [feature["dtype"], list(feature["shape"]), feature["names"]] for key, feature in features.items()}


def test_the_former_format_is_found_and_named(former: Path) -> None:
    assert is_dense(Dataset(former, recordings=True).features)
    report = check(former)
    assert not report.clean
    assert "--repair" in str(report.findings[0])
    with pytest.raises(DatasetError, match=r"(?s)former format.*--repair"):
        comparing(lambda *_: None)(
            type("Opened", (), {"features": read_info(former)["features"], "root": former}), *"abc"
        )


def test_one_command_converts_it_to_the_present_format(converted: Path, tmp_path: Path) -> None:
    present = write_recording(tmp_path / "present", *EPISODES)
    assert check(converted).clean
    old, new = Dataset(converted, recordings=True), Dataset(present, recordings=True)
    assert described(old.features) == described(new.features)
    assert not is_former(old.features)
    for number in range(2):
        before, after = (source.columns(source.episode(number)) for source in (old, new))
        for key in (schema.STATE, schema.ACTION, schema.JOINTS, schema.DONE, schema.PHASE, ARM):
            np.testing.assert_allclose(before[key], after[key], atol=1e-6, err_msg=key)
        success = EPISODES[number].success
        np.testing.assert_array_equal(before[schema.SUCCESS].ravel(), [*success[1:], success[-1]])
    stored = pq.read_schema(next(converted.glob("meta/episodes/*/*.parquet"))).names
    assert f"stats/{ARM}/mean" in stored


def test_nothing_that_the_converter_reads_is_lost(former: Path, converted: Path) -> None:
    for number in range(2):
        before, after = (DenseRecording.open(root).episode(number) for root in (former, converted))
        for name in ("state", "effort", "sent", "stamp", "outcome"):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
        np.testing.assert_allclose(before.asked, after.asked, atol=1e-6)


def test_a_conversion_that_was_killed_is_repeated(
    former: Path, converted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = files.write_atomically
    for killed_at in range(4):  # rows, episodes, statistics, info
        root, written = Path(shutil.copytree(former, tmp_path / f"killed {killed_at}")), list[Path]()

        def dying(path: Path, content: bytes, written: list[Path] = written, last: int = killed_at) -> None:
            if len(written) == last:
                raise KeyboardInterrupt
            written.append(path)
            write(path, content)

        with monkeypatch.context() as patch:
            patch.setattr(files, "write_atomically", dying)
            assert main(["check", str(root), "--repair"]) == 130
        assert is_former(read_info(root)["features"])
        assert main(["check", str(root), "--repair"]) == 0
        ended, whole = Dataset(root, recordings=True), Dataset(converted, recordings=True)
        assert ended.info == whole.info
        for number in range(2):
            first, second = (source.columns(source.episode(number)) for source in (ended, whole))
            assert all((first[key] == second[key]).all() for key in first)


def test_a_recording_has_the_columns_of_simulated_demonstrations() -> None:
    features = recorded_features(dense_features())
    simulated = schema.dense_features(*(features[key]["names"] for key in (schema.ACTION, schema.STATE)), cameras=())
    assert set(features) - set(dense_features()) == set(simulated) - {schema.STATE, schema.ACTION} | {ARM}
    assert {key: features[key] for key in simulated} == simulated
