"""Where a report's pictures are kept: each drawn once, for the page and its file."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from turtlebag.reports.figures.style import save_pdf, save_png, standalone, styled, svg_text


@dataclass(frozen=True)
class Picture:
    """A figure on the page: `name` is its file's stem; an `svg` element, or a `gif` with its last
    frame as a `still`, both as data addresses.
    """

    name: str
    title: str
    caption: str
    svg: str = ""
    gif: str = ""
    still: str = ""


@dataclass
class Album:
    """Collects the pictures of one report in `folder`; `paper` adds each as PDF and PNG.

    Without a folder nothing is drawn: titles and captions only. `told` hears what is being drawn. `prefix`
    begins the names of the pictures.
    """

    folder: Path | None
    animate: bool = True
    paper: bool = False
    prefix: str = ""
    pictures: list[Picture] = field(default_factory=list)
    told: Callable[[str], None] = lambda title: None

    def add(self, name: str, title: str, caption: str, draw: Callable[..., Figure], *drawn: Any) -> None:
        """Call `draw`, save `name.svg` and keep it for the page; names are unique within a report."""
        name = self.prefix + name
        if any(picture.name == name for picture in self.pictures):
            raise ValueError(f"two pictures are called {name}")
        self.told(title)
        svg = "" if self.folder is None else self._saved(self.folder, name, partial(draw, *drawn))
        self.pictures.append(Picture(name, title, caption, svg))

    def _saved(self, folder: Path, name: str, draw: Callable[[], Figure]) -> str:
        folder.mkdir(parents=True, exist_ok=True)
        with styled():
            figure = draw()
            # Laid out once, without drawing; each saving would do it again.
            if (layout := figure.get_layout_engine()) is not None:
                layout.execute(figure)
            figure.set_layout_engine(None)  # "none" would stay an engine, and each saving draw twice
            svg = svg_text(figure, name)
            (folder / f"{name}.svg").write_text(standalone(svg))
            if self.paper:
                save_pdf(figure, folder / f"{name}.pdf")
                save_png(figure, folder / f"{name}.png")
        return svg

    def add_animation(
        self, name: str, title: str, caption: str, write: Callable[..., Image.Image], *told: Any
    ) -> None:
        """Have `write` save `name.gif`, and carry it in the page; what it returns is printed instead."""
        name = self.prefix + name
        self.told(title)
        picture = Picture(name, title, caption)
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path, still = self.folder / f"{name}.gif", io.BytesIO()
            write(path, *told).save(still, format="PNG")
            gif = data_address("gif", path.read_bytes())
            picture = Picture(name, title, caption, gif=gif, still=data_address("png", still.getvalue()))
        self.pictures.append(picture)


def data_address(kind: str, data: bytes) -> str:
    """An image as the address of itself, for a page that needs no other file."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
