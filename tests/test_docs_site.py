"""The documentation as a site: everything is on it, every link leads somewhere, no page needs another host."""

from __future__ import annotations

import html
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort
from site_hooks import address, arrange, resolve

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted((ROOT / "docs").rglob("*.md"))
BUILD = """
import json, sys
from mkdocs.__main__ import cli
cli(["build", "--quiet", "--strict", "--site-dir", sys.argv[1]], standalone_mode=False)
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """The site, as `make docs` builds it, and the packages that the build has imported."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(folder)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder, set(json.loads(done.stdout.strip().splitlines()[-1]))


@pytest.fixture(scope="module")
def site(built: tuple[Path, set[str]]) -> Path:
    return built[0]


def plain(text: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", text))


def article(site: Path, uri: str) -> str:
    """The text of a page without the theme around it."""
    page = site / uri.removesuffix("index.md").removesuffix(".md") / "index.html"
    found = re.search(r"<article.*?</article>", page.read_text(encoding="utf-8"), re.DOTALL)
    assert found, page
    return found[0]


def headings(text: str) -> list[str]:
    return re.findall(r"^## (.*)$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)


@pytest.mark.nightly
def test_every_document_is_a_page_with_all_its_sections(site: Path) -> None:
    above = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
    for path in (*above, *DOCUMENTS):
        page = article(site, address(ROOT, path.relative_to(ROOT).as_posix()))
        text = plain(page)
        for heading in headings(path.read_text(encoding="utf-8")):
            assert re.sub(r"[`*\\]|\]\([^)]*\)|\[", "", heading) in text, (path, heading)


@pytest.mark.nightly
def test_pages_load_nothing_from_another_host_and_lists_stand_apart(site: Path) -> None:
    """GitHub makes a list of "- " under a paragraph; the site's Markdown would run it into one line."""
    loaded = r'<(?:script|img|link|iframe)[^>]*(?:src|href)="?(?:https?:)?//[^>]*>'
    pages = list(site.rglob("*.html"))
    assert len(pages) > 25
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not re.findall(loaded, text), page
        paragraphs = re.findall(r"<p>(.*?)</p>", text, re.DOTALL)
        assert not [each for each in paragraphs if re.search(r"^(- |\* |\d+\. |\|)", each, re.MULTILINE)], page


@pytest.mark.nightly
def test_code_outside_docs_is_shown_as_it_is(site: Path) -> None:
    shown = plain(article(site, "repository/examples/own_expert.py.md"))
    source = (ROOT / "examples" / "own_expert.py").read_text(encoding="utf-8")
    assert "".join(source.split()) in "".join(shown.split())
    assert 'href="../repository/examples/own_expert.py/"' in article(site, "python.md")


@pytest.mark.nightly
def test_the_reference_is_read_not_imported(built: tuple[Path, set[str]]) -> None:
    site, imported = built
    mine = {"lerobot_adamanip", "lerobot_env_adamanip", "lerobot_policy_adamanip"}
    assert not imported & {"sapien", "mani_skill", "lerobot", "torch", "diffusers", *mine}
    named = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["extra"]["reference"]
    for title, modules in named.items():
        page = article(site, f"reference/{title.lower().replace(' ', '_')}.md")
        assert all(f'id="{module}"' in page for module in modules), title
    # A field's documentation is the comment above it, here and on the page of options.
    comment = "Points in observation.point_cloud, in farthest-point order"
    for page in ("reference/environments.md", "environments.md"):
        assert comment in plain(article(site, page))
    assert 'id="collect"' in article(site, "command_line/collect.md")


# A small project under the same settings ----------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """README, one page and one file of code, under this project's mkdocs.yml less the reference."""
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    settings |= {"plugins": ["search"], "extra": {}, "watch": [], "hooks": [str(ROOT / "scripts" / "site_hooks.py")]}
    write(tmp_path / "mkdocs.yml", yaml.safe_dump(settings))
    write(tmp_path / "README.md", "# Home\n\n[tutorial](docs/tutorial.md)\n\n## Some results\n\n1\n")
    write(tmp_path / "docs" / "tutorial.md", "# Tutorial\n\n## One step\n\n1\n")
    write(tmp_path / "code.py", "GREETING = '[no](link.md)'\n")
    write(tmp_path / "package" / "__init__.py", '"""A package."""\n')
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\0\0")
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def build_strictly(project: Path) -> Path:
    build(load_config(str(project / "mkdocs.yml"), strict=True, site_dir=str(project / "site")))
    return project / "site"


def test_links_that_leave_docs_work(project: Path) -> None:
    text = "[r](../README.md#some-results) [c](../code.py) [p](../package) [i](../picture.png) `[no](../code.py)`"
    write(project / "docs" / "tutorial.md", f"# Tutorial\n\n{text}\n")
    site = build_strictly(project)
    links = ["../#some-results", "../repository/code.py/", "../repository/package/__init__.py/"]
    page = article(site, "tutorial.md")
    assert [link for link in re.findall(r'href="([^"#]*(?:#some-results)?)"', page) if link][:3] == links
    assert (site / "repository" / "picture.png").read_bytes() == (project / "picture.png").read_bytes()
    assert "[no](../code.py)" in page
    assert "GREETING" in article(site, "repository/code.py.md")


@pytest.mark.parametrize(
    "link",
    ["gone.md", "tutorial.md#gone", "#gone", "../gone.py", "../../beyond.py", "../README.md#gone", "/docs/tutorial.md"],
)
def test_a_link_to_nowhere_fails_the_build(project: Path, link: str) -> None:
    write(project / "docs" / "concepts.md", f"# Concepts\n\n[link]({link})\n")
    with pytest.raises(Abort):
        build_strictly(project)


def test_a_new_page_needs_no_entry_and_a_missing_one_breaks_nothing(project: Path) -> None:
    write(project / "docs" / "unforeseen.md", "# Something new\n\n1\n")
    card = "---\nlicense: apache-2.0\ntags: [LeRobot]\n---\n\n# A card\n\n1\n"
    write(project / "docs" / "cards" / "dataset.md", card)
    home = (build_strictly(project) / "index.html").read_text(encoding="utf-8")
    entries = {plain(each).strip() for each in re.findall(r'md-ellipsis">(.*?)</span>', home, re.DOTALL)}
    assert {"Tutorial", "A card", "More", "Something new"} <= entries
    assert not {"Benchmark", "Reference"} & entries


def test_anchors_are_those_of_github(project: Path) -> None:
    """A space is a hyphen, also beside what is left out; letters are kept, whatever their alphabet."""
    sections = {"7. Put it: `on_the` Hub (now)": "7-put-it-on_the-hub-now", "Split / merge über": "split--merge-über"}
    lines = [line for title, anchor in sections.items() for line in (f"## {title}", f"[link](#{anchor})")]
    write(project / "docs" / "tutorial.md", "\n\n".join(["# T", *lines]))
    build_strictly(project)


def test_a_nav_is_arranged() -> None:
    nav = ["a.md", {"Section": [{"B": "b.md"}, "cards/*.md"]}, {"Empty": [{"Gone": "gone.md"}]}]
    pages = ["b.md", "cards/2.md", "cards/1.md", "new.md", "repository/LICENSE.md"]
    assert arrange(nav, pages) == [{"Section": [{"B": "b.md"}, "cards/1.md", "cards/2.md"]}, {"More": ["new.md"]}]


def test_addresses_are_left_alone() -> None:
    for link in ("https://huggingface.co", "mailto:a@b.c", "/absolute.md", "../../etc/passwd"):
        assert resolve(ROOT, "docs/tutorial.md", link) is None
