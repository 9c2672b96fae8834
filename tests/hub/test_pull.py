"""What LeRobot's own calls bring back from the Hub, and what of it works without a network."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from huggingface_hub import HfApi
from loopback_hub import LoopbackHub
from sound_demos import collect_sound

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.hub.push import push
from lerobot_adamanip.hub.staging import Staged, stage_dataset, stage_environment, stage_model

pytestmark = pytest.mark.timeout(900)  # seven processes, each of which imports LeRobot

HERE = Path(__file__).parent
NAME, CLOUDS, POLICY, ENVIRONMENT = "someone/safes", "someone/clouds", "someone/policy", "someone/env"
"""LeRobot streams pictures with torchcodec alone, which needs FFmpeg's libraries: ``CLOUDS`` has none."""
CALLS: dict[str, tuple[str, dict[str, Any]]] = {
    'LeRobotDataset("USER/NAME")': ("dataset", {"name": NAME}),
    'LeRobotDataset("USER/NAME", revision="main")': ("dataset", {"name": NAME, "revision": "main"}),
    'LeRobotDataset("USER/NAME", revision="COMMIT")': ("dataset", {"name": NAME, "revision": "COMMIT"}),
    'LeRobotDataset("USER/NAME", revision="COMMIT", episodes=[1])': (
        "dataset", {"name": NAME, "revision": "COMMIT", "episodes": [1]},
    ),
    'LeRobotDataset("USER/NAME", root="DIR")': ("dataset", {"name": NAME, "root": "DIR"}),
    'StreamingLeRobotDataset("USER/NAME")': ("stream", {"name": CLOUDS}),
    'StreamingLeRobotDataset("USER/NAME", root="DIR")': ("stream", {"name": CLOUDS, "root": "CLOUDS_DIR"}),
    'lerobot-eval --policy.path=USER/POLICY': ("policy", {"name": POLICY}),
    'make_env("USER/ENV", trust_remote_code=True)': ("environment", {"name": ENVIRONMENT}),
    'make_env("USER/ENV@COMMIT:envs/safe.py", trust_remote_code=True)': (
        "environment", {"name": f"{ENVIRONMENT}@ENV_COMMIT:envs/safe.py"},
    ),
}  # fmt: skip
"""Rows of the offline table of docs/hub.md."""


def asked(commits: dict[str, str], *calls: tuple[str, dict[str, Any]]) -> str:
    text = json.dumps(calls)
    for word, value in commits.items():
        text = text.replace(word, value)
    return text


def answers(done: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


@pytest.fixture
def environment_commit(api: HfApi, tmp_path: Path) -> str:
    """Publishes the environments."""
    (tmp_path / "env").mkdir()
    return push(stage_environment(ENVIRONMENT, tmp_path / "env"), api).commit


@pytest.fixture
def commits(environment_commit: str, staged: Staged, api: HfApi, trained: Path, tmp_path: Path) -> dict[str, str]:
    """Publishes datasets and a policy too; gives words for commits and folders."""
    for name in ("model", "staged-clouds"):
        (tmp_path / name).mkdir()
    push(stage_model(trained, POLICY, tmp_path / "model"), api)
    clouds = collect_sound(tmp_path / "clouds", observe_images=False)
    push(stage_dataset(clouds, CLOUDS, tmp_path / "staged-clouds"), api)
    return {
        "ENV_COMMIT": environment_commit, "COMMIT": push(staged, api).commit,
        "CLOUDS_DIR": str(tmp_path / "pulled-clouds"), "DIR": str(tmp_path / "pulled"),
    }  # fmt: skip


def matrix() -> dict[str, tuple[bool, str]]:
    """The table: call -> whether it works offline, and what to do if not."""
    text = (HERE.parents[1] / "docs" / "hub.md").read_text(encoding="utf-8")
    found = re.search(r"<!-- offline -->\n(.*?)<!-- /offline -->", text, re.DOTALL)
    assert found is not None
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in found[1].splitlines()[2:]]
    assert {works for _, works, _ in cells} == {"yes", "no"}
    return {call.strip("`"): (works == "yes", advice) for call, works, advice in cells}


@pytest.mark.nightly
def test_pulled_again_and_offline_as_the_table_says(
    commits: dict[str, str], published: Path, staged: Staged, run: Any, hub: LoopbackHub
) -> None:
    assert list(matrix()) == list(CALLS)
    folder = ("dataset", {"name": CLOUDS, "root": "CLOUDS_DIR"})  # what streams from a folder fills none
    _, *came = answers(run(str(HERE / "pull_program.py"), asked(commits, folder, *CALLS.values())))
    online = dict(zip(CALLS, came, strict=True))
    assert not [name for name, came in online.items() if "error" in came], online
    check_bytes(online['LeRobotDataset("USER/NAME")']["found"], commits["COMMIT"], staged)
    told = json.loads((published / "meta" / "info.json").read_text())
    for name, (kind, options) in CALLS.items():
        found = online[name]["found"]
        if kind == "dataset":
            assert found["episodes"] == (1 if "episodes" in options else told["total_episodes"]), name
            assert "episodes" in options or found["rows"] == told["total_frames"]
        if kind == "stream":
            assert found == told["total_frames"]
    assert online['make_env("USER/ENV@COMMIT:envs/safe.py", trust_remote_code=True)']["found"] == {
        "adamanip_safe": {"0": 2}
    }
    assert len(online['make_env("USER/ENV", trust_remote_code=True)']["found"]) == 9
    before = len(hub.requests)
    came = answers(run(str(HERE / "pull_program.py"), asked(commits, *CALLS.values()), offline=True))
    offline = dict(zip(CALLS, came, strict=True))
    assert len(hub.requests) == before
    assert {name: "found" in came for name, came in offline.items()} == {
        name: works for name, (works, _) in matrix().items()
    }
    for name, (works, advice) in matrix().items():
        assert works or "`" in advice  # it names what does work
        assert not works or offline[name] == online[name]


def check_bytes(found: dict[str, Any], commit: str, staged: Staged) -> None:
    root = Path(found["root"])
    pulled = {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
    assert {name: content for name, content in pulled.items() if name[0] != "."} == {
        name: path.read_bytes() for name, path in staged.files().items()
    }
    assert root.name == commit


@pytest.mark.usefixtures("environment_commit")
def test_code_of_the_hub_runs_with_consent_alone(run: Any, hub: LoopbackHub) -> None:
    before = hub.count("/resolve/")
    call = ("environment", {"name": ENVIRONMENT, "trust": False})
    allowed = CALLS['make_env("USER/ENV", trust_remote_code=True)']
    (came,) = answers(run(str(HERE / "pull_program.py"), asked({}, call)))
    assert "Refusing to execute remote code" in came["error"]
    assert hub.count("/resolve/") == before
    (came,) = answers(run(str(HERE / "pull_program.py"), asked({}, allowed)))
    assert len(came["found"]) == len(CATEGORIES)


@pytest.mark.usefixtures("environment_commit")
def test_without_the_package_the_environment_says_what_to_install(run: Any, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "lerobot_env_adamanip.py").write_text("raise ModuleNotFoundError('gone', name='lerobot_env_adamanip')")
    program = shutil.copy(HERE / "pull_program.py", hidden)  # a program's folder is looked into first
    (came,) = answers(run(str(program), asked({}, CALLS['make_env("USER/ENV", trust_remote_code=True)'])))
    assert "pip install '" in came["error"]
    assert "[sim]" in came["error"]
