"""Put the tables of ``hydro benchmark`` into pages, between the markers that name their group.

Run: python benchmarks/put_into_docs.py [results/benchmark/benchmark.md] [docs/performance.md ...]

A page holds ``<!-- benchmark: GROUP -->`` and ``<!-- end -->``; what stands between is replaced by the table of the
group, or for ``circumstances`` by the line that names machine, versions and threads. A group that was not measured
keeps what it has. put_results_into_docs.py does the same between ``<!-- table: NAME -->`` and ``<!-- end -->``.
"""

import re
import sys
from pathlib import Path

MARKED = re.compile(r"(<!-- (?:benchmark|table): (\w+) -->\n).*?(<!-- end -->)", flags=re.DOTALL)


def sections(text: str) -> dict[str, str]:
    """Tables of ``benchmark.md`` by group, and ``circumstances``."""
    head, *groups = re.split(r"^## ", text, flags=re.MULTILINE)
    found = {"circumstances": head.removeprefix("# Benchmark").strip()}
    for group in groups:
        name, _, body = group.partition("\n")
        found[name.strip()] = "\n".join(line for line in body.splitlines() if line.startswith("|"))
    return found


def filled(page: str, tables: dict[str, str]) -> str:
    """The page with the tables in place."""

    def put(match: re.Match[str]) -> str:
        if match[2] not in tables:
            return match[0]
        return f"{match[1]}\n{tables[match[2]]}\n\n{match[3]}"

    return MARKED.sub(put, page)


def main(source: str = "results/benchmark/benchmark.md", *pages: str) -> int:
    """Fill the pages; 2 where a file cannot be used."""
    try:
        tables = sections(Path(source).read_text(encoding="utf-8"))
        for name in pages or ("docs/performance.md",):
            page = Path(name)
            text = page.read_text(encoding="utf-8")
            page.write_text(filled(text, tables), encoding="utf-8")
            marked = [match[2] for match in MARKED.finditer(text)]
            print(f"{name}: {', '.join(group for group in marked if group in tables) or 'no table'}")
    except OSError as error:
        print(f"{error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
