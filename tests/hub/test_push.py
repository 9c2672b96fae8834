"""Publishing to a Hub on loopback: complete, in one commit, again, after every kind of cut, and one error each."""

from __future__ import annotations

import errno
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hub_store import is_lfs
from huggingface_hub import HfApi
from loopback_hub import TOKEN, Cut, LoopbackHub

from lerobot_adamanip.datasets.repository_names import require_hub_name, require_release_name
from lerobot_adamanip.hub.endpoint import HubError
from lerobot_adamanip.hub.push import push
from lerobot_adamanip.hub.staging import Staged, stage_dataset, stage_model
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]
NAME = "someone/safes"


def content(staged: Staged) -> dict[str, bytes]:
    return {name: path.read_bytes() for name, path in staged.files().items()}


def changed(staged: Staged, name: str, more: bytes) -> Staged:
    """Changes a staged file, not what it is a link to, as if it had been so when it was scanned."""
    path = staged.folder / name
    old = path.read_bytes()
    path.unlink()
    path.write_bytes(old + more)
    return staged.sealed()


def test_what_changed_after_it_was_scanned_is_not_published(
    staged: Staged, hub: LoopbackHub, api: HfApi, refuses: Refuses
) -> None:
    def write(line: str) -> None:
        if re.match(r"POST .*/preupload", line):
            changed(staged, "meta/cameras.json", b" ")

    hub.on_request = write
    assert "meta/cameras.json" in refuses(DatasetError, lambda: push(staged, api))  # it changed while it was sent
    assert not hub.repositories["datasets", NAME].tags  # and no version names it
    hub.repositories.clear()
    assert "meta/cameras.json" in refuses(DatasetError, lambda: push(staged, api))
    assert not hub.repositories


def test_what_links_lead_to_is_scanned_and_published(
    published: Path, hub: LoopbackHub, api: HfApi, refuses: Refuses, tmp_path: Path
) -> None:
    """A dataset whose pictures and clouds lie on another disk, under a name that is a link itself."""
    away, root = tmp_path / "disk", tmp_path / "named"
    shutil.copytree(published, away / "dataset")
    for name in ("data", "videos"):
        shutil.move(away / "dataset" / name, away / name)
        (away / "dataset" / name).symlink_to(away / name)
    root.symlink_to(away / "dataset")
    (tmp_path / "staged").mkdir()
    staged = stage_dataset(root, NAME, tmp_path / "staged")
    names = {str(path.relative_to(published)) for path in published.rglob("*") if path.is_file()}
    assert set(staged.files()) == names
    push(staged, api)
    assert set(hub.files("datasets", NAME)) == names

    (away / "note.json").write_text('{"host": "of 10.20.30.40"}')
    (away / "dataset" / "meta" / "note.json").symlink_to(away / "note.json")
    (tmp_path / "again").mkdir()
    assert "10.20.30.40" in refuses(DatasetError, lambda: stage_dataset(root, NAME, tmp_path / "again"))


def test_a_model_leaves_no_file_of_the_one_before(trained: Path, hub: LoopbackHub, api: HfApi, tmp_path: Path) -> None:
    name, staged = "someone/policy", {}
    for number in ("one", "two"):
        (tmp_path / number).mkdir()
        staged[number] = stage_model(trained, name, tmp_path / number)
    (tmp_path / "one" / "policy_preprocessor_step_9_old.safetensors").write_bytes(b"old")
    (tmp_path / "one" / "notes.md").write_text("kept: no file of a checkpoint")
    push(staged["one"].sealed(), api)
    push(staged["two"], api)
    assert set(hub.files("models", name)) == {*staged["two"].files(), "notes.md"}


def test_the_hub_holds_what_was_sent_in_one_commit_and_again_sends_nothing(
    published: Path, staged: Staged, hub: LoopbackHub, api: HfApi
) -> None:
    result = push(staged, api)
    remote = hub.files("datasets", NAME)
    assert remote == content(staged)
    assert {name for name in remote if name != "README.md"} == {
        str(path.relative_to(published)) for path in published.rglob("*") if path.is_file() and path.name != "README.md"
    }
    assert hub.count(r"POST .*/commit/") == 1
    assert hub.count(r"POST /api/validate-yaml")
    assert f'LeRobotDataset("{NAME}")' in remote["README.md"].decode()
    repository = hub.repositories["datasets", NAME]
    assert repository.tags == {"v3.0": repository.branches["main"]} == {"v3.0": result.commit}
    assert (result.changed, result.files) == (True, len(remote))
    assert result.bytes == sum(map(len, remote.values()))
    assert not repository.private

    hub.requests.clear()
    assert push(staged, api) == replace(result, changed=False)
    assert hub.count(r"^PUT|/commit/|/tag/") == 0
    assert sum(request.sent for request in hub.requests) < 30_000  # samples of 512 bytes, and the card for its check


def test_what_changed_is_sent_alone_and_what_is_gone_is_removed(staged: Staged, hub: LoopbackHub, api: HfApi) -> None:
    push(staged, api)
    first = hub.repositories["datasets", NAME].tags["v3.0"]
    changed(staged, "meta/tasks.parquet", b"more")
    (staged.folder / "meta" / "cameras.json").unlink()
    staged = staged.sealed()
    hub.requests.clear()
    result = push(staged, api)
    assert hub.count("^PUT") == 1
    assert hub.files("datasets", NAME) == content(staged)
    assert hub.repositories["datasets", NAME].tags["v3.0"] == result.commit != first
    assert "meta/cameras.json" in hub.files("datasets", NAME, first)  # history keeps it


CUTS = {
    "in the first file": (Cut("^PUT"), False),
    "in the second file": (Cut("^PUT", after=2), False),
    "in a file's confirmation": (Cut("POST /lfs-verify"), False),
    "at the commit": (Cut("/commit/"), False),
    "before the tag is deleted": (Cut("DELETE .*/tag/"), True),
    "between deleting and setting the tag": (Cut("POST .*/tag/"), True),
}


@pytest.mark.parametrize("name", CUTS)
def test_a_cut_is_healed_by_doing_it_again(
    staged: Staged, hub: LoopbackHub, api: HfApi, refuses: Refuses, name: str
) -> None:
    cut, later = CUTS[name]
    if later:  # there is a tag to be moved
        push(staged, api)
        staged = changed(staged, "meta/tasks.parquet", b"more")
    hub.cut = replace(cut)
    assert "again" in refuses(HubError, lambda: push(staged, api))
    repository = hub.repositories["datasets", NAME]
    if "setting" in name:
        assert repository.tags == {}  # what LeRobot cannot load
    hub.cut = None
    kept, began = set(hub.stored), len(hub.requests)
    result = push(staged, api)
    assert hub.files("datasets", NAME) == content(staged)
    assert repository.tags == {"v3.0": result.commit} == {"v3.0": repository.branches["main"]}
    sent_again = {request.path.rpartition("/")[2] for request in hub.requests[began:] if request.method == "PUT"}
    assert not sent_again & kept
    if "second" in name:
        assert kept
    if name == "in the first file":
        assert len(sent_again) == sum(map(is_lfs, staged.files()))


def test_private_is_private_and_never_public_by_accident(
    staged: Staged, hub: LoopbackHub, api: HfApi, refuses: Refuses
) -> None:
    push(staged, api, private=True)
    assert hub.repositories["datasets", NAME].private
    other = replace(staged, repo_id="someone/other")
    api.create_repo("someone/other", repo_type="dataset")
    assert "public" in refuses(HubError, lambda: push(other, api, private=True))
    assert hub.files("datasets", "someone/other") == {}


def test_a_release_is_tagged_once_and_stays(staged: Staged, hub: LoopbackHub, api: HfApi, refuses: Refuses) -> None:
    first = push(staged, api, release="release-1")
    assert first.tags == ("release-1", "v3.0")
    assert push(staged, api, release="release-1").commit == first.commit
    staged = changed(staged, "meta/tasks.parquet", b"more")
    assert "release-1" in refuses(HubError, lambda: push(staged, api, release="release-1"))
    tags = hub.repositories["datasets", NAME].tags
    assert tags == {"release-1": first.commit, "v3.0": first.commit}  # no version moves to what was refused
    second = push(staged, api, release="release-2")
    changed(staged, "meta/tasks.parquet", b"even more")
    sent = len(hub.files("datasets", NAME)["meta/tasks.parquet"])
    assert "release-1" in refuses(HubError, lambda: push(staged.sealed(), api, release="release-1"))
    assert len(hub.files("datasets", NAME)["meta/tasks.parquet"]) == sent  # a known tag is refused before the upload
    assert tags["v3.0"] == second.commit


def test_small_files_are_copied_before_they_are_scanned(published: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    shutil.copytree(published, source)
    (tmp_path / "staged").mkdir()
    staged = stage_dataset(source, NAME, tmp_path / "staged")
    (source / "meta" / "info.json").write_text("{}")
    staged.require_unchanged()


def test_a_full_disk_is_no_fault_of_the_hub(staged: Staged, api: HfApi, hub: LoopbackHub) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    api.upload_folder = full  # type: ignore[method-assign]
    with pytest.raises(OSError, match="No space left") as raised:
        push(staged, api)
    assert not isinstance(raised.value, HubError)


@pytest.mark.parametrize("tag", ["1.0", "v3.1", "2026.11", "3", "main", "a b", ""])
def test_release_tags_never_parse_as_versions(refuses: Refuses, tag: str) -> None:
    refuses(ConfigurationError, lambda: require_release_name(tag))


@pytest.mark.parametrize(
    "name", [None, "safes", "local/safes", "someone/", "someone/a/b", "someone/a b", "some--one/-"]
)
def test_publishing_needs_a_name_on_the_hub(refuses: Refuses, name: str | None) -> None:
    refuses(ConfigurationError, lambda: require_hub_name(name))


def test_what_the_hub_refuses_is_one_clear_error(
    staged: Staged, hub: LoopbackHub, online: None, refuses: Refuses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HF_TOKEN", raising=False)
    assert "hf auth login" in refuses(HubError, lambda: push(staged, HfApi(endpoint=hub.url)))
    assert hub.requests == []  # without a token nothing is asked for
    foreign = replace(staged, repo_id="nobody/safes")
    for what, endpoint, token, texts in (
        (staged, hub.url, "hf_wrong", ["login"]),
        (foreign, hub.url, TOKEN, ["does not let this login write"]),
        (staged, "http://127.0.0.1:9", TOKEN, ["cannot be reached", "http://127.0.0.1:9"]),
    ):
        message = refuses(HubError, lambda: push(what, HfApi(endpoint=endpoint, token=token)))  # noqa: B023
        assert all(text in message for text in texts)


def test_offline_is_one_clear_error(staged: Staged, refuses: Refuses) -> None:
    assert "HF_HUB_OFFLINE" in refuses(HubError, lambda: push(staged, HfApi(token=TOKEN)))


def test_an_unfinished_or_damaged_dataset_is_one_clear_error(published: Path, tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "safes.partial" / "episodes").mkdir(parents=True)
    broken = shutil.copytree(published, tmp_path / "broken")
    (video,) = broken.rglob("*.mp4")
    video.write_bytes(video.read_bytes()[:-400])
    (tmp_path / "staged").mkdir()
    for root, word in ((tmp_path / "safes", "not finished"), (broken, "damaged")):
        assert word in refuses(DatasetError, lambda: stage_dataset(root, NAME, tmp_path / "staged"))  # noqa: B023
