"""The words of a report a newcomer may not know, and how they are linked where they stand."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files

from markupsafe import Markup, escape

from turtlebag.datasets.yaml_files import plain_values
from turtlebag.reports.stage_titles import slug


@dataclass(frozen=True)
class Word:
    """A word with its meaning in one or two sentences; `forms` are spellings besides the name."""

    name: str
    meaning: str
    forms: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """Fragment of the page's address."""
        return f"word-{slug(self.name)}"


_told = plain_values((files("turtlebag.reports") / "glossary.yaml").read_text())
WORDS = tuple(
    Word(name, meaning, tuple(forms))
    for spellings, meaning in _told.items()
    for name, *forms in [spellings.split(" | ")]
)


def explained(text: str) -> Markup:
    """A text as HTML, each word's first appearance linked to its explanation."""
    marked = str(escape(text))
    links: list[str] = []
    for word in WORDS:
        spelled = "|".join(re.escape(form) for form in (*word.forms, word.name))
        match = re.search(rf"(?<![\w-])({spelled})(?![\w-])", marked)
        if match is not None:
            # A placeholder, so that no other word is found inside the link.
            marked = f"{marked[: match.start()]}\0{len(links)}\0{marked[match.end() :]}"
            title = escape(word.meaning)
            links.append(f'<a class="word" href="#{word.anchor}" title="{title}">{match[1]}</a>')
    for number, link in enumerate(links):
        marked = marked.replace(f"\0{number}\0", link)
    return Markup(marked)
