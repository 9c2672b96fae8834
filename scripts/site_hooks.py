"""What `mkdocs.yml` cannot say: hooks of the documentation site.

One text serves GitHub and the site. Links are written as GitHub reads them, by paths in the repository; here they
become links between pages. What they lead to outside docs/ becomes a page too: the site holds the code of its own
version, and needs neither a repository's address nor a network. The README is the home page.
"""

from __future__ import annotations

import fnmatch
import os
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import File, Files
    from mkdocs.structure.pages import Page

OUTSIDE = "repository"
"""Folder of the site with the pages of files outside docs/."""
LANGUAGES = {
    ".cff": "yaml",
    ".json": "json",
    ".py": "python",
    ".sh": "bash",
    ".toml": "toml",
    ".yaml": "yaml",
    ".yml": "yaml",
}
FENCE = "`" * 10
LINK = re.compile(
    r"(?P<code>^(?P<fence>```+).*?^(?P=fence)|`[^`\n]+`)|(?<=\]\()(?P<target>[^)\s#]+)", re.MULTILINE | re.DOTALL
)

type Nav = list[str | dict[str, Any]]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Addresses are the workflow's to know; anchors are GitHub's, so that a link to one holds on both."""
    from pymdownx.slugs import slugify

    config.site_url = os.environ.get("SITE_URL", "")
    if address := os.environ.get("REPOSITORY_URL"):
        config.repo_url, config.repo_name = address, posixpath.basename(address)
    config.mdx_configs.setdefault("toc", {})["slugify"] = slugify(case="lower")
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the home page, every file outside docs/ that a page links to or the nav names, and the API reference."""
    root = Path(config.config_file_path).parent
    for file in reference_pages(config):
        files.append(file)
    wanted = [home(file.src_uri) for file in files.documentation_pages()]
    wanted += ["README.md", *(home(entry) for entry in entries(config.nav or []) if entry.startswith(f"{OUTSIDE}/"))]
    seen: set[str] = set()
    while wanted:
        path = wanted.pop()
        if path in seen or not (root / path).is_file():
            continue
        seen.add(path)
        if not path.startswith("docs/"):
            files.append(page_of(root, path, config))
        if path.endswith(".md"):
            wanted += filter(None, (resolve(root, path, each) for each in targets((root / path).read_text("utf-8"))))
    pages = [file.src_uri for file in files.documentation_pages()]
    config.nav = arrange(config.nav or [], pages)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links between files of the repository into links between pages of the site."""
    root, uri = Path(config.config_file_path).parent, page.file.src_uri
    path = home(uri)
    if not (root / path).is_file():
        return markdown  # made here: code as it is, or the API reference

    def replace(match: re.Match[str]) -> str:
        there = resolve(root, path, match["target"]) if match["target"] else None
        return posixpath.relpath(address(root, there), posixpath.dirname(uri) or ".") if there else match[0]

    return LINK.sub(replace, markdown)


def targets(text: str) -> Iterator[str]:
    """Yields what Markdown links to, code left out and anchors cut off."""
    return (match["target"] for match in LINK.finditer(text) if match["target"])


def resolve(root: Path, path: str, target: str) -> str | None:
    """Returns the file of the repository that a link in ``path`` means, None if it means none.

    Of a folder, what introduces it: its README, or the docstring of its package.
    """
    if re.match(r"[a-z]+:", target) or target.startswith("/"):
        return None
    there = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
    if there.startswith(".."):
        return None
    choices = (there, f"{there}/README.md", f"{there}/__init__.py")
    return next((each for each in choices if (root / each).is_file()), None)


def home(uri: str) -> str:
    """Path in the repository of a page of the site."""
    if uri == "index.md":
        return "README.md"
    return uri.removeprefix(f"{OUTSIDE}/") if uri.startswith(f"{OUTSIDE}/") else f"docs/{uri}"


def address(root: Path, path: str) -> str:
    """Place in the site of a file of the repository; code becomes a page, what is no text stays a file."""
    if path == "README.md":
        return "index.md"
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    is_code = not path.endswith(".md") and b"\0" not in (root / path).read_bytes()
    return f"{OUTSIDE}/{path}.md" if is_code else f"{OUTSIDE}/{path}"


def page_of(root: Path, path: str, config: MkDocsConfig) -> File:
    """The page, or the file, that shows a file outside docs/."""
    from mkdocs.structure.files import File

    uri = address(root, path)
    if not uri.endswith(f"{path}.md"):
        return File.generated(config, uri, abs_src_path=str(root / path))
    code = (root / path).read_text("utf-8").rstrip()
    language = LANGUAGES.get(posixpath.splitext(path)[1], "text")
    head = f"---\nsearch: {{exclude: true}}\n---\n# `{path}`\n"
    return File.generated(config, uri, content=f"{head}\n{FENCE}{language}\n{code}\n{FENCE}\n")


def reference_pages(config: MkDocsConfig) -> Iterator[File]:
    """Yields a page for each row of `extra.reference`: a title, and modules that mkdocstrings reads."""
    from mkdocs.structure.files import File

    for title, modules in config.extra.get("reference", {}).items():
        text = "\n".join([f"# {title}", *(f"\n::: {module}" for module in modules)])
        yield File.generated(config, f"reference/{title.lower().replace(' ', '_')}.md", content=text + "\n")


def entries(nav: Nav) -> Iterator[str]:
    """Yields the pages that a nav names, patterns as they are."""
    for entry in nav:
        for value in entry.values() if isinstance(entry, dict) else (entry,):
            yield from entries(value) if isinstance(value, list) else (value,)


def arrange(nav: Nav, pages: list[str]) -> Nav:
    """Returns ``nav`` for the ``pages`` there are: patterns filled in, absent ones left out, unnamed ones last."""
    named = {page for entry in entries(nav) for page in pages if fnmatch.fnmatch(page, entry)}
    rest = sorted(page for page in pages if page not in named and not page.startswith(f"{OUTSIDE}/"))
    return [*present(nav, pages), *([{"More": rest}] if rest else [])]


def present(nav: Nav, pages: list[str]) -> Nav:
    """Returns the entries of a nav, or of a section of it, that have a page."""
    kept: Nav = []
    for entry in nav:
        if isinstance(entry, str):
            kept += sorted(fnmatch.filter(pages, entry))
            continue
        ((title, value),) = entry.items()
        if isinstance(value, list):
            kept += [{title: inside}] if (inside := present(value, pages)) else []
        elif value in pages:
            kept.append({title: value})
    return kept
