"""Models of a fifteen-line laser compared on the digital twin, as T 4.2.1 does on the prototype.

The laser is a tilted grating with random spacing and origins, which none of the models describes exactly. Six
lines are seen on both levels of the calibration, all on one; planes on other levels are measured with each
model. Each laser has a sensor of its own, which the processing knows from its calibration only.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
import pandas as pd

from thalweg.lightsheet.multi_line.comparison import compare_models, nested_tests
from thalweg.lightsheet.multi_line.models import KINDS, NominalDiode, line_model
from thalweg.lightsheet.multi_line.tables import line_table
from thalweg.lightsheet.optics.sensor import Sensor, paper_4
from thalweg_lab.studies.calibrated_sensor import calibrated_sensor
from thalweg_lab.tank.grating import GratingErrors, calibration_points, make_grating

PAIRED: Final = (4, 5, 6, 7, 8, 9)
"""Lines that both levels of the calibration show."""
SHARED: Final = ("regular", "diode", "hierarchical")
"""Models whose lines share parameters: they describe lines that one level alone shows, too."""
LEVELS_MM: Final = (75.0, 140.0)
PLANES_MM: Final = (60.0, 100.0, 120.0)
N_LINES: Final = 15
STEP_DEG: Final = 1.7


def nominal_diode(sensor: Sensor, labels: Iterable[int] = range(N_LINES)) -> NominalDiode:
    """What the maker states: 15 lines, 1.7 degrees apart, 28.2 degrees wide (T 4.2)."""
    return NominalDiode(
        labels=np.array(list(labels)), middle=(N_LINES - 1) / 2, origin_lcs_mm=sensor.sheet.origin_lcs_mm,
        angles_rad=sensor.sheet.angles_rad, step_rad=float(np.deg2rad(STEP_DEG)),
        half_angle_rad=float(np.deg2rad(14.1)),
    )  # fmt: skip


def multi_line_study(seeds: Iterable[int]) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Compare the models on some lasers.

    Returns
    -------
    models : a row for each laser and model, see `compare_models`.
    tests : whether there is a joint centre and an equal spacing, by laser.
    lines : where the lines of the nominal laser meet planes, see `line_table` (T Fig. 4.3).
    """
    models, tests = [], []
    for seed in seeds:
        pair = calibrated_sensor(seed)
        sensor, nominal = pair.known, nominal_diode(pair.known)
        grating = make_grating(pair.true, seed, errors=GratingErrors())
        points = calibration_points(pair.true, grating, LEVELS_MM, seed, paired_lines=PAIRED)
        planes = calibration_points(
            pair.true, grating, PLANES_MM, seed, pairs_per_line=0, sigma_px=0.2, name="plane"
        )
        six = nominal_diode(sensor, PAIRED)
        seen = points.of(np.isin(points.line, PAIRED))
        models.append(compare_models(sensor, seen, six, KINDS, planes=planes).assign(seed=seed))
        models.append(compare_models(sensor, points, nominal, SHARED, planes=planes).assign(seed=seed))
        tests.append(nested_tests(sensor, points, nominal).assign(seed=seed))
    design = paper_4()
    regular = line_model("regular", nominal_diode(design))
    lines = line_table(design, regular.lines(regular.start), (60.0, 100.0, 160.0))
    return pd.concat(models, ignore_index=True), pd.concat(tests, ignore_index=True), lines
