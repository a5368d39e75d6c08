"""Jobs are forked from a process that has loaded the libraries.

As Snakemake starts it, each job is a Python of its own that spends one to two seconds of the processor on
imports before its work begins, and most jobs work for less. Here the first job starts a server (start method
``forkserver`` of `multiprocessing`) that imports once what nearly all scripts import (`preload`). A job is
then a fork of it: a process with a folder, an environment and a number of threads of its own, as before.
Jobs in conda or in a container start as Snakemake starts them, and so do all where Linux is not. On a
cluster the first job that a Snakemake runs there is started, as it may be the only one, and those after it
are forked.

A job that takes longer than its rule asks for (``runtime``) is told, and is ended there on request.
"""

import math
import multiprocessing
import os
import runpy
import signal
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from subprocess import CalledProcessError
from threading import Lock
from typing import Any, Final

_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_SCRATCH: Final = ("TMPDIR", "TMP", "TEMP", "TEMPDIR")
# `multiprocessing` reads the exit code of a process whenever another one is started, and two threads that
# read it at once leave one of them without: a job that ended well would be said to have failed with 255.
_EXIT_CODES: Final = Lock()


def fork_scripts(*, after: int = 0, limited: bool = False) -> None:
    """From now on Snakemake forks the scripts of its own jobs, but the first ones; see above.

    Parameters
    ----------
    after : so many are started before.
    limited : jobs end with the time that they ask for.
    """
    from snakemake.script import PythonScript

    if sys.platform != "linux" or hasattr(PythonScript.execute_script, "started"):
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["thalweg.workflow.preload"])
    PythonScript.execute_script = _forking(PythonScript.execute_script, context, after, limited)


def _forking(
    started: Callable[..., None], context: Any, after: int = 0, limited: bool = False
) -> Callable[..., None]:
    """The method of a script that executes it, by a fork where that is possible."""
    first = iter(range(after))

    def execute_script(script: Any, fname: str, edit: bool = False) -> None:
        """Run the script, and raise CalledProcessError if it fails."""
        if (
            edit
            or next(first, None) is not None
            or any((script.conda_env, script.container_img, script.env_modules, script.shadow_dir))
        ):
            started(script, fname, edit=edit)
            return
        from snakemake.benchmark import benchmarked

        scratch = script.resources.get("tmpdir")
        begin, may_begin = context.Pipe(duplex=False)
        job = context.Process(target=_run, args=(begin, fname, Path.cwd(), script.threads, scratch))
        try:
            with _EXIT_CODES:
                job.start()
        except OSError:  # no room for another process, or a path of the server's socket that is too long
            started(script, fname, edit=edit)
            return
        with benchmarked(job.pid if script.bench_record is not None else False, script.bench_record):
            may_begin.send_bytes(b"")  # now that it is measured: a short job would have ended before
            in_time = _wait(job, script, limited)
            with _EXIT_CODES:
                job.join()
        if job.exitcode and job.exitcode < 0:  # it could not say so itself
            ended = f"{signal.Signals(-job.exitcode).name} of the system or of somebody"
            cure = "Where memory ran out (`dmesg` tells), use fewer --cores"
            if not in_time:
                ended = f"its limit of {script.resources['runtime']} minutes (limit=runtime)"
                cure = f"More of them: --set-resources {script.rulename}:runtime=MINUTES"
            words = (
                f"The job of rule {script.rulename} was ended by {ended}; expected its own end. Its log:"
                f" {', '.join(script.log) or 'none'}. {cure}; then start again: what is done stays.\n"
            )
            sys.stderr.write(f"\n{words}")
            for log in script.log:
                with Path(log).open("a", encoding="utf-8") as file:
                    file.write(words)
        if job.exitcode:
            raise CalledProcessError(job.exitcode, f"{sys.executable} {fname}")

    execute_script.started = started  # type: ignore[attr-defined]
    return execute_script


def _wait(job: Any, script: Any, limited: bool) -> bool:
    """Wait for the end of a job, and tell whenever it has taken longer than it asks for, twice as long, ...

    ``limited``: end it instead. Whether it ended by itself.
    """
    begin_s, asked_min = time.monotonic(), script.resources.get("runtime")
    due_s = 60.0 * asked_min if isinstance(asked_min, int | float) else math.inf
    while not wait([job.sentinel], begin_s + due_s - time.monotonic() if due_s < math.inf else None):
        if limited:
            job.terminate()
            return False
        sys.stderr.write(
            f"The job of rule {script.rulename} has run for {due_s / 60:g} minutes; it asks for {asked_min:g}"
            f" and usually takes a part of them. Its log: {', '.join(script.log) or 'none'}. Ctrl-C ends all,"
            " `--config limit=runtime` such jobs.\n"
        )
        due_s *= 2
    return True


def _run(begin: Connection, script: str, folder: Path, threads: int, scratch: str | None) -> None:
    """What a fork does: the script as the main module, its errors to the hook that it has set."""
    begin.recv_bytes()
    os.chdir(folder)
    os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    if scratch:
        os.environ.update(dict.fromkeys(_SCRATCH, scratch))
    try:
        runpy.run_path(script, run_name="__main__")
    except Exception:
        sys.excepthook(*sys.exc_info())  # multiprocessing would print the traceback without asking the hook
        sys.exit(1)
