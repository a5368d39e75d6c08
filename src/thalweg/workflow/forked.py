"""Jobs are forked from a process that has loaded the libraries.

As Snakemake starts it, each job is a Python of its own that spends one to two seconds of the processor on
imports before its work begins, and most jobs work for less. Here the first job starts a server (start method
``forkserver`` of `multiprocessing`) that imports once what nearly all scripts import (`preload`). A job is
then a fork of it: a process with a folder, an environment and a number of threads of its own, as before.
Jobs in conda or in a container start as Snakemake starts them, and so do all where Linux is not. On a
cluster the first job that a Snakemake runs there is started, as it may be the only one, and those after it
are forked.
"""

import multiprocessing
import os
import runpy
import signal
import sys
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


def fork_scripts(*, after: int = 0) -> None:
    """From now on Snakemake forks the scripts of its own jobs, but the first ones; see above.

    Parameters
    ----------
    after : so many are started before.
    """
    from snakemake.script import PythonScript

    if sys.platform != "linux" or hasattr(PythonScript.execute_script, "started"):
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["thalweg.workflow.preload"])
    PythonScript.execute_script = _forking(PythonScript.execute_script, context, after)


def _forking(started: Callable[..., None], context: Any, after: int = 0) -> Callable[..., None]:
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
            wait([job.sentinel])
            with _EXIT_CODES:
                job.join()
        if job.exitcode and job.exitcode < 0:  # it could not say so itself
            ended = signal.Signals(-job.exitcode).name
            sys.stderr.write(
                f"\nThe job of rule {script.rulename} was ended by {ended} of the system or of somebody;"
                f" expected its own end. Its log: {', '.join(script.log) or 'none'}. Where memory ran out"
                " (`dmesg` tells), use fewer --cores; then start again: what is done stays.\n"
            )
        if job.exitcode:
            raise CalledProcessError(job.exitcode, f"{sys.executable} {fname}")

    execute_script.started = started  # type: ignore[attr-defined]
    return execute_script


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
