"""Reading the episode log: what the environment writes is read; what it does not, is one clear error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.contract.sensing import parse_sensing
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.evaluation.record import (
    LABEL,
    LIMITS,
    EpisodeRecord,
    append_record,
    mixed_settings,
    new_run_id,
    read_log,
)
from lerobot_adamanip.evaluation.report import compare
from lerobot_adamanip.evaluation.results import policy_result
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

GOOD: dict[str, Any] = record(locked=True, seed=1000, blocked_pulls=1, object_id="safe_003").to_json()


def write(path: Path, *lines: object) -> Path:
    path.write_text("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines) + "\n")
    return path


def test_records_come_back_as_they_were_and_in_order(tmp_path: Path) -> None:
    path = tmp_path / "logs" / "log.jsonl"
    records = [
        record(seed=7, locked=True),
        record(object_id="lamp_003", success=False, run_id=None, try_sequence=()),
    ]
    for each in records:
        append_record(path, each)
    assert read_log(path) == records
    assert len(path.read_text().splitlines()) == 2


@given(
    st.builds(
        record,
        seed=st.integers(0, 2**31),
        object_id=st.sampled_from(["safe_000", "lamp_041", "pressure_cooker_002"]),
        success=st.booleans(),
        blocked_pulls=st.integers(0, 3),
        wrong_turns=st.integers(0, 3),
        key_moved=st.booleans(),
        run_label=st.none() | st.from_regex(LABEL, fullmatch=True),
        evaluation=st.integers(0, 5),
    )
)
def test_json_there_and_back_is_the_same_record(one: EpisodeRecord) -> None:
    assert EpisodeRecord.from_json(json.loads(json.dumps(one.to_json()))) == one


@pytest.mark.parametrize("typed", ["d435,camera_error_mm=+5", "d435,camera_error_mm=1E+1", "exact, lost=+.1_0"])
def test_accepted_errors_of_sensors_are_read_as_they_were_written(typed: str) -> None:
    one = record(sensing=EnvironmentOptions(sensing=typed).sensing)
    assert EpisodeRecord.from_json(json.loads(json.dumps(one.to_json()))) == one
    assert parse_sensing(one.sensing) == parse_sensing(typed.lower())


@pytest.mark.parametrize("run_id", ["two\nlines", "x" * 201], ids=["lines", "long"])
def test_a_run_id_that_no_log_holds_is_refused_before_it_is_written(run_id: str) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*one line.*try:"):
        record(run_id=run_id)


@pytest.mark.parametrize("key", GOOD)
def test_a_record_that_lacks_something_names_line_and_key(key: str, tmp_path: Path) -> None:
    damaged = {name: value for name, value in GOOD.items() if name != key}
    with pytest.raises(DatasetError, match=rf"line 2: the record lacks {key}"):
        read_log(write(tmp_path / "log.jsonl", GOOD, damaged))


@pytest.mark.parametrize(
    "changes",
    [
        {"success": "yes"}, {"clipped_goals": True}, {"object_id": "spoon_001"}, {"object_id": 3}, {"seed": -1},
        {"hidden_state": {"locked": 1}}, {"hidden_state": {"mode": "push"}}, {"hidden_state": []}, {"poses": 3},
        {"split": "holdout"}, {"object_split": "old"}, {"joints": {"door": "open"}}, {"joints": {"door": 1e999}},
        {"category": "lamp"}, {"max_failed_tries": -1}, {"try_sequence": [[0, 1]]}, {"simulation_version": 0},
        {"try_sequence": [[2, 1, True]]},
        {"versions": {"torch": 2}}, {"run_id": 5}, {"evaluation": None}, {"colour": "red"},
    ],
    ids=str,
)  # fmt: skip
def test_a_value_that_cannot_be_is_one_clear_error(changes: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"of this version[\s\S]*line 2"):
        read_log(write(tmp_path / "log.jsonl", GOOD, {**GOOD, **changes}))


@pytest.mark.parametrize("line", ['{"seed": 1000, "object', "text", "\0\0\0", "\udcff", "}{"])
def test_a_damaged_line_loses_no_other_one(line: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    log = write(tmp_path / "log.jsonl", GOOD, line.encode("utf-8", "surrogateescape").decode("latin-1"), GOOD)
    log.write_bytes(log.read_text(encoding="utf-8").encode("latin-1"))
    assert len(read_log(log)) == 2
    (message,) = caplog.messages
    assert "skipped damaged lines (2)" in message
    alone = tmp_path / "alone.jsonl"
    alone.write_bytes(log.read_bytes().split(b"\n")[1])
    with pytest.raises(DatasetError, match="no episode log"):
        read_log(alone)


def test_an_episode_that_cannot_be_logged_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="cannot be added to the episode log"):
        append_record(Path("/dev/full"), record())


def test_an_evaluation_is_run_label_and_round_and_ids_differ() -> None:
    assert record().evaluation == record(seed=9, locked=True).evaluation
    for change in ({"run_id": "other"}, {"run_label": "act"}, {"evaluation": 1}):
        assert record(**change).evaluation != record().evaluation
        assert record(**change).identity == record().identity
    assert len({new_run_id() for _ in range(100)}) == 100


def test_missing_empty_and_binary_logs_are_told(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="Cannot read"):
        read_log(tmp_path / "none.jsonl")
    with pytest.raises(DatasetError, match="This is a folder"):
        read_log(tmp_path)
    with pytest.raises(DatasetError, match="empty"):
        read_log(write(tmp_path / "empty.jsonl", ""))
    (tmp_path / "binary").write_bytes(bytes(range(128, 256)))
    with pytest.raises(DatasetError, match="no episode log"):
        read_log(tmp_path / "binary")


def test_errors_of_sensors_and_hints_are_logged_where_there_are_any() -> None:
    dense = {"self_calibration": True, "control": "dense", "fps": 10}
    plain, other = record(), record(sensing="d435,camera_error_mm=20", hints=0.5, **dense)
    assert not {"sensing", "hints", *dense} & plain.to_json().keys(), "a log without them is as before"
    assert EpisodeRecord.from_json(json.loads(json.dumps(other.to_json()))) == other


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("sensing", "d435"), ("hints", 0.5), ("poses", "fixed"), ("max_key_frames", 300), ("max_failed_tries", 1)),
        *(("self_calibration", True), ("control", "dense"), ("fps", 10)),
    ],
)
def test_episodes_of_two_settings_are_both_counted_warned_of_and_no_result(name: str, value: Any) -> None:
    records = [record(success=False), record(**{name: value})]
    comparison = compare({"pooled": records})
    assert comparison.summaries["pooled"].overall.success.episodes == 2
    (warning,) = (line for line in comparison.warnings() if "mixed" in line)
    assert warning.startswith(f"pooled: {LIMITS[name]} are mixed")
    with pytest.raises(ConfigurationError, match=f"{LIMITS[name]} are mixed"):
        policy_result({"pooled": records}, title="t", command="lerobot-eval")
    policy_result({"one": records[:1], "other": records[1:]}, title="t", command="lerobot-eval")


def test_the_limit_best_differs_by_mechanism() -> None:
    records = [record(max_failed_tries=3), record(object_id="microwave_000", max_failed_tries=1)]
    assert not mixed_settings(records)


def test_a_repeat_is_an_episode_of_its_own_and_its_tries_are_reported_apart() -> None:
    plain, again = record(), record(repeat=1, blocked_pulls=1)
    assert "repeat" not in plain.to_json(), "a log without repeats is as before"
    assert EpisodeRecord.from_json(json.loads(json.dumps(again.to_json()))) == again
    assert plain.identity != again.identity
    assert again.scene == (*plain.scene, 1)
    several = [record(seed=seed, repeat=number, blocked_pulls=2 - number) for seed in (1, 2) for number in range(3)]
    comparison = compare({"policy": [*several, record(seed=3, repeat=2, success=False)]})
    lines = [line for line in comparison.lines() if line.startswith("Episode ")]
    expected = [(2, 2, "2.00"), (2, 2, "1.00"), (2, 3, "0.00")]
    for line, (opened, episodes, tries) in zip(lines, expected, strict=True):
        assert f": {opened}/{episodes} opened, {tries} failed tries" in line
    assert not any(line.startswith("Episode ") for line in compare({"policy": [plain]}).lines())
    assert [each["success"] for each in comparison.to_json()["evaluations"][0]["again"]] == [[2, 2], [2, 2], [2, 3]]
