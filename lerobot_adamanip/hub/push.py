"""Publishing. Every step can be repeated; files that are there already are not sent again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.hub.endpoint import AGAIN, HubError, require_login, translate_hub_errors
from lerobot_adamanip.hub.staging import Digest, Staged

if TYPE_CHECKING:
    from huggingface_hub import HfApi

_OF_THE_HUB = (".gitattributes",)
"""Files that the Hub itself keeps."""


@dataclass(frozen=True)
class PushResult:
    """A published repository.

    Attributes:
        repo_id: name on the Hub.
        kind: ``dataset`` or ``model``.
        url: of the repository.
        commit: that holds the files; ``changed`` is False if they were there already.
        files, bytes: number and size of the files.
        tags: at the commit.
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
    """Creates the repository, uploads in one commit, moves the version's tag, and compares what is there then.

    All goes to the endpoint of ``api`` (``HF_ENDPOINT``) and to the stores that it names. After an interruption the
    same call resumes.

    Args:
        staged: what to publish.
        api: the Hub's client; the default one if left out.
        private: whether the repository is to be private. One that is public already is refused.
        release: name of a tag for what is published now; see `require_release_name`.

    Raises:
        HubError: nobody is logged in, the Hub is out of reach or refuses, or holds something else than was sent.
        DatasetError: a file is not what was scanned any more.
    """
    from huggingface_hub import HfApi as Client

    api = api or Client()
    require_login(api)
    staged.require_unchanged()
    with translate_hub_errors(staged.repo_id, str(api.endpoint)):
        url = api.create_repo(staged.repo_id, repo_type=staged.kind, private=private or None, exist_ok=True)
        before = _head(api, staged, private)
        _upload(api, staged)
        commit = _head(api, staged, private)
        tags = [_move_tag(api, staged, staged.version_tag, commit)] if staged.version_tag else []
        tags += [_set_release(api, staged, release, commit)] if release else []
        size = _read_back(api, staged, commit)
    return PushResult(
        staged.repo_id, staged.kind, str(url), commit, commit != before, len(staged.digests), size, tuple(tags)
    )


def _head(api: HfApi, staged: Staged, private: bool) -> str:
    """Returns the newest commit; raises `HubError` if a private push meets a public repository."""
    info = api.repo_info(staged.repo_id, repo_type=staged.kind, revision="main")
    if private and not info.private:
        raise HubError(
            "This repository is public already.",
            got=f"--private for {staged.repo_id}",
            allowed="a private repository, or a new one",
            hint="make it private on its settings page, or another --repo-id",
        )
    return str(info.sha)


def _upload(api: HfApi, staged: Staged) -> None:
    api.upload_folder(
        repo_id=staged.repo_id,
        repo_type=staged.kind,
        folder_path=staged.folder,
        commit_message=f"adamanip push {staged.kind}",
        delete_patterns=[f"{folder}*" for folder in staged.replaced] or None,
    )


def _tags(api: HfApi, staged: Staged) -> dict[str, str]:
    refs = api.list_repo_refs(staged.repo_id, repo_type=staged.kind)
    return {tag.name: tag.target_commit for tag in refs.tags}


def _move_tag(api: HfApi, staged: Staged, tag: str, commit: str) -> str:
    """Deletes the tag and sets it anew: the Hub moves none. After a cut between the two, the next call sets it."""
    known = _tags(api, staged).get(tag)
    if known != commit:
        if known is not None:
            api.delete_tag(staged.repo_id, tag=tag, repo_type=staged.kind)
        api.create_tag(staged.repo_id, tag=tag, revision=commit, repo_type=staged.kind)
    return tag


def _set_release(api: HfApi, staged: Staged, tag: str, commit: str) -> str:
    known = _tags(api, staged).get(tag)
    if known not in (None, commit):
        raise HubError(
            "This release is of another commit; releases stay where they are.",
            got=f"{tag} is at {known}, what is published now at {commit}",
            allowed="a tag that is new",
            hint="another --release; what was sent stays there, untagged",
        )
    if known is None:
        api.create_tag(staged.repo_id, tag=tag, revision=commit, repo_type=staged.kind)
    return tag


def _read_back(api: HfApi, staged: Staged, commit: str) -> int:
    """Compares the commit with the staged files, and the tag with the commit; returns the bytes of all files."""
    entries = api.list_repo_tree(staged.repo_id, repo_type=staged.kind, revision=commit, recursive=True)
    remote = {entry.path: entry for entry in entries if hasattr(entry, "blob_id")}
    local = staged.digests
    wrong = [name for name, digest in local.items() if name not in remote or not _equal(remote[name], digest)]
    stale = set(remote) - set(local) - set(_OF_THE_HUB)
    wrong += sorted(name for name in stale if name.startswith(staged.replaced or ("\0",)))
    if staged.version_tag and _tags(api, staged).get(staged.version_tag) != commit:
        wrong.append(f"tag {staged.version_tag}")
    if wrong:
        raise HubError(
            "The Hub holds something else than was sent.",
            got=f"{staged.repo_id}: {', '.join(wrong[:5])}" + (f" and {len(wrong) - 5} more" if wrong[5:] else ""),
            allowed="the same files, of the same content",
            hint=AGAIN,
        )
    return sum(digest.size for digest in local.values())


def _equal(entry: Any, digest: Digest) -> bool:
    same = str(entry.blob_id) == digest.git if entry.lfs is None else str(entry.lfs.sha256) == digest.sha256
    return same and entry.size == digest.size
