"""Makes links of the documentation to files of the repository work on the site.

A page links to what lies outside ``docs/`` as on any host of the repository, for example
``../SECURITY.md``. The site gets a page for each such file: Markdown as it is, any other text as
one block of code.
"""

import os
import re
from pathlib import Path
from typing import Any, Final

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT: Final = Path(__file__).resolve().parents[2]
DOCS: Final = ROOT / "docs"
LINK: Final = re.compile(r"\]\(((?:\.\./)+[^)#\s]+)(#[^)\s]*)?\)")
FOLDER: Final = "repository"  # of the pages made here, on the site


def on_files(files: Files, config: Any) -> Files:
    """Add a page for each file outside ``docs/`` that a page links to."""
    wanted = {
        place
        for page in files.documentation_pages()
        for target, _ in LINK.findall(page.content_string)
        if (place := outside(DOCS / page.src_uri, target)) is not None
    }
    for place in sorted(wanted):
        page = File.generated(
            config,
            page_of(place),
            content=content_of(place),
            inclusion=InclusionLevel.NOT_IN_NAV,
        )
        files.append(page)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn links to files outside ``docs/`` into links to their pages."""
    source = page.file.src_uri

    def turned(link: re.Match[str]) -> str:
        place = outside(DOCS / source, link[1])
        if place is None:
            return link[0]
        return f"]({os.path.relpath(page_of(place), Path(source).parent)}{link[2] or ''})"

    return LINK.sub(turned, markdown)


def outside(page: Path, target: str) -> Path | None:
    """Return the linked file relative to the repository if it exists and lies outside ``docs/``."""
    path = (page.parent / target).resolve()
    if path.is_file() and path.is_relative_to(ROOT) and not path.is_relative_to(DOCS):
        return path.relative_to(ROOT)
    return None


def page_of(place: Path) -> str:
    """Return the path of the page for a file, relative to the site."""
    name = place if place.suffix == ".md" else place.with_name(place.name + ".md")
    return f"{FOLDER}/{name.as_posix()}"


def content_of(place: Path) -> str:
    """Return the Markdown of the page for a file."""
    text = (ROOT / place).read_text()
    if place.suffix == ".md":  # its links go from the root of the repository
        back = os.path.relpath(".", Path(page_of(place)).parent)
        return re.sub(r"\]\(docs/([^)]+)\)", rf"]({back}/\1)", text)
    return f"# {place.as_posix()}\n\n```{place.suffix[1:]}\n{text}```\n"
