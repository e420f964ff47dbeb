"""The documentation as a site: every page and every package is in it, and no link leads nowhere."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
ROOMS = sorted(path.parent.name for path in (ROOT / "src" / "ambler").glob("*/__init__.py"))


def entries(nav: list[dict[str, Any]]) -> Iterator[str]:
    """Give every page of a navigation, however deep."""
    for item in nav:
        for value in item.values():
            if isinstance(value, str):
                yield value
            else:
                yield from entries(value)


def headings(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    found = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-") for text in found}


def test_the_navigation_holds_every_page_once() -> None:
    listed = list(entries(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]))
    assert sorted(listed) == sorted(str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md"))


def test_every_package_has_a_page_of_reference() -> None:
    assert sorted(path.stem for path in (DOCS / "reference").glob("*.md")) == ROOMS
    for room in ROOMS:
        text = (DOCS / "reference" / f"{room}.md").read_text(encoding="utf-8")
        assert text == f"# ambler.{room}\n\n::: ambler.{room}\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        there = (page.parent / name) if name else page
        assert there.exists(), target
        assert not anchor or anchor in headings(there), target


def test_the_glossary_explains_each_word_once() -> None:
    words = re.findall(r"^\| (.+?) \|", (DOCS / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE)
    terms = [word for word in words if word not in ("term", "word")]
    assert len(terms) > 30
    assert len(terms) == len(set(terms))
