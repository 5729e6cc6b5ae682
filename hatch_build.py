"""What a release adds to the files: the project's address (``make release URL=https://…``), and the pages in the wheel.

A package index shows the README without the repository's files: links to them become addresses, or, as long as the
project has no address, plain words; a picture that cannot be shown is left out.
"""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

ADDRESS = "HYDRO_ENV_URL"
PICTURE = re.compile(r"!\[([^\]]*)\]\((?!https?:)([^)]+)\)\n*")
LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)([^)#]*)(#[^)]*)?\)")


def readme(text: str, address: str) -> str:
    """The README for a package index; ``address``: of the repository, or empty."""
    if not address:
        return LINK.sub(r"\1", PICTURE.sub("", text))
    text = PICTURE.sub(rf"![\1]({address}/raw/main/\2)\n\n", text)
    return LINK.sub(lambda link: f"[{link[1]}]({address}/blob/main/{link[2]}{link[3] or ''})", text)


class AddressHook(MetadataHookInterface):
    """Writes the fields ``readme`` and ``urls``."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by hatchling with the ``project`` table."""
        address = os.environ.get(ADDRESS, "").rstrip("/")
        if address and not re.fullmatch(r"https://[\w./-]+", address):
            raise ValueError(f"{ADDRESS} = {address!r}: must be an address such as https://example.org/hydro_env")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, address)}
        pages = {"Source": "", "Documentation": "/blob/main/docs/index.md", "Issues": "/issues"}
        pages |= {"Changelog": "/blob/main/CHANGELOG.md"}
        metadata["urls"] = {name: address + page for name, page in pages.items()} if address else {}


class PagesHook(BuildHookInterface[Any]):
    """Puts the pages of ``docs`` into the wheel: messages name them."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before it builds; an editable installation has the pages beside it."""
        if version == "standard":
            pages = sorted((Path(self.root) / "docs").glob("*.md"))
            build_data["force_include"].update({str(page): f"hydro_env/docs/{page.name}" for page in pages})
