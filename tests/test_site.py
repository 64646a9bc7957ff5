"""`make docs`: the site is built without a warning and without the network, and its links lead somewhere."""

import re
import socket
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config

import turtlebag

ROOT = Path(__file__).parents[1]
FETCHED = {"script": "src", "link": "href", "img": "src", "iframe": "src"}


class Page(HTMLParser):
    """What a page can be asked for, what it links to, and what a browser loads for it."""

    def __init__(self, path):
        super().__init__()
        self.names, self.links, self.loaded = {""}, [], []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.names |= {values.get("id"), values.get("name")}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag in FETCHED and FETCHED[tag] in values and values.get("rel") != "canonical":
            self.loaded.append(values[FETCHED[tag]])


GENERATED = {Path("commands.html"), Path("settings.html"), Path("glossary.html")}
"""Pages without a file in docs: made from the requests, the settings and the words of the reports."""


@pytest.mark.slow
def test_the_site_is_built_without_the_network_and_every_link_leads_somewhere(tmp_path, monkeypatch):
    def refuse(*address):
        raise AssertionError(f"the site asks for {address}")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path), strict=True))

    pages = {path: Page(path) for path in tmp_path.rglob("*.html") if path.name != "404.html"}
    sources = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    readable = {path.parent / path.name.replace("README", "index") for path in sources}
    assert {path.relative_to(tmp_path) for path in pages} == readable | GENERATED
    for path, page in pages.items():
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                assert link in page.links, f"{path.name} loads {link}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), f"{path.name}: {link}"
            if parts.fragment and target.suffix == ".html":
                assert unquote(parts.fragment) in pages[target].names, f"{path.name}: {link}"

    settings = (tmp_path / "settings.html").read_text()
    assert re.findall(r"<td><code>([a-z0-9_.]+)</code></td>\s*<td>.*?</td>\s*<td></td>", settings) == []
    assert settings.count("<tr>") > 200
    reference = pages[tmp_path / "reference.html"].names
    assert {f"turtlebag.{name}" for name in turtlebag.__all__} <= reference
