"""Links to files and folders of the repository lead to pages of the site that show them.

The pages of the documentation link to sources relative to themselves, as any host of the repository understands it. On
the site ``source/PATH.html`` shows the file with highlighting and line numbers, and ``source/FOLDER/index.html`` lists
a folder with the first line of each file's docstring. Generated pages (``docs/*.html``) are copied as they are.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shutil
from collections.abc import Iterator
from html import escape
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("hydro_env", "agents", "configs", "tests", "paper", "benchmarks", "challenge", "docs")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".j2": "html+jinja", ".csv": "text", ".json": "json"}
LARGEST = 100_000  # characters of a file that is shown
SINGLE_FILES = {
    "README.md": "markdown", "LICENSE": "text", "Makefile": "make", "pyproject.toml": "toml", "constraints.txt": "text",
    "CITATION.cff": "yaml", ".pre-commit-config.yaml": "yaml", ".ci/run": "bash",
}  # fmt: skip


def shown_files() -> dict[str, str]:
    """Files that have a page, relative to the root, and their languages."""
    found = {name: language for name, language in SINGLE_FILES.items() if (ROOT / name).is_file()}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            language = "markdown" if path.parent.name == "notes" else LANGUAGES.get(path.suffix)
            if language and "__pycache__" not in path.parts and path.is_file() and path.stat().st_size < LARGEST:
                found[path.relative_to(ROOT).as_posix()] = language
    return found


def page_of(path: str, files: dict[str, str]) -> str | None:
    """Name of the page that shows a file or folder; None if none does."""
    if path in files:
        return f"source/{path}"
    return f"source/{path}/index" if any(name.startswith(f"{path}/") for name in files) else None


class RepositoryLinks(SphinxTransform):
    """Point the links of a page to files and folders at the pages that show them."""

    default_priority = 500

    def apply(self) -> None:
        """Replace the links."""
        files = shown_files()
        here = Path(self.env.doc2path(self.env.docname)).parent
        for node in [
            *self.document.findall(addnodes.download_reference),
            *self.document.findall(addnodes.pending_xref),
        ]:
            if node.get("reftype") != "myst":
                continue
            target = (here / node["reftarget"]).resolve()
            if node.get("refdomain") == "doc":
                target = ROOT / f"{node['reftarget']}.md"
                if node["reftarget"] in self.env.found_docs:
                    if Path(node.astext()).name == target.name:
                        node["refexplicit"] = False  # the title of the page says more than its file name
                    continue
            if not target.exists() or not target.is_relative_to(ROOT):
                continue
            path = target.relative_to(ROOT).as_posix()
            page = page_of(path, files)
            if page is not None:
                uri = self.app.builder.get_relative_uri(self.env.docname, page)
            elif target.suffix == ".html":
                uri = node["reftarget"]
            else:
                continue
            node.replace_self(nodes.reference("", "", *node.children, refuri=uri, internal=True))


def code_pages(app: Sphinx) -> Iterator[tuple[str, dict[str, str], str]]:
    """The pages of the files and folders."""
    files = shown_files()
    highlight = app.builder.highlighter.highlight_block
    for path, language in files.items():
        text = (ROOT / path).read_text(encoding="utf-8")
        code = highlight(text, language, force=True, linenos="inline", lineanchors="line", anchorlinenos=True)
        yield f"source/{path}", {"title": path, "body": f"<h1>{escape(path)}</h1>{code}"}, "page.html"
    folders = {str(parent) for path in files for parent in Path(path).parents if str(parent) != "."}
    for folder in sorted(folders):
        yield f"source/{folder}/index", {"title": folder, "body": folder_listing(folder, files)}, "page.html"


def folder_listing(folder: str, files: dict[str, str]) -> str:
    """The files and folders of a folder, and what each says of itself."""
    inside = [path.removeprefix(f"{folder}/") for path in files if path.startswith(f"{folder}/")]
    rows = []
    for name in sorted({path.split("/")[0] for path in inside}):
        if name in inside:
            link, says = f"{name}.html", f"{folder}/{name}"
        else:
            link, says = f"{name}/index.html", f"{folder}/{name}/__init__.py"
        about = first_line(says) if says in files else ""
        about = re.sub("``(.+?)``", r"<code>\1</code>", escape(about))
        rows.append(f'<tr><td><a href="{escape(link)}">{escape(name)}</a></td><td>{about}</td></tr>')
    return f'<h1>{escape(folder)}</h1><table class="docutils">{"".join(rows)}</table>'


def first_line(path: str) -> str:
    """First line of the docstring of a Python file, or of the comment that begins another one."""
    text = (ROOT / path).read_text(encoding="utf-8")
    if path.endswith(".py"):
        return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    first = text.partition("\n")[0]
    return first.lstrip("# ") if first.startswith("#") else ""


PACKAGES = ("hydro_env", "agents")


def place_in_source(domain: str, info: dict[str, str]) -> str | None:
    """Address of the source of a documented object, for ``sphinx.ext.linkcode``; pages of the API lie in ``docs``."""
    try:
        found = importlib.import_module(info["module"])
        for part in info["fullname"].split("."):
            found = getattr(found, part)
        found = inspect.unwrap(found.fget if isinstance(found, property) else found)
        path = Path(inspect.getsourcefile(found) or "").resolve().relative_to(ROOT)
        if path.parts[0] not in PACKAGES:  # a library in a virtual environment that lies in this folder
            return None
        return f"../source/{path.as_posix()}.html#line-{inspect.getsourcelines(found)[1]}"
    except (AttributeError, TypeError, OSError, ValueError):
        return None  # a constant, or something that another package defines


def copy_pages(app: Sphinx, error: Exception | None) -> None:
    """Copy pages that a command of the project has made.

    Raises:
        FileExistsError: a page of the site has the same name, and would be lost.
    """
    for page in (ROOT / "docs").glob("*.html"):
        if (ROOT / "docs" / f"{page.stem}.md").exists():
            raise FileExistsError(f"docs/{page.name} and docs/{page.stem}.md are the same page of the site: rename one")
        shutil.copy(page, Path(app.outdir) / "docs" / page.name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_transform(RepositoryLinks)
    app.connect("html-collect-pages", code_pages)
    app.connect("build-finished", copy_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
