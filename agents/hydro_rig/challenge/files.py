"""The challenge as files: recordings of many simulated axes, the nameplates of these axes, and labels.

A split is a folder of Parquet files, each a block of recordings; its labels are another folder. The labels of the test
split stand apart, so that the rest can be published; ``benchmark.json`` holds their SHA-256, ``SHA256SUMS`` that of
every public file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.running.jobs import Job, Report, run_jobs
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_env.files import read_json, read_text, write_text, write_whole
from hydro_rig.challenge import axes as benchmark_axes
from hydro_rig.challenge.axes import SPLITS, TIERS, VERSION, Benchmark, simulated_block
from hydro_rig.challenge.plates import KNOWN, NEW, columns_described, plates_table
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.files import library_errors
from hydro_rig.recordings.simulated import heading

MANIFEST, CARD, PLATES, SUMS = "benchmark.json", "README.md", "axes.parquet", "SHA256SUMS"

HIDDEN = "hidden"
"""The folder of the labels of the test split."""

_CARD = Path(__file__).parent / "benchmark_card.md.j2"


def write_benchmark(
    folder: Path, config: TaskConfig, benchmark: Benchmark, jobs: int | None = None, progress: Report | None = None
) -> dict[str, Any]:
    """Write the recordings and labels of all splits; blocks that are there already stay as they are.

    Args:
        folder: for the files.
        config: the task.
        benchmark: size and key.
        jobs: blocks side by side; ``None``: that of the active ``parallel_config``, or one.
        progress: called when a block is finished.

    Returns:
        The content of ``benchmark.json``.

    Raises:
        ConfigurationError: the folder holds another benchmark, or a file cannot be written.
    """
    least = len(TIERS) * len(SPLITS)
    if benchmark.recordings < least:
        raise ConfigurationError(f"--count {benchmark.recordings}: must be at least {least}")
    manifest: dict[str, Any] = {
        "name": "leaking axes",
        "licence": "CC-BY-4.0",
        "version": VERSION,
        "hydro_env": __version__,
        "recordings": {split: sum(benchmark.blocks(split)) for split in SPLITS},
        "task_sha256": hashlib.sha256(config.model_dump_json().encode()).hexdigest(),
        "key_sha256": hashlib.sha256(benchmark.key.encode()).hexdigest() if benchmark.key else "",
    }
    place = folder / MANIFEST
    if place.exists():
        present = read_json(place)
        other = [name for name, value in manifest.items() if present.get(name) != value]
        if other:
            raise ConfigurationError(f"{folder}: holds another benchmark ({', '.join(other)}); choose another folder")
    write_text(place, json.dumps(manifest, indent=2))
    _write_table(folder / PLATES, plates_table(benchmark.key))
    waiting = {
        f"{split} {block}": Job(_write_block, None, (config, benchmark, str(folder.absolute()), split, block))
        for split in SPLITS
        for block in range(len(benchmark.blocks(split)))
        if not all(path.exists() for path in block_files(folder, split, block))
    }
    run_jobs(waiting, None, jobs, progress)
    for split in SPLITS:
        labels = read_labels(folder, split)
        manifest.setdefault("labels_sha256", {})[split] = digest_of_labels(labels)
        manifest.setdefault("hours", {})[split] = round(float(labels["seconds"].sum()) / 3600.0, 3)
    write_text(place, json.dumps(manifest, indent=2))
    write_text(folder / CARD, data_card(manifest))
    write_text(folder / SUMS, checksums(folder, benchmark))
    return manifest


def checksums(folder: Path, benchmark: Benchmark) -> str:
    """The SHA-256 of every public file, in the form of ``sha256sum``: ``sha256sum -c SHA256SUMS`` checks the folder."""
    public = [folder / name for name in (MANIFEST, CARD, PLATES)]
    for split in SPLITS:
        for block in range(len(benchmark.blocks(split))):
            recordings, labels = block_files(folder, split, block)
            public += [recordings] if split == "test" else [recordings, labels]
    return "".join(f"{_sum_line(folder, path)}\n" for path in public)


def _sum_line(folder: Path, path: Path) -> str:
    return f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}"


def read_public(folder: Path, name: str) -> pd.DataFrame:
    """A public table of the challenge, ``axes.parquet`` or the recordings of a split, as ``SHA256SUMS`` knows it.

    Raises:
        ConfigurationError: it cannot be read, or was changed.
    """
    paths = [folder / name] if name == PLATES else sorted((folder / name).glob("*.parquet"))
    public = read_text(folder / SUMS, 10_000_000).splitlines()
    if [_sum_line(folder, path) for path in paths] != [line for line in public if line[66:].split("/")[0] == name]:
        raise ConfigurationError(f"{folder / name}: is not what {folder / SUMS} says")
    return read_table(folder / name)


def block_files(folder: Path, split: str, block: int) -> tuple[Path, Path]:
    """The files of a block: recordings and labels."""
    return folder / split / f"{block:04d}.parquet", labels_folder(folder, split) / f"{block:04d}.parquet"


def labels_folder(folder: Path, split: str) -> Path:
    """Where the labels of a split are; those of the test split stand apart."""
    return (folder / HIDDEN if split == "test" else folder) / f"{split}_labels"


def _write_block(
    nothing: None, config: TaskConfig, benchmark: Benchmark, folder: str, split: str, block: int
) -> dict[str, NDArray[Any]]:
    """Simulate a block and write its files, the labels last."""
    made = simulated_block(config, benchmark, split, block)
    for path, table in zip(block_files(Path(folder), split, block), made, strict=True):
        _write_table(path, table)
    return {"rows": np.array([len(made.signals)])}


def _write_table(path: Path, table: pd.DataFrame) -> None:
    write_whole(path, table.to_parquet(index=False, compression="zstd"))


def read_labels(folder: Path, split: str) -> pd.DataFrame:
    """The labels of a split, in the order of the recordings.

    Raises:
        ConfigurationError: they are not there, or not readable.
    """
    place = labels_folder(folder, split)
    table = read_table(place) if place.is_dir() else pd.DataFrame()
    if "recording" not in table:
        raise ConfigurationError(f"{place}: is missing or holds no table; the labels of the split '{split}' are needed")
    return table.sort_values("recording", ignore_index=True)


def read_table(path: Path) -> pd.DataFrame:
    """A Parquet file, or a folder of them.

    Raises:
        ConfigurationError: it cannot be read.
    """
    with library_errors(path, "pyarrow.parquet"):
        return pd.read_parquet(path)


def digest_of_labels(labels: pd.DataFrame) -> str:
    """SHA-256 of the labels as CSV text, in the order of the recordings."""
    return hashlib.sha256(labels.to_csv(index=False, lineterminator="\n").encode()).hexdigest()


def data_card(manifest: Mapping[str, Any]) -> str:
    """The description that stands beside the data, as Markdown."""
    environment = jinja2.Environment(trim_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(read_text(_CARD)).render(
        manifest=manifest,
        axes=benchmark_axes,
        places={split: labels_folder(Path(), split).as_posix() for split in SPLITS},
        headings=[heading(name) for name in ("time", *MEASURED)],
        known=KNOWN,
        new=NEW,
        plates=columns_described(),
    )
