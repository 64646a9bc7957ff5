"""What the pages need to become a site."""

import re
from typing import Any

EXAMPLE = re.compile(r"^```(\w+) (\S+)$", re.M)


def on_page_markdown(text: str, **page: Any) -> str:
    """The name of an example file, which stands behind the language of its block, becomes its title."""
    return EXAMPLE.sub(r'```\1 title="\2"', text)
