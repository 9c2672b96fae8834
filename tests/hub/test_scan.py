"""Nothing of somebody's machine is published: found wherever it may hide, and nothing else is."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_adamanip.collection.trained_policy import TrainedPolicy
from lerobot_adamanip.hub.portable_config import shareable
from lerobot_adamanip.hub.scan import Names, require_clean, scan
from lerobot_adamanip.hub.staging import stage_dataset, stage_model
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]
ME = Names(user=("wanda",), host=("quokka-ws4",), folders=("/srv/fast/wanda7",))


def parquet(
    path: Path, value: object = "fine", metadata: Mapping[str, str] | None = None, name: str = "column"
) -> None:
    table = pa.table({name: [value], "numbers": [1.0]})
    pq.write_table(table.replace_schema_metadata(metadata), path)


HIDING = {
    "a path in JSON": ("a.json", b'{"root": "/home/x/demos"}', "path"),
    "a path of Windows": ("a.json", rb'{"root": "C:\\Users\\x"}', "path"),
    "a folder of mine": ("a.txt", b"see /srv/fast/wanda7", "path"),
    "my name": ("README.md", b"by wanda.", "user"),
    "my machine": ("log.jsonl", b'{"host": "quokka-ws4"}', "host"),
    "a column of text": ("a.parquet", lambda p: parquet(p, "/home/x/demos"), "path"),
    "a column of lists": ("a.parquet", lambda p: parquet(p, ["fine", "wanda"]), "user"),
    "a column of structures": ("a.parquet", lambda p: parquet(p, {"from": {"host": "quokka-ws4"}}), "host"),
    "a column of bytes": ("a.parquet", lambda p: parquet(p, b"/home/x/picture.png"), "path"),
    "a column's name": ("a.parquet", lambda p: parquet(p, name="of wanda"), "user"),
    "Parquet's metadata": ("a.parquet", lambda p: parquet(p, metadata={"made": "/Users/x/demos"}), "path"),
    "a header of weights": ("a.safetensors", b"\0\1{'from': '/home/x/run/'}\0\xff", "path"),
    "a video": ("a.mp4", b"\0\xff\1comment quokka-ws4\0", "host"),
    "an address": ("a.jsonl", b"pid: 4242 namespace: ns-abc ip: 10.20.30.40", "address"),
    "an address in a video": ("a.mp4", b"\0\xffrecorded on 192.168.17.4, camera 2\0", "address"),
    "a public address": ("a.json", b'{"server": "tcp://52.19.3.77"}', "address"),
    "an address with a port": ("a.json", b'"52.19.3.77:6379"', "address"),
    "an address of IPv6": ("a.txt", b"[fe80::1ff:fe23:4567:890a]:6379", "address"),
    "a private address of IPv6": ("a.parquet", lambda p: parquet(p, "on fd00::7"), "address"),
    "an e-mail address": ("a.yaml", b"by: someone.else@lab-x.edu", "e-mail"),
    "a host of a cloud": ("a.log.txt", b"died on ip-10-20-30-40.ec2.internal", "host"),
    "a host of a network": ("a.md", b"trained on gpu-03.local", "host"),
    "a host by its key": ("a.json", b'{"hostname": "platypus"}', "host"),
    "a file's name": ("wanda.json", b"{}", "user"),
    "a table's name": ("wanda.parquet", parquet, "user"),
    "a picture's name": ("wanda.png", b"\x89PNG", "user"),
    "an address in a video's name": ("of someone.else@lab-x.edu.mp4", b"\0", "e-mail"),
}


LETTERS = "aB3dE5gH7jK9mN1pQ2rS4tU6vW8xY0zAbCdEfGhIjKlMnOpQrStUvWxYz"
HEX = "0123456789abcdef" * 4
JWT = ".".join(
    base64.urlsafe_b64encode(part).decode().rstrip("=") for part in (b'{"alg":"HS256"}', b'{"sub":"1"}', b"x" * 32)
)
SECRETS = (
    "hf_" + LETTERS[:34],
    "sk-" + "proj-" + LETTERS[:40],
    "sk-" + "ant-api03-" + LETTERS,
    "gh" + "p_" + LETTERS[:36],
    "github" + "_pat_" + LETTERS[:30],
    "glpat" + "-" + LETTERS[:20],
    "AK" + "IAIOSFODNN7EXAMPLE",
    "AI" + "za" + LETTERS[:35],
    "nvapi" + "-" + LETTERS[:40],
    "r8_" + LETTERS[:37],
    "xoxb" + "-123456789012-abcdefghij",
    "sk" + "_live_" + LETTERS[:24],
    "SG." + LETTERS[:22] + "." + LETTERS[:43],
    JWT,
    "-----BEGIN " + "OPENSSH PRIVATE KEY-----",
    "-----BEGIN " + "PRIVATE KEY-----",
    "wandb" + "_v1_" + LETTERS[:40],
    '{"wandb_key": "' + HEX[:40] + '"}',
    "WANDB_API_KEY=" + HEX[:40],
    "machine api.wandb.ai login user password " + HEX[:40],
    "https://" + "someone:pa55w0rd@git.company.com/x.git",
    "postgres://" + "me:secret@db/x",
    '{"api_key": "' + LETTERS[:24] + '"}',
    "--policy.password=" + LETTERS[:12],
    "AccountKey=" + LETTERS[:40] + LETTERS[:46] + "==",
)
"""Put together here, so that no scanner takes this file for a leak."""
FOLDERS = (
    "home", "root", "Users", "Volumes/disk", "private/var", "tmp", "opt", "srv", "mnt", "media", "data", "scratch",
    "nfs", "gpfs", "lustre", "work", "workspace", "content", "kaggle", "shared", "storage", "var", "lab42",
)  # fmt: skip
WINDOWS = (r"C:\Users\x", r"C:\\Users\\x", "D:/robots/x", r"\\\\server\\share")


@pytest.mark.parametrize("secret", SECRETS)
@pytest.mark.parametrize("file", ["a.json", "a.parquet", "a.safetensors"])
def test_a_secret_is_found_and_not_shown(tmp_path: Path, file: str, secret: str, refuses: Refuses) -> None:
    if file == "a.parquet":
        parquet(tmp_path / file, f"before {secret} after")
    else:
        (tmp_path / file).write_bytes(f"\0\1 before it {secret} after it \0".encode())
    files = {file: tmp_path / file}
    message = refuses(DatasetError, lambda: require_clean(files, ME))
    assert "secrets" in message
    assert "pa55w0rd" not in message
    assert not any(secret[start : start + 12] in message for start in range(len(secret) - 11))
    assert all(finding.kind not in ("user", "host", "address", "path") for finding in scan(files, ME))


@pytest.mark.parametrize("path", [f"/{folder}/x/demos" for folder in FOLDERS] + list(WINDOWS))
@pytest.mark.parametrize("text", ['{{"root": "{}"}}', "--dataset.root={} --seed=1", "'{}'"])
def test_a_path_of_any_machine_is_found(tmp_path: Path, text: str, path: str) -> None:
    (tmp_path / "a.json").write_text(text.format(path))
    assert {finding.kind for finding in scan({"a.json": tmp_path / "a.json"}, ME)} == {"path"}


@pytest.mark.parametrize("name", HIDING)
def test_it_is_found_wherever_it_hides(tmp_path: Path, name: str, refuses: Refuses) -> None:
    file, content, kind = HIDING[name]
    if isinstance(content, bytes):
        (tmp_path / file).write_bytes(content)
    else:
        content(tmp_path / file)
    files = {file: tmp_path / file}
    assert {finding.kind for finding in scan(files, ME)} == {kind}
    assert file in refuses(DatasetError, lambda: require_clean(files, ME))


@pytest.mark.parametrize(
    "text",
    [
        "meta/data/file",
        "https://host.org/home/page/",
        "data/*/*.parquet",
        '{"a":"b\\n"}',
        "Wandas",
        "the root of data",
        "outputs/data/x, ./data/x, ~/data/x, $HOME/some/x, ${HOME}/some/x, **/data/*, </data/>, and/or, (x)/opt/y",
        '{"device": "/dev/video0", "driver": "/usr/share/vulkan/icd.d/x.json", "proc": "/proc/self/fd"}',
        "revision 0123456789abcdef0123456789abcdef01234567, sha256 " + "0123456789abcdef" * 4,
        '{"pad_token": "<pad>", "token": null, "password": null, "api_key": "", "keys": ["state"], "private": false}',
        "export HF_TOKEN=YOUR_TOKEN; WANDB_API_KEY=$WANDB_API_KEY; sk-learn, task-space-control-with-4-fingers",
        "key: int, https://host:8080/x, a:b@c, eyJ.x.y, user: password, BEGIN CERTIFICATE",
        "a/tmp/b",
        "torch 2.11.0, embreex 4.4.0.post1, nvidia-cublas-cu12==12.4.5.8, nvidia-curand-cu12==10.3.5.147",
        "cuDNN 9.1.0.70, driver version 10.2.0.3, libtiff-10.1.2.3, v10.0.0.1",
        "http://127.0.0.1:8000, 0.0.0.0, ::1, 192.0.2.7, localhost",
        "12:34:56, 1:2:3:4, std::vector, rows[1::2], a::b, 00:1b:44:11:3a:b7",
        "@inproceedings{wang2025adamanip}, git@github.com:a/b.git, you@example.com, p@q",
        "threading.local(), torch.internal, https://www.videolan.org/x264.html",
        '{"hostname": null}, hostname: 12',
        "999.1.1.1, 1.2.3, 1.2.3.4.5",
    ],
)
def test_what_tells_of_no_machine_is_no_finding(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.md").write_text(text)
    names = Names(user=("wanda", "root", "panda", "ab"), host=("localhost",), folders=())
    assert scan({"a.md": tmp_path / "a.md"}, names) == []


def test_a_user_may_publish_under_the_own_name(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("lerobot-train --dataset.repo_id=wanda/safes")
    assert scan({"a.md": tmp_path / "a.md"}, ME, owner="wanda") == []
    assert [each.kind for each in scan({"a.md": tmp_path / "a.md"}, ME, owner="other")] == ["user"]


def test_a_dataset_that_names_a_machine_is_not_published(published: Path, tmp_path: Path, refuses: Refuses) -> None:
    mine = shutil.copytree(published, tmp_path / "mine")
    (path,) = (mine / "meta" / "episodes").rglob("*.parquet")
    table = pq.read_table(path)
    pq.write_table(table.append_column("source", pa.array([str(Path("/home/x/raw"))] * table.num_rows)), path)
    (tmp_path / "staged").mkdir()
    message = refuses(DatasetError, lambda: stage_dataset(mine, "someone/safes", tmp_path / "staged"))
    assert "meta/episodes" in message
    assert "/home/x/raw" in message


def test_a_trainings_configuration_is_published_without_its_paths(
    trained: Path, published: Path, tmp_path: Path
) -> None:
    assert str(published) in (trained / "train_config.json").read_text()
    (tmp_path / "staged").mkdir()
    staged = stage_model(trained, "someone/policy", tmp_path / "staged", dataset="someone/safes")
    told = json.loads((staged.folder / "train_config.json").read_text())
    assert (told["dataset"]["root"], told["output_dir"], told["dataset"]["repo_id"]) == (None, None, "someone/safes")
    assert str(published) in (trained / "train_config.json").read_text()  # the checkpoint stays as it was
    assert staged.files().keys() >= {"model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"}


@pytest.mark.parametrize("path", ["someone/policy", "FOLDER", "a/b/c", None, "outputs/train", "./train", "../train"])
def test_where_a_policy_came_from_is_told_if_it_is_on_the_hub(path: str | None, tmp_path: Path) -> None:
    told = path if path == "someone/policy" else None
    path = str(tmp_path) if path == "FOLDER" else path
    assert shareable({"pretrained_path": path})["pretrained_path"] == told
    assert shareable({"policy": {"pretrained_path": path}})["policy"]["pretrained_path"] == told


@pytest.mark.parametrize(("tracker", "name"), [("wandb", "entity"), ("trackio", "space_id")])
def test_the_trainers_account_is_not_told(tracker: str, name: str) -> None:
    assert shareable({tracker: {"project": "safes", name: "me"}}) == {tracker: {"project": "safes", name: None}}


@pytest.mark.parametrize("lost", ["model.safetensors", "policy_postprocessor.json", "train_config.json"])
def test_a_checkpoint_that_lacks_something_is_one_clear_error(
    trained: Path, tmp_path: Path, refuses: Refuses, lost: str
) -> None:
    mine = shutil.copytree(trained, tmp_path / "mine")
    (mine / lost).unlink()
    assert f"no {lost}" in refuses(DatasetError, lambda: stage_model(mine, "a/policy", tmp_path / "staged"))


FEATURE = {"type": "STATE", "shape": [3]}


@pytest.mark.parametrize(
    ("name", "changes", "field"),
    [
        ("config.json", {"type": None}, "type"), ("config.json", {"type": "x`\n\n<script>alert(1)</script>"}, "type"),
        ("config.json", {"tags": "abc"}, "tags"), ("config.json", {"tags": [1]}, "tags[0]"),
        ("config.json", {"license": [1]}, "license"), ("config.json", {"preset": "a|<b>"}, "preset"),
        ("config.json", {"input_features": [FEATURE]}, "input_features"),
        ("config.json", {"input_features": {"a|b": FEATURE}}, "input_features"),
        ("config.json", {"output_features": {"action": {"type": "ACTION"}}}, "output_features.action.shape"),
        ("train_config.json", {"env": "safe"}, "env"), ("train_config.json", {"env": {"memory": "```"}}, "env.memory"),
        ("train_config.json", {"dataset": [1]}, "dataset"), ("train_config.json", {"steps": {}}, "steps"),
    ],
    ids=str,
)  # fmt: skip
def test_a_checkpoint_whose_card_would_be_wrong_is_one_clear_error(
    trained: Path, tmp_path: Path, refuses: Refuses, *, name: str, changes: dict[str, Any], field: str
) -> None:
    mine = shutil.copytree(trained, tmp_path / "mine")
    content = json.loads((mine / name).read_text())
    (mine / name).write_text(json.dumps({**content, **changes}))
    assert f"{name}.{field} is" in refuses(DatasetError, lambda: stage_model(mine, "a/policy", tmp_path / "staged"))


def test_a_checkpoint_whose_pipeline_names_a_function_to_call_is_refused(
    trained: Path, tmp_path: Path, refuses: Refuses
) -> None:
    mine = shutil.copytree(trained, tmp_path / "mine")
    step = {"class": "os.system", "config": {"command": f"touch {tmp_path / 'ran'}"}}
    (mine / "policy_postprocessor.json").write_text(json.dumps({"name": "x", "steps": [step]}))
    assert "os.system" in refuses(DatasetError, lambda: stage_model(mine, "a/policy", tmp_path / "staged"))
    assert "os.system" in refuses(ConfigurationError, lambda: TrainedPolicy(mine))
    assert not (tmp_path / "ran").exists()


def test_a_checkpoint_that_is_cut_or_names_a_path_is_one_clear_error(
    trained: Path, tmp_path: Path, refuses: Refuses
) -> None:
    mine = shutil.copytree(trained, tmp_path / "mine")
    told = json.loads((mine / "train_config.json").read_text())
    (mine / "train_config.json").write_text(json.dumps({**told, "job_name": "of /home/x/run"}))
    (tmp_path / "staged").mkdir()
    assert "train_config.json" in refuses(DatasetError, lambda: stage_model(mine, "a/policy", tmp_path / "staged"))
    (state,) = mine.glob("policy_preprocessor*.safetensors")
    state.write_bytes(state.read_bytes()[:-3])
    assert state.name in refuses(DatasetError, lambda: stage_model(mine, "a/policy", tmp_path / "again"))
