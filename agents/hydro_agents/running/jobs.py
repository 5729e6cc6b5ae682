"""Independent jobs: they run side by side through joblib, and each finished result is one file.

A job is a function of its arguments: neither the order of the jobs nor the place where they run changes a bit of the
results. The active ``joblib.parallel_config`` says where they run, and how many (:func:`workers`); without one they run
one after another in this process.
"""

import hashlib
import inspect
import io
import random
import sys
import warnings
import zipfile
import zlib
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from typing import Any, NamedTuple

import joblib
import numpy as np
from joblib import Parallel, cpu_count, delayed, parallel_config
from pydantic_core import to_json

from hydro_env import ConfigurationError
from hydro_env.compiling import digest_of_sources
from hydro_env.files import write_whole
from hydro_env.types import Array

JOBS_FOLDER = "jobs"
RESULT_FILES = f"{JOBS_FOLDER}/*.npz"
_KILLED = ("TerminatedWorkerError", "BrokenProcessPool")  # the errors of loky, by name

Columns = dict[str, Array]  # numbers by name, arrays of any shape
Report = Callable[[str, int, int], None]  # called with phase, number of finished jobs, and their total


def workers(jobs: int | None) -> parallel_config:
    """Run all jobs of a block in some processes of this machine; ``None``: one per core.

    Ctrl-C is left to this process.
    """
    return parallel_config("loky", n_jobs=jobs or cpu_count(), initializer=signal, initargs=(SIGINT, SIG_IGN))


class JobResult(NamedTuple):
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
        return digest_of_code("hydro_agents", *(["hydro_rig"] if of_the_rig else []))

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
def digest_of_code(*packages: str) -> str:
    """Digest of the compiled plant and of some packages: results depend on them."""
    return f"{digest_of_sources(*(Path(__file__).resolve().parents[2] / package for package in packages)):x}"


def fingerprint(participant: Any) -> str:
    """Digest of the numbers of an object and of the file of its class; empty if it cannot be pickled.

    Finished work of a participant with another digest is not reused.
    """
    source = b""
    with suppress(OSError, TypeError):
        made_in = participant if inspect.isfunction(participant) else type(participant)
        source = Path(inspect.getfile(made_in)).read_bytes()
    try:
        return joblib.hash((joblib.hash(participant), source))
    except Exception:  # a user's object may raise anything
        return ""


def run_jobs(listed: Mapping[str, Job], folder: Path | None, progress: Report | None) -> dict[str, JobResult]:
    """Run jobs, or read the results that are already in a folder; after an interruption, finished results stay there.

    Long and short jobs run mixed: the rate of the first ones tells how long all will take. Results have the keys of the
    jobs, and are files in the :data:`JOBS_FOLDER` of the folder.

    Raises:
        ConfigurationError: a file cannot be written, or a worker was killed.
    """
    report = progress or (lambda *_: None)
    stored = {key: load_result(folder, job) for key, job in listed.items()}
    results = {key: result for key, result in stored.items() if result}
    mixed = [key for key in listed if key not in results]
    random.Random(0).shuffle(mixed)
    report("jobs", len(results), len(listed))
    with closing(answers_of({key: listed[key] for key in mixed})) as answers:
        for key, result in answers:
            results[key] = result
            save_result(folder, listed[key], result)
            report("jobs", len(results), len(listed))
    return results


def answers_of(waiting: Mapping[str, Job]) -> Generator[tuple[str, JobResult], None, None]:
    """Results of jobs in the order of completion, each with its key; those of closed ones are lost.

    A participant that has no :func:`fingerprint` stays in this process. So does the first of the other jobs: they read
    the code that it compiled from the disk.

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
    pool = Parallel(batch_size=1, return_as="generator_unordered")
    answers = pool(delayed(_run_alone)(key, job) for key, job in left.items())
    try:
        for answer in answers:  # noqa: UP028 (`yield from` would close the answers before the warning is off)
            yield answer
    except Exception as error:
        if type(error).__name__ not in _KILLED:
            raise
        raise ConfigurationError(
            "a worker process was killed (for its memory?); the finished results are kept: "
            "go on with --resume and a smaller --jobs"
        ) from None
    finally:
        with warnings.catch_warnings():  # joblib counts what it cancels
            warnings.simplefilter("ignore", UserWarning)
            answers.close()


def _run_alone(key: str, job: Job) -> tuple[str, JobResult]:
    """Run a job on one core: as many jobs as cores run side by side, and a user's may use torch."""
    torch = sys.modules.get("torch")
    if torch:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
    try:
        with parallel_config("sequential"):  # jobs of a job do not go to the pool that waits for it
            return key, job.run()
    finally:
        if torch:
            torch.set_num_threads(threads)


def run_here(job: Job, folder: Path | None) -> Columns:
    """The numbers of one job that may have jobs of its own; read from a folder if they stand there, else kept there.

    Raises:
        ConfigurationError: that of the job, or a file cannot be written.
    """
    result = load_result(folder, job)
    if not result:
        result = job.run()
        save_result(folder, job, result)
    if result.error:
        raise ConfigurationError(result.error)
    return result.metrics


def save_result(folder: Path | None, job: Job, result: JobResult) -> None:
    """Write a result atomically into :data:`JOBS_FOLDER`, if it is one that is kept.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    if folder and job.digest and not result.error:
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **result.metrics)
        write_whole(folder / JOBS_FOLDER / job.file, content.getvalue())


def load_result(folder: Path | None, job: Job) -> JobResult | None:
    """Read the result of a job; ``None`` if there is none, or the file is damaged."""
    if not folder or not job.digest:
        return None
    try:
        with np.load(folder / JOBS_FOLDER / job.file, allow_pickle=False) as stored:
            return JobResult({name: stored[name] for name in stored.files})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
