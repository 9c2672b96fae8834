"""A command answers `--help` and a wrong option at once: nothing heavy is imported for that."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from lerobot_adamanip.cli.keyframes import KeyframesCommand
from lerobot_adamanip.cli.main import COMMANDS

HEAVY = ("torch", "lerobot", "pandas", "datasets", "scipy", "sapien", "trimesh", "mani_skill", "pyarrow", "cv2")
ASK = """
import contextlib, io, sys
from lerobot_adamanip.cli.main import main
with contextlib.redirect_stdout(io.StringIO()):
    assert main(["--help"]) == 0
assert not {"numpy", "tyro"} & set(sys.modules)
for line in sys.argv[2:]:
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            status = main(line.split())
        except SystemExit as left:
            status = left.code
    assert status == (0 if line.endswith("--help") else 2), (line, status, err.getvalue())
    found = sorted(set(sys.argv[1].split(",")) & set(sys.modules))
    assert not found, (line, found)
with contextlib.redirect_stderr(io.StringIO()):
    assert main("collect x --objects 0:99".split()) == 2
assert not {"sapien", "mani_skill"} & set(sys.modules)
"""
WRONG = (
    "doctor extra", "collect", "collect x --category dor", "collect x --expert adaptiv", "collect x --seed x",
    "collect x --objects 0:99", "collect x --objects microwave_000", "collect x --late-starts 2",
    "collect x --mechanism-rules papr", "collect x --mechanism-preset paper", "collct", "replay",
    "replay x --episode first", "render", "check", "repair", "keyframes one", "stats", "merge one", "filter x --out",
    "split one", "view", "push datset x --repo-id a/b", "objects --category dor", "annotate --category dor",
    "calibrate x --mounting hand", "report --label", "benchmark --workers x",
    "expert --category dor", "memory x",
)  # fmt: skip


def test_help_and_wrong_options_import_nothing_heavy() -> None:
    assert {line.split()[0] for line in WRONG} >= set(COMMANDS)
    lines = [f"{name} {option}" for name in COMMANDS for option in ("--help", "--no-such-option")]
    command = [sys.executable, "-c", ASK, ",".join(HEAVY), *lines, *WRONG]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_defaults_of_keyframes_are_those_of_the_converter(tmp_path: Path) -> None:
    from lerobot_adamanip.recordings.convert import ConvertOptions

    assert KeyframesCommand((tmp_path,), tmp_path).options() == ConvertOptions()
