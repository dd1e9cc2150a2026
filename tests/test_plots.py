"""Plots: that they show the numbers of amslicer.analysis, on axes of their own or given ones."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from amslicer import UsageError, analysis, plots
from amslicer.noise import GaborKernel, sample

PITCH = (0.125, 0.125)
AT = (np.arange(128) + 0.5) * 0.125
G = sample("phasor", AT[None, :], AT[::-1, None], orientation=30)
LABELS = np.where(np.abs(np.angle(G)) < 0.3 * np.pi, 1, 2).astype(np.uint8)
PLOTS: dict[str, Callable[..., Any]] = {
    "field": lambda **ax: plots.plot_field(G.real, PITCH, **ax),
    "spectrum": lambda **ax: plots.plot_spectrum(G.real, PITCH, **ax),
    "spectrum of variance": lambda **ax: plots.plot_spectrum(np.sin(np.angle(G)), PITCH, of_variance=True, **ax),
    "radial power": lambda **ax: plots.plot_radial_power(G.real, PITCH, **ax),
    "angular power": lambda **ax: plots.plot_angular_power(G.real, PITCH, 1.0, **ax),
    "autocovariance": lambda **ax: plots.plot_autocovariance(G.real, PITCH, **ax),
    "local ratio": lambda **ax: plots.plot_local_ratio(LABELS, PITCH, 3.0, **ax),
    "phase": lambda **ax: plots.plot_phase(G, PITCH, **ax),
    "truncation": lambda **ax: plots.plot_truncation_errors({"2D": GaborKernel(1, 0.05, 0.06, 2)}, **ax),
}


@pytest.mark.parametrize("name", list(PLOTS))
def test_each_is_drawn_and_saved(name: str, tmp_path: Path) -> None:
    axes = PLOTS[name]()
    axes.figure.savefig(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 2000
    assert axes.get_xlabel()
    given = Figure().subplots()
    assert PLOTS[name](ax=given) is given


def test_lines_are_what_was_measured() -> None:
    axes = plots.plot_radial_power(G.real, PITCH, expected=lambda f: 2 * f, bins=32)
    estimated, expected = axes.get_lines()
    np.testing.assert_array_equal(estimated.get_xydata(), np.stack(analysis.radial_power(G.real, PITCH, 32), axis=-1))
    np.testing.assert_array_equal(expected.get_ydata(), 2 * np.asarray(expected.get_xdata()))


def test_the_strongest_direction_stands_out() -> None:
    bars = plots.plot_angular_power(G.real, PITCH, 1.0).patches
    tallest = max(bars, key=lambda bar: bar.get_height())
    assert tallest.get_x() + tallest.get_width() / 2 == pytest.approx(30, abs=7.5)


def test_errors_fall_over_the_radius() -> None:
    (line,) = PLOTS["truncation"]().get_lines()
    radius, error = np.asarray(line.get_xydata()).T
    assert np.all(np.diff(radius) < 0)
    assert error[0] == pytest.approx(0.5)


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match="matplotlib") as error:
        plots.plot_field(G.real, PITCH)
    assert "amslicer[plots]" in str(error.value.hint)
