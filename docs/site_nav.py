"""A hook of MkDocs: ``folder/*`` in the nav stands for the folder's pages that it does not name."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Put the pages in; a section without pages is left out."""
    docs = Path(config.docs_dir)
    named = set(_pages(config.nav))

    def expanded(items: list[Any]) -> list[Any]:
        found: list[Any] = []
        for item in items:
            if isinstance(item, dict):
                ((title, value),) = item.items()
                value = expanded(value) if isinstance(value, list) else value
                found += [{title: value}] if value else []
            elif item.endswith("/*"):
                pages = sorted(
                    docs.glob(f"{item}.md"), key=lambda page: (page.stem != "index", page)
                )
                names = [page.relative_to(docs).as_posix() for page in pages]
                found += [name for name in names if name not in named]
            else:
                found.append(item)
        return found

    config.nav = expanded(config.nav)
    return config


def _pages(items: Any) -> list[str]:
    """All pages that a nav names."""
    if isinstance(items, str):
        return [items]
    values = items.values() if isinstance(items, dict) else items
    return [page for value in values for page in _pages(value)]
