"""Residual torques, as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mbocp.identification.of_log import Identification
from mbocp.view.figures.style import PALETTE, house_style, save_figure


def plot_residuals(found: Identification, path: str | Path) -> Path:
    """Draw measured torques and what is left of them, of the samples that the fit did not see.

    Parameters
    ----------
    found : Identification
    path : str or Path
        .png, .pdf or .svg.
    """
    held = found.held_out
    with house_style():
        count = len(found.joints)
        figure = Figure(figsize=(9.0, 1.0 + 1.4 * count), layout="constrained")
        for k, (name, axes) in enumerate(
            zip(found.joints, np.ravel(figure.subplots(count, sharex=True)), strict=True)
        ):
            unit = "N" if found.robot.v_labels[found.dynamics.independent[k]].unit == "m/s" else "N m"
            axes.plot(held.t, held.torques[:, k], color=PALETTE[6], lw=0.8, label="measured")
            axes.plot(held.t, held.before[:, k], color=PALETTE[1], lw=0.8, label="left by the file's numbers")
            axes.plot(
                held.t, held.residuals[:, k], color=PALETTE[0], lw=0.8, label="left by the numbers found"
            )
            axes.set_ylabel(f"[{unit}]")
            axes.set_title(f"{name}: {held.rms_before[k]:.3g} before, now {held.rms[k]:.3g} {unit} (RMS)")
        axes.set_xlabel("t [s]")
        figure.axes[0].legend(loc="upper right", ncols=3)
        return save_figure(figure, path)
