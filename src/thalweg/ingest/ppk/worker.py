"""Child process around the C library pyrtklib5: one job file in, one answer file out.

Run by path (``python -P ppk_worker.py JOB ANSWER``), so that it needs neither an installation of thalweg nor
anything beside the standard library and pyrtklib5. A crash of the C code ends this process only.
"""

import json
import sys
from pathlib import Path
from typing import Any


def convert(job: dict[str, Any]) -> dict[str, Any]:
    """A receiver's log to RINEX 3.04: ``{format, source, obs, nav, receiver_options}`` -> ``{returned}``."""
    import pyrtklib5 as rtk

    options = rtk.rnxopt_t()
    options.rnxver = 304
    options.navsys = (
        rtk.SYS_GPS | rtk.SYS_GLO | rtk.SYS_GAL | rtk.SYS_CMP | rtk.SYS_QZS | rtk.SYS_SBS | rtk.SYS_IRN
    )
    options.obstype, options.freqtype = 0xF, 0x1F  # code, phase, Doppler, strength; L1 to L8
    # The field is a C array without a string setter: filled char by char, closed with NUL.
    for index, char in enumerate(job["receiver_options"] + "\0"):
        options.rcvopt[index] = char
    outputs = [job["obs"], job["nav"], *[""] * 7]
    return {
        "returned": int(rtk.convrnx(getattr(rtk, f"STRFMT_{job['format']}"), options, job["source"], outputs))
    }


def solve(job: dict[str, Any]) -> dict[str, Any]:
    """Positions: ``{config, readback, inputs, output, interval_s}`` -> ``{loaded, returned}``."""
    import pyrtklib5 as rtk

    rtk.resetsysopts()
    loaded = int(rtk.loadopts(job["config"], rtk.sysopts.ptr))
    processing, solution, files = rtk.prcopt_t(), rtk.solopt_t(), rtk.filopt_t()
    rtk.getsysopts(processing, solution, files)
    # loadopts keeps the old value where it does not understand a word: the parent compares what was taken.
    rtk.saveopts(job["readback"], "w", "", rtk.sysopts.ptr)
    start, end = rtk.gtime_t(), rtk.gtime_t()
    start.time = end.time = 0
    inputs = list(job["inputs"])
    returned = rtk.postpos(
        start,
        end,
        float(job["interval_s"]),
        0.0,
        processing,
        solution,
        files,
        inputs,
        len(inputs),
        job["output"],
        "",
        "",
    )
    return {"loaded": loaded, "returned": int(returned)}


def main(job_file: str, answer_file: str) -> None:
    """Run the tasks of a job file in order and write their answers."""
    import pyrtklib5 as rtk

    job = json.loads(Path(job_file).read_text())
    actions = {"convert": convert, "solve": solve}
    answers = [actions[task["action"]](task) for task in job["tasks"]]
    answer = {"engine": f"RTKLIB {rtk.VER_RTKLIB} {rtk.PATCH_LEVEL}", "answers": answers}
    Path(answer_file).write_text(json.dumps(answer))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
