"""Cards: complete, valid, true of what they describe, and free of what belongs to a machine."""

from __future__ import annotations

import dataclasses
import getpass
import json
import re
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import check_damages as to
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from huggingface_hub import ModelCard
from huggingface_hub.repocard_data import eval_results_to_model_index, model_index_to_eval_results

from lerobot_adamanip.cli.main import parse_command
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.cards import COLUMNS, check_card, dataset_card
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.editing import filter_episodes
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest
from lerobot_adamanip.datasets.stats import read_stats
from lerobot_adamanip.evaluation.results import command_options, read_result
from lerobot_adamanip.hub.model_card import Checkpoint, model_card
from lerobot_adamanip.hub.model_index import eval_results
from lerobot_adamanip.hub.scan import Names, scan
from lerobot_adamanip.util.errors import DatasetError
from lerobot_env_adamanip.sim import render_device


@pytest.fixture
def card(published: Path) -> str:
    return (published / "README.md").read_text()


def test_every_column_is_described(card: str) -> None:
    for key in schema.dataset_features():
        assert f"| `{key}` |" in card
    assert set(COLUMNS) == set(schema.dataset_features())


def test_its_numbers_are_those_of_the_dataset(published: Path, card: str) -> None:
    attempts = [json.loads(line) for line in (published / "meta" / "attempts.jsonl").read_text().splitlines()]
    kept = sum(attempt["kept"] for attempt in attempts)
    succeeded = sum(attempt["reason"] == "success" for attempt in attempts)
    assert f"{len(attempts)} episodes were attempted: {succeeded} " in card
    assert f"{kept} were kept" in card
    info = json.loads((published / "meta" / "info.json").read_text())
    episodes, rows = info["total_episodes"], info["total_frames"]
    assert f"{rows - episodes} key frames in {rows} rows" in card
    for locked in (True, False):
        mine = [attempt for attempt in attempts if (attempt["hidden_state"] or {}).get("locked") is locked]
        opened, kept = (sum(each[name] in (True, "success") for each in mine) for name in ("reason", "kept"))
        row = f"| `safe: {'locked' if locked else 'unlocked'}` | {len(mine)} | {opened} | {kept} |"
        assert row in card
    unplaced = sum(attempt["hidden_state"] is None for attempt in attempts)
    assert f"| `safe: (no layout)` | {unplaced} | 0 | 0 |" in card
    rows = pq.read_table(published / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert f"{sum(row['late'] for row in rows)} episodes start late" in card
    failed = [row["failed_tries"] for row in rows if row["success"]]
    assert f"{sum(map(bool, failed))} episodes recover" in card
    for count in set(failed):
        assert f"| {count} | {failed.count(count)} | {failed.count(count)} |" in card
    versions = read_manifest(manifest_path(published)).versions
    assert all(f"{name} {version}" in card for name, version in versions.items())
    assert "different versions" not in card


def test_its_command_collects_the_same(published: Path, card: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: True)

    (line,) = [line for line in card.splitlines() if line.startswith("adamanip collect")]
    assert line.startswith(f"adamanip collect {published.name} ")
    asked = parse_command("collect", line.split()[2:]).spec()
    made = read_manifest(manifest_path(published)).spec
    assert Manifest(asked).to_json() == Manifest(made).to_json()


def test_a_corrected_dataset_tells_what_succeeded_not_what_was_kept(published: Path, tmp_path: Path) -> None:
    """A policy's episodes that an expert corrects are kept, succeed or not; here none does."""
    corrected = shutil.copytree(published, tmp_path / "corrected")
    for path in (corrected / "meta" / "episodes").glob("*/*.parquet"):
        table = pq.read_table(path)
        failed = pa.array([False] * len(table))
        pq.write_table(table.set_column(table.schema.get_field_index("success"), "success", failed), path)
    path = corrected / "meta" / "attempts.jsonl"
    attempts = [json.loads(line) for line in path.read_text().splitlines()]
    for attempt in attempts:
        if attempt["kept"]:
            attempt["reason"] = "corrected without success"
    path.write_text("".join(json.dumps(attempt) + "\n" for attempt in attempts))
    text = dataset_card(corrected, "corrected", "local/corrected")
    assert f"{len(attempts)} episodes were attempted: 0 (0.0 %) succeeded" in text
    assert f"{sum(attempt['kept'] for attempt in attempts)} were kept" in text
    assert "Only episodes that failed are in it" in text
    assert "--dataset.repo_id=local/corrected --dataset.root=DIR " in text


def test_a_part_tells_its_own_counts_and_how_it_was_chosen(published: Path, tmp_path: Path) -> None:
    filter_episodes(published, ["hidden.locked=true"], tmp_path / "locked")
    chosen = filter_episodes(tmp_path / "locked", ["episode_index=0:1"], tmp_path / "one")
    text = dataset_card(tmp_path / "one", "one", "someone/one")
    check_card(text, "dataset")
    whole = json.loads((published / "meta" / "info.json").read_text())["total_episodes"]
    assert chosen == [0]
    assert f"Part of `DATASET`: 1 of its {whole} episodes" in text
    assert "adamanip filter DATASET --where hidden.locked=true --out locked\nadamanip filter DATASET" in text
    assert "were attempted" not in text
    assert "| `safe: locked` | 1 | 1 |" in text
    assert "`safe: unlocked`" not in text
    assert "adamanip collect DATASET " in text
    assert read_stats(tmp_path / "one").attempts is None
    scanned = scan({"meta/selection.json": tmp_path / "one/meta/selection.json"}, Names.here(tmp_path))
    assert scanned == []


@pytest.mark.parametrize(
    ("moved", "sentence"), [(0, "its pose is the same in all episodes"), (1, "its pose is drawn anew for each episode")]
)
def test_a_camera_that_moves_between_episodes_is_told(
    published: Path, tmp_path: Path, moved: int, sentence: str
) -> None:
    """It moves in the last episode only."""
    root = shutil.copytree(published, tmp_path / "moved")
    (path,) = (root / "meta" / "episodes").glob("*/*.parquet")
    table = pq.read_table(path)
    camera = json.loads(table["camera"][0].as_py())
    other = json.dumps({**camera, "extrinsics": [[7.0] * 4] * 4})
    cameras = [json.dumps(camera)] * (len(table) - moved) + [other] * moved
    pq.write_table(table.set_column(table.schema.get_field_index("camera"), "camera", pa.array(cameras)), path)
    assert sentence in " ".join(dataset_card(root, "moved", "local/moved").split())


def test_nothing_of_this_machine_is_published(published: Path) -> None:
    secrets = [str(published), str(Path.home()), "/tmp", socket.gethostname(), str(Path.cwd())]
    secrets = [secret for secret in (*secrets, f"/{getpass.getuser()}/") if len(secret) > 3]  # not by chance
    for path in published.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            assert not [secret for secret in secrets if secret.encode() in content], path


def test_a_dataset_of_several_collections_has_a_card_too(published: Path, tmp_path: Path) -> None:
    merged = shutil.copytree(published, tmp_path / "merged")
    for name in ("collection.json", "attempts.jsonl"):
        (merged / "meta" / name).unlink()
    to.edit_episode(1, versions=lambda text: text.replace('"torch": "', '"torch": "0.'))(Path(merged))
    text = dataset_card(merged, "merged", "someone/safes")
    check_card(text, "dataset")
    assert "adamanip collect" not in text
    kept = pq.read_table(published / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    locked = sum(json.loads(each["hidden_state"])["locked"] for each in kept)
    assert f"| `safe: locked` | {locked} | {locked} |" in text
    assert "| hidden | episodes | of them succeeded |" in text
    assert re.search(r"recorded with different versions: torch 0\.[\d.+a-z]+ and [\d.+a-z]+\.", text)


VALID = "---\nlicense: apache-2.0\ntags: [robotics]\n---\n\n# Card\n"
INDEX = "model-index: [{name: a, results: [{task: {type: robotics}, dataset: {name: a}, metrics: []}]}]"
INVALID = {
    "no header": VALID.replace("---", ""),
    "a header that is no YAML": VALID.replace("tags: [robotics]", "tags: [robotics"),
    "no licence": VALID.replace("license: apache-2.0\n", ""),
    "a dataset that cannot be": VALID.replace("tags:", "datasets: [a/b/c]\ntags:"),
    "results without a dataset's type": VALID.replace("tags:", f"{INDEX}\ntags:"),
    "a placeholder": VALID + "$repo_id",
}


@pytest.mark.parametrize("name", INVALID)
def test_an_invalid_card_is_one_clear_error(refuses: Callable[..., str], name: str) -> None:
    check_card(VALID, "model")
    refuses(DatasetError, lambda: check_card(INVALID[name], "model"))


def test_results_are_on_the_card_and_in_its_index(project_root: Path) -> None:
    result = read_result(project_root / "results" / "demo.json")
    training = {"env": {"type": "adamanip_safe"}, "steps": 5, "policy": {"pretrained_path": "trainings/first"}}
    checkpoint = Checkpoint({"type": "dp3_adaptive"}, training, 1_500_000, updates=5)
    text = model_card(checkpoint, "someone/policy", results=[result], dataset="someone/safes")
    check_card(text, "model")
    card = ModelCard(text)
    success = result.rows[0].metrics.success
    (found,) = card.data.eval_results
    assert (found.metric_type, found.metric_value) == ("success_rate", round(success.count / success.episodes, 4))
    scenes = "seen objects, {} scenes {} to {}".format(result.scenes, *result.seeds)
    assert (found.dataset_type, found.dataset_config, found.dataset_split) == ("adamanip_safe", "paper", scenes)
    assert found.dataset_args["command"] == result.command
    assert (found.dataset_args["n_success"], found.dataset_args["n_episodes"]) == (success.count, success.episodes)
    assert f"{success.count}/{success.episodes}: " in card.text
    assert f"simulation version {result.simulation_version}." in card.text
    assert card.data.datasets == ["someone/safes"]
    assert "1.5 M parameters" in card.text
    assert "lerobot-train --config_path=someone/policy --policy.push_to_hub=false" in card.text, "with every option"
    assert "went on from the weights of an earlier training" in card.text
    assert "trainings/first" not in card.text


def test_each_value_of_the_index_keeps_the_arguments_of_its_own_result(project_root: Path) -> None:
    """The Hub's library joins rows of equal identity, and would keep the arguments of the first."""
    cells = project_root / "results" / "benchmark" / "test"
    one, other = (read_result(cells / f"{name}-safe-seen-1000.json") for name in ("dp3_adaptive", "without_memory"))
    two_labels = dataclasses.replace(one, rows=(*one.rows, *other.rows))
    results = [two_labels, other, dataclasses.replace(other, scenes="validation", seeds=(600000, 600099))]
    content = eval_results_to_model_index("policy", eval_results(results))
    _, index = model_index_to_eval_results(content)
    expected = [
        (each.scenes, list(each.seeds), each.command, row.metrics.success.count, row.metrics.success.rate)
        for each in results
        for row in each.rows
    ]
    names = ("scenes", "seeds", "command", "n_success")
    shown = [(*((each.dataset_args or {})[name] for name in names), each.metric_value) for each in index]
    assert shown == expected


def test_a_policy_at_control_rate_says_how_it_is_evaluated(project_root: Path) -> None:
    """Its category and options are those of its results, since a training need not name them."""
    path = project_root / "results" / "benchmark" / "one_object" / "act-safe-seen-1000.json"
    result = read_result(path)
    text = model_card(Checkpoint({"type": "act"}, {"steps": 5}, 1), "someone/policy", results=[result])
    assert "--env.type=adamanip_safe --env.control=dense --env.action=ee_pose --env.state=pose" in text
    assert "--env.memory=events --env.image_size=96 " in text.replace("--env.num_points=1024 ", "")
    assert "It acts at control rate, 10 Hz." in text
    assert "One action is one key frame" not in text
    key_frames = model_card(Checkpoint({"type": "dp3_adaptive", "control_fps": None}, {}, 1), "someone/policy")
    assert "One action is one key frame" in key_frames
    assert "--env.control" not in key_frames


def test_a_card_names_the_scenes_of_its_policy() -> None:
    scenes = {"mechanism_rules": "row", "poses": "fixed", "hints": 0.5, "max_failed_tries": "best"}
    unnamed = {"num_points": 1024, "max_failed_tries": None, "episode_length": 45, "hints": 0.0, "poses": "randomized"}

    def command(env: dict[str, object]) -> str:
        training = {"env": {"type": "adamanip_safe", **unnamed, **env}}
        text = model_card(Checkpoint({"type": "dp3_adaptive"}, training, 1), "someone/policy")
        return next(line for line in text.splitlines() if line.startswith("lerobot-eval"))

    assert "--env.type=adamanip_safe --env.split=test" in command({})
    words = command({**scenes, "episode_length": 20}).split()
    assert {f"--env.{name}={value}" for name, value in scenes.items()} <= set(words)
    assert "--env.episode_length=20" in words


def test_options_of_a_command_with_spaces_are_those_with_equals_signs() -> None:
    options = "--env.control=dense --env.sensing='d435,arm_error_mm=0' --env.split=test"
    words = f"lerobot-eval {options} --eval.recording --seed=1"
    assert command_options(words.replace("=", " ", 1).replace("split=", "split ")) == command_options(words)
    expected = {
        "--env.control": "dense", "--env.sensing": "d435,arm_error_mm=0", "--env.split": "test", "--eval.recording": "",
        "--seed": "1",
    }  # fmt: skip
    assert command_options(words) == expected
    assert command_options("adamanip collect --cloud DIR --seed=1") == {"--cloud": "", "--seed": "1"}
