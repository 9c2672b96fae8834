"""Columns of recordings: those of simulated demonstrations; recordings of earlier versions are refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from dense_helpers import dense_episode, dense_features, write_recording

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, recorded_features


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose state has the names of an earlier version."""
    root = write_recording(tmp_path_factory.mktemp("earlier") / "recording", dense_episode(seed=1))
    info = json.loads((root / "meta" / "info.json").read_text())
    names = [*ARM_NAMES, "label.success"]
    info["features"][schema.STATE] |= {"names": names, "shape": [len(names)]}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    return root


@pytest.mark.parametrize("command", [["check"], ["check", "--repair"], ["stats"], ["keyframes", "--out=OUT"]])
def test_a_state_with_a_clock_and_the_result_is_one_clear_error(
    earlier: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    root = Path(shutil.copytree(earlier, tmp_path / "recording"))
    name, *options = (word.replace("OUT", str(tmp_path / "out")) for word in command)
    assert main([name, str(root), *options]) == (1 if name == "check" else 2)
    printed = "".join(capsys.readouterr())
    assert "its state holds a clock and the result" in printed
    assert "Traceback" not in printed


def test_a_recording_has_the_columns_of_simulated_demonstrations() -> None:
    features = recorded_features(dense_features())
    simulated = schema.dense_features(*(features[key]["names"] for key in (schema.ACTION, schema.STATE)), cameras=())
    assert set(features) - set(dense_features()) == set(simulated) - {schema.STATE, schema.ACTION} | {ARM}
    assert {key: features[key] for key in simulated} == simulated
