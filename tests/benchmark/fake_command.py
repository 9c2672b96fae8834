"""Stands in for `adamanip collect`, `lerobot-train` and `lerobot-eval`: writes what they write, in the order in which
they do, and may be killed anywhere. Run by `benchmark_helpers.FakeRunner`, with nothing installed.

    python fake_command.py TEMPLATES COMMAND --NAME=VALUE ...
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import time
import uuid
from pathlib import Path
from typing import Any

PAUSE, DIE = float(os.environ.get("FAKE_PAUSE", "0")), os.environ.get("FAKE_DIE", "")
"""Seconds between moments; ``train:3``: at the third moment of a training, this process and its parent are killed."""
POSE_NAMES = ["ee.x.pos", "ee.y.pos", "ee.z.pos", *(f"ee.r6d_{i}.pos" for i in range(6)), "gripper.pos"]
KIND = ""
_passed = 0


def moment() -> None:
    """A moment at which it may be killed."""
    global _passed  # noqa: PLW0603
    _passed += 1
    time.sleep(PAUSE)
    if f"{KIND}:{_passed}" == DIE:
        os.kill(os.getppid(), signal.SIGKILL)
        os._exit(9)


def digest(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def collect(root: Path, options: dict[str, str]) -> int:
    """One file an episode beside the dataset, which takes its place when it is whole."""
    if (root / "meta" / "collection.json").exists():
        return 0
    partial = root.with_name(f"{root.name}.partial")
    partial.mkdir(parents=True, exist_ok=True)
    decides = sorted((name, value) for name, value in options.items() if name not in ("--workers", "--cluster"))
    for slot in range(int(options["--episodes-per-object"])):
        path = partial / str(slot)
        if not path.exists():
            moment()
            path.with_suffix(".tmp").write_text(digest(decides, slot))
            path.with_suffix(".tmp").rename(path)
    (partial / "meta").mkdir(exist_ok=True)
    action = {"dtype": "float32", "shape": [len(POSE_NAMES)], "names": POSE_NAMES}
    info = {
        "codebase_version": "v3.0",
        "total_episodes": 1,
        "total_frames": 2,
        "fps": 4,
        "features": {"action": action},
    }
    (partial / "meta" / "info.json").write_text(json.dumps(info))
    (partial / "meta" / "stats.json").write_text(json.dumps({"action": {"min": [0.25] * 10, "max": [0.5] * 10}}))
    moment()
    (partial / "meta" / "collection.json").write_text("{}")
    moment()
    partial.rename(root)
    return 0


def merge(parts: list[str], options: dict[str, str]) -> int:
    """One file that follows from those of all parts."""
    root = Path(options["--out"])
    partial = root.with_name(f"{root.name}.partial")
    (partial / "meta").mkdir(parents=True, exist_ok=True)
    (partial / "0").write_text(digest([dataset_files(Path(part)) for part in parts]))
    for name in ("info.json", "stats.json", "collection.json"):
        (partial / "meta" / name).write_text((Path(parts[0]) / "meta" / name).read_text())
    moment()
    partial.rename(root)
    return 0


def dataset_files(root: Path) -> list[str]:
    return [path.read_text() for path in sorted(root.iterdir()) if path.is_file()]


def dataset_digest(root: Path) -> str:
    assert (root / "meta" / "collection.json").exists(), "a training on half a dataset"
    ranges = json.loads((root / "meta" / "stats.json").read_text())["action"]
    assert ranges == {"min": [0.25] * 3 + [-1.0] * 7, "max": [0.5] * 3 + [1.0] * 7}, "rotation and gripper are scaled"
    return digest(dataset_files(root))


def train(options: dict[str, str]) -> int:
    """A chain of hashes: every step follows from the one before, so a training that resumes wrongly ends otherwise."""
    if options.get("--resume") == "true":
        weights = Path(options["--config_path"]).parent
        saved = json.loads((weights / "train_config.json").read_text()) | {"--steps": options["--steps"]}
        step = json.loads((weights.parent / "training_state" / "training_step.json").read_text())["step"]
        return steps(saved, step, (weights / "model").read_text())
    if Path(options["--output_dir"]).exists():
        print("FileExistsError: the output directory exists")
        return 1
    data = dataset_digest(Path(options["--dataset.root"]))
    decides = sorted((name, value) for name, value in options.items() if name not in ("--save_freq", "--log_freq"))
    return steps(options, 0, digest(data, decides))


def steps(options: dict[str, str], done: int, weights: str) -> int:
    wanted = int(options["--steps"])
    for step in range(done + 1, wanted + 1):
        weights = digest(weights, step)
        moment()
        if step % int(options["--save_freq"]) == 0 or step == wanted:
            save(options, step, weights)
    return 0


def save(options: dict[str, str], step: int, weights: str) -> None:
    folder = Path(options["--output_dir"]) / "checkpoints" / f"{step:06d}"
    for path, content in (
        ("pretrained_model/model", weights),
        ("pretrained_model/train_config.json", json.dumps(options)),
        ("training_state/training_step.json", json.dumps({"step": step})),
    ):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(content)
        moment()
    last = folder.parent / "last"
    last.unlink(missing_ok=True)
    moment()
    last.symlink_to(folder.name)


def evaluate(options: dict[str, str], templates: dict[str, list[dict[str, Any]]]) -> int:
    """Episodes of whole batches, appended to a log."""
    weights = (Path(options["--policy.path"]) / "model").read_text() if "--policy.path" in options else "none"
    category = options["--env.type"].removeprefix("adamanip_")
    objects = options["--env.objects"]
    wanted, batch = int(options["--eval.n_episodes"]), int(options["--eval.batch_size"])
    log, run_id = Path(options["--env.episode_log"]), uuid.uuid4().hex[:12]
    log.parent.mkdir(parents=True, exist_ok=True)
    for number in range(-(-wanted // batch) * batch):
        moment()
        seed, drawn = int(options["--seed"]) + number, int(digest(weights, objects, number), 16)
        record = templates[category][drawn % len(templates[category])]
        where = (f"{category}_050", "unseen") if objects == "unseen" else (f"{category}_000", "seen")
        changed = {"seed": seed, "given_seed": seed, "object_id": where[0], "object_split": where[1], "run_id": run_id}
        changed |= {name: options[f"--env.{name}"] for name in ("poses", "sensing") if f"--env.{name}" in options}
        changed["max_key_frames"] = int(options.get("--env.episode_length", record["max_key_frames"]))
        key_frames = record["key_frames"] + drawn // 7 % 5
        with log.open("a") as file:
            file.write(json.dumps(record | changed | {"key_frames": key_frames}) + "\n")
    return 0


def main() -> int:
    global KIND  # noqa: PLW0603
    templates = json.loads(Path(sys.argv[1]).read_text())
    command, *words = sys.argv[2:]
    options = {word.partition("=")[0]: word.partition("=")[2] for word in words if word.startswith("--")}
    KIND = {"adamanip": "collect", "lerobot-train": "train", "lerobot-eval": "evaluate"}[command]
    if KIND == "collect":
        parts = [word for word in words[1:] if not word.startswith("--")]
        return merge(parts, options) if words[0] == "merge" else collect(Path(parts[0]), options)
    return train(options) if KIND == "train" else evaluate(options, templates)


if __name__ == "__main__":
    sys.exit(main())
