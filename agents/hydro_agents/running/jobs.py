"""Independent jobs: they run side by side through joblib, and each finished result is one file.

A job is a function of its arguments: neither the order of the jobs nor the place where they run changes a bit of the
results. The active ``joblib.parallel_config`` says where they run, and how many (:func:`workers`); without one they run
one after another in this process.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import os
import random
import sys
import warnings
import zipfile
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from threading import Thread
from time import sleep
from typing import Any

import joblib
import numpy as np
from joblib import Parallel, cpu_count, delayed, parallel_config
from joblib.parallel import get_active_backend
from numpy.typing import NDArray
from pydantic_core import to_json

from hydro_env import ConfigurationError
from hydro_env.compiling import SOURCES
from hydro_env.files import write_whole

JOBS_FOLDER = "jobs"
RESULT_FILES = f"{JOBS_FOLDER}/*.npz"
ROOMS = tuple(f"hydro_agents/{room}" for room in ("controllers", "running", "learning", "detection", "evaluation"))
"""Rooms whose code may change the result of a job, besides those of the package of the rig."""

_KILLED = ("TerminatedWorkerError", "BrokenProcessPool")  # the errors of loky, by name

Columns = dict[str, NDArray[Any]]  # numbers by name, arrays of any shape
Report = Callable[[str, int, int], None]
"""Called with the name of the phase, the number of finished jobs, and their total."""


@contextmanager
def workers(jobs: int | None = None) -> Iterator[None]:
    """Run all jobs of a block in some processes of this machine; ``None``: one per core."""
    with parallel_config("loky", n_jobs=jobs or cpu_count(), initializer=_begin, initargs=(os.getpid(),)):
        yield


def _begin(command: int) -> None:
    """Leave Ctrl-C to the process that started this worker, and end with it: one that was killed says nothing."""

    def watch() -> None:
        while os.getppid() == command:
            sleep(1.0)
        os._exit(1)

    signal(SIGINT, SIG_IGN)
    Thread(target=watch, daemon=True).start()


@dataclass(frozen=True)
class JobResult:
    """What a job found, or the reason why it found nothing."""

    metrics: Columns
    error: str = ""


@dataclass(frozen=True)
class Job:
    """A call ``work(participant, *arguments)`` that gives columns of numbers.

    The same job gives the same numbers on every machine and beside any other job.

    Example:
        >>> from hydro_agents.running.jobs import Job, run_jobs
        >>> jobs = {f"{number}": Job(np.add, number, (np.arange(3),), digest="a number") for number in range(4)}

    Args:
        work: a function of a module; a :class:`ConfigurationError` that it raises becomes the result.
        participant: what is measured: a controller, a detector, or nothing.
        arguments: settings (pydantic), arrays, numbers, texts, and tuples, mappings and dataclasses of these. The
            name of the result's file follows from their values.
        digest: of the participant (:func:`fingerprint`); empty: the result is not kept for another run.
    """

    work: Callable[..., Columns]
    participant: Any = None
    arguments: tuple[Any, ...] = ()
    digest: str = ""

    @property
    def code(self) -> str:
        """Digest of the code that may change the result; of the package of the rig, if work or participant are its."""
        makers = (self.work, self.participant, *type(self.participant).__mro__)
        of_the_rig = any(str(getattr(maker, "__module__", "")).startswith("hydro_rig.") for maker in makers)
        return digest_of_code(*ROOMS, *(["hydro_rig/*"] if of_the_rig else []))

    @cached_property
    def file(self) -> str:
        """Name of the result file; it differs for every work, participant, argument and version of the code."""
        name = f"{self.work.__module__}.{self.work.__qualname__}"
        values = to_json([self.code, name, self.digest, self.arguments], fallback=np.ndarray.tolist)
        return f"{hashlib.sha256(values).hexdigest()[:32]}.npz"

    def run(self) -> JobResult:
        """Do the work; the message of a configuration error becomes the result."""
        try:
            return JobResult(self.work(self.participant, *self.arguments))
        except ConfigurationError as error:
            return JobResult({}, str(error))


@cache
def digest_of_code(*rooms: str) -> str:
    """Digest of the compiled plant and of some rooms, such as ``hydro_agents/running``: results depend on them."""
    digest = hashlib.sha256(str(SOURCES).encode())
    for room in rooms:
        for file in sorted(Path(__file__).resolve().parents[2].glob(f"{room}/*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def fingerprint(*participants: Any) -> str:
    """Digest of the numbers of objects and of the files of their classes; empty if one cannot be pickled.

    Finished work of a participant with another digest is not reused.
    """
    digests = []
    for participant in participants:
        source = b""
        with suppress(OSError, TypeError):
            made_in = participant if inspect.isfunction(participant) else type(participant)
            source = Path(inspect.getfile(made_in)).read_bytes()
        try:
            digests.append(joblib.hash((str(joblib.hash(participant)), source)))
        except Exception:  # a user's object may raise anything
            return ""
    return "".join(digests)


def run_jobs(
    listed: Mapping[str, Job], folder: Path | None, jobs: int | None, progress: Report | None
) -> tuple[dict[str, JobResult], int]:
    """Run jobs, or read the results that are already in a folder; after an interruption, finished results stay there.

    Long and short jobs run mixed: the rate of the first ones tells how long all will take.

    Args:
        listed: each job by a unique key.
        folder: of the study; results are files in its :data:`JOBS_FOLDER`. ``None`` keeps none.
        jobs: number of jobs side by side; ``None``: that of the active ``parallel_config``, or one.
        progress: called when a job finishes.

    Returns:
        The results by the same keys, and the number of results that were read.

    Raises:
        ConfigurationError: a file cannot be written, or a worker was killed.
    """
    results: dict[str, JobResult] = {}
    waiting = dict(listed)
    if folder is not None:
        for key, job in listed.items():
            stored = load_result(folder / JOBS_FOLDER / job.file) if job.digest else None
            if stored is not None:
                results[key] = stored
                del waiting[key]
    reused = len(results)
    mixed = list(waiting)
    random.Random(0).shuffle(mixed)
    report = progress or (lambda *_: None)
    report("jobs", reused, len(listed))
    with _closed_at_end(answers_of({key: waiting[key] for key in mixed}, jobs)) as answers:
        for key, result in answers:
            results[key] = result
            if folder is not None and listed[key].digest:
                save_result(folder / JOBS_FOLDER / listed[key].file, result)
            report("jobs", len(results), len(listed))
    return results, reused


def answers_of(waiting: Mapping[str, Job], jobs: int | None) -> Generator[tuple[str, JobResult], None, None]:
    """Results of jobs in the order of completion, each with its key; those of closed ones are lost.

    A participant that has no :func:`fingerprint` stays in this process. So does the first of the other jobs: they read
    the code that it compiled from the disk.

    Args:
        waiting: the jobs.
        jobs: number of jobs side by side; ``None``: that of the active ``parallel_config``, or one.

    Raises:
        ConfigurationError: a worker was killed.
    """
    here = [key for key, job in waiting.items() if job.participant is not None and not job.digest]
    left = {key: job for key, job in waiting.items() if key not in here}
    here += list(left)[:1]
    for key in here:
        left.pop(key, None)
        yield _run_alone(key, waiting[key])
    if not left:
        return
    # A cluster has as many jobs under way as it has cores; what is sent to it can be fewer.
    limit = jobs or get_active_backend()[1]
    sent = {"pre_dispatch": limit} if limit and limit > 0 else {}
    pool: Any = Parallel(n_jobs=jobs, batch_size=1, return_as="generator_unordered", **sent)
    try:
        with _closed_at_end(pool(delayed(_run_alone)(key, job) for key, job in left.items())) as answers:
            for answer in answers:  # noqa: UP028 (`yield from` would close the answers before the warning is off)
                yield answer
    except Exception as error:
        if type(error).__name__ not in _KILLED:
            raise
        raise ConfigurationError(
            "a worker process was killed (for its memory?); the finished results are kept: "
            "go on with --resume and a smaller --jobs"
        ) from None


@contextmanager
def _closed_at_end(answers: Generator[Any, None, None]) -> Iterator[Generator[Any, None, None]]:
    """Cancel what is still under way when the block ends, without the warning in which joblib counts it."""
    try:
        yield answers
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            answers.close()


def _run_alone(key: str, job: Job) -> tuple[str, JobResult]:
    """Run a job on one core: as many jobs as cores run side by side, and a user's may use torch."""
    torch = sys.modules.get("torch")
    if torch is not None:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
    try:
        with parallel_config("sequential"):  # jobs of a job do not go to the pool that waits for it
            return key, job.run()
    finally:
        if torch is not None:
            torch.set_num_threads(threads)


def run_here(job: Job, folder: Path | None) -> Columns:
    """The numbers of one job that may have jobs of its own; read from a folder if they stand there, else kept there.

    Raises:
        ConfigurationError: that of the job, or a file cannot be written.
    """
    if folder is None:
        return job.work(job.participant, *job.arguments)
    file = folder / JOBS_FOLDER / job.file
    stored = load_result(file)
    if stored is None:
        stored = JobResult(job.work(job.participant, *job.arguments))
        save_result(file, stored)
    return stored.metrics


def save_result(path: Path, result: JobResult) -> None:
    """Write a result atomically; an error is none.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    if result.error:
        return
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **result.metrics)
    write_whole(path, content.getvalue())


def load_result(path: Path) -> JobResult | None:
    """Read the result of a job; ``None`` if there is none, or the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return JobResult({name: stored[name] for name in stored.files})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
