"""The bank in the colours of photographs, and which points have none."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.figures import BLUE, GREY, leave_out, new_figure, styled


@styled
def colour_check(
    check: pd.DataFrame, curves: pd.DataFrame, *, title: str = "Intensity against brightness"
) -> Figure:
    """How much intensity and brightness depend on each other over shifts of clock and mount.

    Parameters
    ----------
    check, curves : of `thalweg.lidar.check_colours`.
    title : first words of the title.
    """
    n = int(check["photographs"].max())
    figure = new_figure(100.0, f"{title}, n = {n} photographs")
    words = {
        "clock_s": "camera time shift / s",
        **{f"turn_{a}_deg": f"camera rotation about its {a} axis / °" for a in "xyz"},
    }
    panels = figure.subplots(2, 2, sharey=True).ravel()
    for ax in panels[len(check) :]:
        leave_out(ax, "not tested")
    for ax, row in zip(panels, check.to_dict("records"), strict=False):
        curve = curves[curves["quantity"] == row["quantity"]]
        ax.axvline(0.0, color=GREY, linewidth=0.8)
        ax.plot(curve["shift"], 1e3 * curve["dependence"], ".-", color=BLUE, markersize=4)
        told = str(row["verdict"]).replace("fits", "consistent with 0")
        if np.isfinite(row["optimum"]):
            ax.axvspan(
                row["optimum"] - 2 * row["sigma"], row["optimum"] + 2 * row["sigma"], color=BLUE, alpha=0.2
            )
            told = f"shift {row['optimum']:+.3f} ± {row['sigma']:.3f}: {told}"
        ax.set_title(told, fontsize=9)
        ax.set_xlabel(words[str(row["quantity"])])
    figure.supylabel("mutual information / millinat", fontsize=9)
    return figure
