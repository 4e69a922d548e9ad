"""What is wrong with a folder of HTML pages that must open from disk: what leads nowhere, what comes from outside."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

STYLE = re.compile(r"""@import\s+["']([^"']+)|url\(\s*(?:"([^"]+)"|'([^']+)'|([^"')\s]+))""")
REQUEST = re.compile(
    r"""(?:\bfetch|\bimport|\bimportScripts|\bopen|\bnew (?:WebSocket|EventSource|Worker))\s*\(\s*["'`][^)]*?//"""
)
"""A script that asks for a literal address elsewhere."""
LOADING = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "dns-prefetch", "manifest", "modulepreload"}
"""What a <link> is that makes a browser ask for something; others only name a page."""


class Page(HTMLParser):
    """The anchors of a page, where it leads and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.leads: list[str] = []
        self.loads: list[str] = []
        self.scripts: list[str] = []
        self._inside = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        self._inside = tag
        if tag == "link":
            loading = LOADING & set(given.get("rel", "").split())
            (self.loads if loading else self.leads).append(given.get("href", ""))
        elif "href" in given:
            (self.leads if tag in ("a", "area") else self.loads).append(given["href"])
        self.loads += [given[name] for name in ("src", "data", "poster", "action", "xlink:href") if name in given]
        self.loads += [part.split()[0] for part in given.get("srcset", "").split(",") if part.strip()]
        self.loads += _named_in(given.get("style", ""))

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.loads += _named_in(data)
        if self._inside == "script":
            self.scripts.append(data)


def problems(site: Path) -> list[str]:
    """What is wrong with the pages and style sheets of a folder, a line each; none if nothing is."""
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    if not pages:
        return [f"{site}: no pages"]
    faults = []
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        faults += [f"{name} loads {link} from outside" for link in page.loads if _outside(link)]
        faults += [f"{name}: a script asks outside: {text[:80]}" for text in page.scripts if REQUEST.search(text)]
        for link in (*page.leads, *page.loads):
            if not _outside(link) and (problem := _nowhere(path, link, pages, site.resolve())):
                faults.append(f"{name} {problem}")
    for path in sorted(site.rglob("*.css")):
        for link in _named_in(path.read_text(encoding="utf-8")):
            if _outside(link):
                faults.append(f"{path.relative_to(site)} loads {link} from outside")
            elif not link.startswith(("data:", "#")) and not (path.parent / urlsplit(link).path).exists():
                faults.append(f"{path.relative_to(site)} loads {link}, which is not there")
    for path in sorted(site.rglob("*.js")):
        if REQUEST.search(path.read_text(encoding="utf-8")):
            faults.append(f"{path.relative_to(site)} asks outside")
    return faults


def _outside(link: str) -> bool:
    return urlsplit(link).scheme in ("http", "https", "ws", "wss", "ftp") or link.startswith("//")


def _nowhere(path: Path, link: str, pages: dict[Path, Page], site: Path) -> str:
    """What is wrong with a link of a page to a file or a place of this site; empty if nothing."""
    parts = urlsplit(link)
    if parts.scheme in ("data", "mailto", "javascript"):
        return ""
    if parts.scheme or parts.path.startswith("/"):
        return f"names {link}, which is not relative"
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.is_file() or not target.is_relative_to(site):
        return f"names {link}, which is not there"
    anchor = unquote(parts.fragment)
    if anchor and target in pages and anchor not in pages[target].anchors:
        return f"names {link}, but {target.name} has no such place"
    return ""


def _named_in(style: str) -> list[str]:
    """Addresses in a style sheet."""
    return [next(group for group in match.groups() if group) for match in STYLE.finditer(style)]
