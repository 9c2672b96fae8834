"""What a Hub answers to each request of huggingface_hub 1.33 and LeRobot 0.6.1, less Xet."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import socket
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from typing import Any, NamedTuple
from urllib.parse import parse_qs, unquote, urlsplit

import yaml
from hub_store import ProblemError, Repository, entries, git_oid, is_lfs

USER, TOKEN = "someone", "hf_loopback"
_KINDS = {"models": "", "datasets": "datasets/"}


class Request(NamedTuple):
    method: str
    path: str
    sent: int  # bytes of the body

    @property
    def line(self) -> str:
        return f"{self.method} {self.path}"


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: Any

    def log_message(self, *_: object) -> None: ...

    def do_GET(self) -> None:
        self._answer()

    do_HEAD = do_POST = do_PUT = do_DELETE = do_GET  # noqa: N815

    def _answer(self) -> None:
        parts = urlsplit(self.path)
        path, query = unquote(parts.path), parse_qs(parts.query)
        length = int(self.headers.get("Content-Length", 0))
        line = f"{self.command} {path}"
        self.hub.on_request(line)
        if self.hub.cut is not None and self.hub.cut.strikes(line):
            self.rfile.read(length // 2)
            self.hub.requests.append(Request(self.command, path, length // 2))
            self.connection.shutdown(socket.SHUT_RDWR)
            self.close_connection = True
            return
        body = self._chunks() if "chunked" in self.headers.get("Transfer-Encoding", "") else self.rfile.read(length)
        self.hub.requests.append(Request(self.command, path, len(body)))
        try:
            self._route(path, query, body)
        except ProblemError as problem:
            self._send(problem.status, problem.content, {"X-Error-Code": problem.code} if problem.code else {})

    def _chunks(self) -> bytes:
        found = b""
        while size := int(self.rfile.readline(), 16):
            found += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return found

    def _send(self, status: int, content: object, headers: dict[str, str] | None = None) -> None:
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        given = {"Content-Length": str(len(data)), "Content-Type": "application/json", **(headers or {})}
        for name, value in given.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    @property
    def _known(self) -> bool:
        return self.headers.get("Authorization") == f"Bearer {TOKEN}"

    def _repository(self, kind: str, name: str) -> Repository:
        found = self.hub.repositories.get((kind, name))
        if found is None or (found.private and not self._known):
            raise ProblemError(401 if not self._known else 404, "Repository not found", "RepoNotFound")
        return found

    def _files(self, kind: str, name: str, revision: str) -> dict[str, bytes]:
        repository = self._repository(kind, name)
        return repository.commits[repository.resolve(revision)]

    def _route(self, path: str, query: dict[str, list[str]], body: bytes) -> None:
        for pattern, call in _ROUTES:
            if (found := re.fullmatch(pattern, line := f"{self.command} {path}")) is not None:
                if self.command in ("POST", "DELETE") and call not in _OPEN and not self._known:
                    raise ProblemError(401, "Invalid username or password.")
                return call(self, query, body, *found.groups())
        raise ProblemError(404, f"this Hub does not know {line}", "EntryNotFound")

    # Accounts and repositories -------------------------------------------------------------------------------------

    def whoami(self, _query: Any, _body: bytes) -> None:
        if not self._known:
            raise ProblemError(401, "Invalid username or password.")
        self._send(200, {"type": "user", "name": USER, "fullname": USER, "orgs": [], "auth": {"type": "access_token"}})

    def create(self, _query: Any, body: bytes) -> None:
        asked = json.loads(body)
        owner, kind = asked.get("organization") or USER, f"{asked.get('type') or 'model'}s"
        if owner != USER:
            raise ProblemError(403, f"You don't have the rights to create a {kind} under the namespace {owner!r}")
        name = f"{owner}/{asked['name']}"
        url = {"url": f"{self.hub.url}/{_KINDS[kind]}{name}"}
        if (kind, name) in self.hub.repositories:
            raise ProblemError(409, "You already created this repo", **url)
        made = Repository(asked.get("visibility") == "private")
        made.commit("main", {".gitattributes": b"*.parquet filter=lfs\n"})
        self.hub.repositories[kind, name] = made
        self._send(200, url)

    def validate(self, _query: Any, body: bytes) -> None:
        errors = []
        try:
            head = json.loads(body)["content"].split("---")[1]
            if not isinstance(yaml.safe_load(head), dict):
                errors.append({"message": "no mapping"})
        except (IndexError, yaml.YAMLError) as error:
            errors.append({"message": str(error)})
        self._send(400 if errors else 200, {"errors": errors, "warnings": []})

    def info(self, _query: Any, _body: bytes, kind: str, name: str, revision: str | None) -> None:
        repository = self._repository(kind, name)
        sha = repository.resolve(revision or "main")
        files = [{"rfilename": path} for path in repository.commits[sha]]
        self._send(200, {"id": name, "sha": sha, "private": repository.private, "siblings": files, "tags": []})

    # Uploads --------------------------------------------------------------------------------------------------------

    def preupload(self, _query: Any, body: bytes, kind: str, name: str, revision: str) -> None:
        present, found = self._files(kind, name, revision), []
        for asked in json.loads(body)["files"]:
            path = asked["path"]
            mode, content = "lfs" if is_lfs(path) else "regular", present.get(path)
            answer = {"path": path, "uploadMode": mode, "shouldIgnore": False}
            if content is not None:
                answer["oid"] = hashlib.sha256(content).hexdigest() if mode == "lfs" else git_oid(content)
            found.append(answer)
        self._send(200, {"files": found})

    def batch(self, _query: Any, body: bytes, _name: str) -> None:
        found = []
        for asked in json.loads(body)["objects"]:
            upload, verify = {"href": f"{self.hub.url}/lfs/{asked['oid']}"}, {"href": f"{self.hub.url}/lfs-verify"}
            actions = {} if asked["oid"] in self.hub.stored else {"actions": {"upload": upload, "verify": verify}}
            found.append({**asked, **actions})
        self._send(200, {"transfer": "basic", "objects": found})

    def store(self, _query: Any, body: bytes, oid: str) -> None:
        if hashlib.sha256(body).hexdigest() != oid:
            raise ProblemError(400, "content of another hash")
        self.hub.stored[oid] = body
        self._send(200, {})

    def verify(self, _query: Any, body: bytes) -> None:
        known = json.loads(body)["oid"] in self.hub.stored
        self._send(200 if known else 404, {})

    def commit(self, _query: Any, body: bytes, kind: str, name: str, revision: str) -> None:
        repository, files = self._repository(kind, name), dict(self._files(kind, name, revision))
        for line in body.splitlines():
            operation = json.loads(line)
            value = operation["value"]
            if operation["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif operation["key"] == "lfsFile":
                if value["oid"] not in self.hub.stored:
                    raise ProblemError(400, f"{value['path']} was not uploaded")
                files[value["path"]] = self.hub.stored[value["oid"]]
            elif operation["key"] == "deletedFile":
                del files[value["path"]]
        sha = repository.commit(revision, files)
        self._send(200, {"commitUrl": f"{self.hub.url}/{_KINDS[kind]}{name}/commit/{sha}", "commitOid": sha})

    # Revisions ------------------------------------------------------------------------------------------------------

    def refs(self, _query: Any, _body: bytes, kind: str, name: str) -> None:
        repository = self._repository(kind, name)

        def listed(names: dict[str, str], where: str) -> list[dict[str, str]]:
            return [{"name": n, "ref": f"refs/{where}/{n}", "targetCommit": sha} for n, sha in names.items()]

        branches, tags = listed(repository.branches, "heads"), listed(repository.tags, "tags")
        self._send(200, {"branches": branches, "converts": [], "tags": tags})

    def mark(self, _query: Any, body: bytes, kind: str, name: str, revision: str) -> None:
        repository, tag = self._repository(kind, name), json.loads(body)["tag"]
        if tag in repository.tags:
            raise ProblemError(409, f"tag {tag} exists")
        repository.tags[tag] = repository.resolve(revision)
        self._send(200, {})

    def unmark(self, _query: Any, _body: bytes, kind: str, name: str, tag: str) -> None:
        if self._repository(kind, name).tags.pop(tag, None) is None:
            raise ProblemError(404, f"no tag {tag}", "RevisionNotFound")
        self._send(200, {})

    # Downloads ------------------------------------------------------------------------------------------------------

    def tree(self, query: Any, _body: bytes, kind: str, name: str, revision: str, inside: str | None) -> None:
        files = self._files(kind, name, revision)
        prefix, recursive = f"{inside}/" if inside else "", query.get("recursive", ["false"])[0].lower() == "true"
        if inside and not any(path.startswith(prefix) for path in files):
            raise ProblemError(404, f"no folder {inside}", "EntryNotFound")
        self._send(200, list(entries(files, prefix, recursive)))

    def paths_info(self, _query: Any, body: bytes, kind: str, name: str, revision: str) -> None:
        files = self._files(kind, name, revision)
        asked = parse_qs(body.decode()).get("paths", [])
        self._send(200, [entry for entry in entries(files, "", recursive=True) if entry["path"] in asked])

    def content(self, _query: Any, _body: bytes, prefix: str | None, name: str, revision: str, path: str) -> None:
        kind = next(kind for kind, given in _KINDS.items() if given == (prefix or ""))
        repository = self._repository(kind, name)
        sha = repository.resolve(revision)
        if path not in repository.commits[sha]:
            raise ProblemError(404, f"no file {path}", "EntryNotFound")
        content = repository.commits[sha][path]
        oid = hashlib.sha256(content).hexdigest() if is_lfs(path) else git_oid(content)
        headers = {"X-Repo-Commit": sha, "ETag": f'"{oid}"', "Accept-Ranges": "bytes"}
        headers["X-Linked-Size"] = str(len(content))
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        if asked is None:
            return self._send(200, content, headers)
        first, last = int(asked[1]), min(int(asked[2] or len(content)), len(content) - 1)
        headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
        return self._send(206, content[first : last + 1], headers)


_API = r"/api/(models|datasets)/([^/]+/[^/]+)"
_ROUTES: tuple[tuple[str, Callable[..., None]], ...] = (
    (r"GET /api/whoami-v2", Handler.whoami),
    (r"POST /api/repos/create", Handler.create),
    (r"POST /api/validate-yaml", Handler.validate),
    (rf"GET {_API}(?:/revision/(.+))?", Handler.info),
    (rf"POST {_API}/preupload/(.+)", Handler.preupload),
    (r"POST /(?:datasets/)?([^/]+/[^/]+)\.git/info/lfs/objects/batch", Handler.batch),
    (r"PUT /lfs/([0-9a-f]{64})", Handler.store),
    (r"POST /lfs-verify", Handler.verify),
    (rf"POST {_API}/commit/(.+)", Handler.commit),
    (rf"GET {_API}/refs", Handler.refs),
    (rf"POST {_API}/tag/(.+)", Handler.mark),
    (rf"DELETE {_API}/tag/(.+)", Handler.unmark),
    (rf"GET {_API}/tree/([^/]+)(?:/(.+))?", Handler.tree),
    (rf"POST {_API}/paths-info/(.+)", Handler.paths_info),
    (r"(?:GET|HEAD) /(datasets/)?([^/]+/[^/]+)/resolve/([^/]+)/(.+)", Handler.content),
)
_OPEN = (Handler.validate, Handler.verify, Handler.paths_info)
"""POST requests without a login."""
