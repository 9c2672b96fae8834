"""Publishes staged files. Every step can be repeated. Files already on the Hub are not sent again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.hub.endpoint import HubError, require_login, translate_hub_errors
from lerobot_adamanip.hub.staging import Staged

if TYPE_CHECKING:
    from huggingface_hub import HfApi


@dataclass(frozen=True)
class PushResult:
    """Result of publishing a repository.

    Attributes:
        repo_id: name on the Hub.
        kind: ``dataset`` or ``model``.
        url: URL of the repository.
        commit: hash of the commit with the files.
        changed: False if the Hub already had the files.
        files: number of files.
        bytes: total size of the files.
        tags: tags at the commit.
    """

    repo_id: str
    kind: str
    url: str
    commit: str
    changed: bool
    files: int
    bytes: int
    tags: tuple[str, ...]


def push(staged: Staged, api: HfApi | None = None, *, private: bool = False, release: str | None = None) -> PushResult:
    """Creates the repository, uploads in one commit, and moves the version tag.

    It connects only to the endpoint of ``api`` (``HF_ENDPOINT``) and the stores that the endpoint names. After an
    interruption, the same call resumes.

    Args:
        staged: files to publish.
        api: client of the Hub; None for the default one.
        private: whether to create a private repository. An existing public one is refused.
        release: tag of this publication; see `require_release_name`.

    Raises:
        HubError: not logged in, or the Hub is unreachable or refuses.
        DatasetError: a file has changed since the scan, before or during the upload.
    """
    from huggingface_hub import HfApi as Client

    api = api or Client()
    require_login(api)
    staged.require_unchanged()
    with translate_hub_errors(staged.repo_id, str(api.endpoint)):
        url = api.create_repo(staged.repo_id, repo_type=staged.kind, private=private or None, exist_ok=True)
        before = _head(api, staged, private)
        if release and (known := _tag_commit(api, staged, release)) not in (None, before):
            raise _release_stays(release, f"{release} is at {known}, the newest commit is {before}")
        api.upload_folder(
            repo_id=staged.repo_id,
            repo_type=staged.kind,
            folder_path=staged.folder,
            commit_message=f"adamanip push {staged.kind}",
            delete_patterns=[f"{folder}*" for folder in staged.replaced] or None,
        )
        staged.require_unchanged()  # before a tag names what was not scanned
        commit = _head(api, staged, private)
        tags = tuple(tag for tag in (release, staged.version_tag) if tag)
        for tag in tags:
            _set_tag(api, staged, tag, commit, movable=tag == staged.version_tag)
    sizes = [path.stat().st_size for path in staged.files().values()]
    return PushResult(staged.repo_id, staged.kind, str(url), commit, commit != before, len(sizes), sum(sizes), tags)


def _head(api: HfApi, staged: Staged, private: bool) -> str:
    """Returns the newest commit. Raises `HubError` for a private push to a public repository."""
    info = api.repo_info(staged.repo_id, repo_type=staged.kind, revision="main")
    if private and not info.private:
        raise HubError(
            "This repository is already public.",
            got=f"--private for {staged.repo_id}",
            allowed="a private repository, or a new one",
            hint="make it private on its settings page, or another --repo-id",
        )
    return str(info.sha)


def _tag_commit(api: HfApi, staged: Staged, tag: str) -> str | None:
    refs = api.list_repo_refs(staged.repo_id, repo_type=staged.kind)
    return next((each.target_commit for each in refs.tags if each.name == tag), None)


def _set_tag(api: HfApi, staged: Staged, tag: str, commit: str, *, movable: bool) -> None:
    """Sets a tag after deleting the old one. After an interruption in between, the next call sets it."""
    known = _tag_commit(api, staged, tag)
    if known == commit:
        return
    if known is not None and not movable:
        raise _release_stays(tag, f"{tag} is at {known}, the published files are at {commit} of main, untagged")
    if known is not None:
        api.delete_tag(staged.repo_id, tag=tag, repo_type=staged.kind)
    api.create_tag(staged.repo_id, tag=tag, revision=commit, repo_type=staged.kind)


def _release_stays(tag: str, got: str) -> HubError:
    what = "This release tag is at another commit; releases are not moved."
    return HubError(what, got=got, allowed="a new tag", hint=f"another --release than {tag}")
